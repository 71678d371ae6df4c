"""From outside: scenes by hand with answers in closed form, run through make as a user would; and input to be refused.

A ground plane and a black lamp above it: no light goes twice, so a pixel's value is rho E F(point), with F by Lambert's
formula.
"""

import json
import struct

import cv2
import numpy as np
import pytest

W, H, F_PX = 96, 72, 80.0
RHO, E = np.array([0.42, 0.55, 0.31]), np.array([3.0, 2.8, 2.5])
GROUND = np.array([(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)], float)
LAMP = np.array([(-0.5, -0.4, 2.0), (-0.5, 0.6, 2.0), (0.7, 0.6, 2.0), (0.7, -0.4, 2.0)], float)  # shines down
EYE, FORWARD = np.array([-3.0, -0.5, 1.5]), np.array([3.0, 0.6, -1.5])


def pose():
    f = FORWARD / np.linalg.norm(FORWARD)
    r = np.cross(f, (0, 0, 1))
    r /= np.linalg.norm(r)
    return np.stack([r, np.cross(f, r), f])


def light():
    """(H, W, 3) linear values: rho E times the factor to the lamp from each point of the ground; 0 beside it."""
    x, y = np.meshgrid(np.arange(W), np.arange(H))
    v = np.stack([(x - (W - 1) / 2) / F_PX, (y - (H - 1) / 2) / F_PX, np.ones((H, W))], -1) @ pose()
    t = np.where(v[..., 2] < -1e-9, EYE[2] / -np.minimum(v[..., 2], -1e-9), np.inf)
    p = EYE + np.where(np.isfinite(t), t, 0)[..., None] * v
    on = np.isfinite(t) & (np.abs(p[..., :2]) < 4).all(-1)
    total = np.zeros((H, W))
    for i in range(4):
        a, b = (q - p for q in (LAMP[i], LAMP[(i + 1) % 4]))
        a, b = (q / np.linalg.norm(q, axis=-1, keepdims=True) for q in (a, b))
        n = np.cross(a, b)
        length = np.linalg.norm(n, axis=-1)
        total += np.arctan2(length, (a * b).sum(-1)) * n[..., 2] / length / (2 * np.pi)
    return np.where(on, np.abs(total), 0)[..., None] * RHO * E


def srgb(B):
    return np.where(B <= 0.0031308, 12.92 * B, 1.055 * np.maximum(B, 0.0031308) ** (1 / 2.4) - 0.055)


def obj(scale, offset, style):
    lines = ["# by hand"]
    for name, polygon in (("ground", GROUND), ("lamp", LAMP)):
        lines += [f"o {name}", "g ignored", f"usemtl {name}"] if style != "no objects" else [f"usemtl {name}"]
        lines += ["v " + " ".join(f"{x:.17g}" for x in scale * q + offset) for q in polygon]
        lines += ["vt 0 0", "vn 0 0 1", "f -4/-1/-1 -3/-1/-1 -2//-1 -1/-1"] if style == "forms" else ["f -4 -3 -2 -1"]
    return ("\r\n" if style == "forms" else "\n").join(lines) + "\n"


def glb(scale):
    """One node per polygon, moved and turned, so that its transform matters."""
    a = 0.4
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    binary, nodes, meshes, views, accessors = b"", [], [], [], []
    for i, polygon in enumerate((GROUND, LAMP)):
        c = scale * polygon.mean(0)
        for array, kind, form in (
            ((scale * polygon - c) @ R, "<f4", "VEC3"),
            (np.array([0, 1, 2, 0, 2, 3]), "<u4", "SCALAR"),
        ):
            data = array.astype(kind).tobytes()
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
            accessors.append(
                {
                    "bufferView": len(views) - 1,
                    "componentType": 5126 if kind == "<f4" else 5125,
                    "count": 4 if form == "VEC3" else 6,
                    "type": form,
                }
            )
            binary += data
        meshes.append({"primitives": [{"attributes": {"POSITION": 2 * i}, "indices": 2 * i + 1, "material": i}]})
        nodes.append({"mesh": i, "translation": c.tolist(), "rotation": [0, 0, np.sin(a / 2), np.cos(a / 2)]})
    text = json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0, 1]}],
            "nodes": nodes,
            "meshes": meshes,
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": len(binary)}],
            "materials": [{"name": "ground"}, {"name": "lamp"}],
        }
    ).encode()
    text += b" " * (-len(text) % 4)
    return (
        struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )


def scene(folder, yaml, *, display, file="left.png", bits=8, scale=1.0, offset=(0.0, 0, 0), style="plain"):
    folder.mkdir(parents=True)
    limit = 2**bits - 1
    code = cv2.imencode(
        "." + file.split(".")[1],
        np.round(limit * display(light()))[..., ::-1].astype(np.uint16 if bits == 16 else np.uint8),
    )[1]
    (folder / file).write_bytes(code.tobytes())
    if style == "glb":
        (folder / "model.glb").write_bytes(glb(scale))
    else:
        (folder / "model.obj").write_bytes(obj(scale, np.array(offset), style).encode())
    R = pose()
    r = cv2.Rodrigues(R)[0].ravel()
    t = -R @ (scale * EYE + offset)
    (folder / "left.posed.cameramodel").write_text(
        repr(
            {
                "lensmodel": "LENSMODEL_PINHOLE",
                "intrinsics": [F_PX, F_PX, (W - 1) / 2, (H - 1) / 2],
                "extrinsics": [float(x) for x in (*r, *t)],
                "imagersize": [W, H],
            }
        )
    )
    (folder / "scene.yaml").write_text(yaml + "\ngoals: [materials.json]\n")
    return folder


@pytest.fixture
def make(run, tmp_path):
    return lambda *words: run("make", "V=1", f"DATA={tmp_path / 'data'}", f"BUILD={tmp_path / 'out'}", *words)


KNOWN = "lamps: {lamp: [3.0, 2.8, 2.5]}"


@pytest.mark.scene
@pytest.mark.parametrize(
    "yaml, options, scale_by",
    [
        (KNOWN, {"display": lambda B: B ** (1 / 2.2), "style": "forms", "scale": 1e-3}, "lamps"),
        (
            KNOWN + "\ntransfer: srgb",
            {"display": srgb, "file": "left.tif", "bits": 16, "style": "no objects", "offset": (1e6, -7e5, 3e5)},
            "lamps",
        ),
        pytest.param(
            "lamps: {lamp: unknown}\nreference: {ground: [0.42, 0.55, 0.31]}\ntransfer: linear",
            {"display": lambda B: B, "bits": 16, "style": "glb", "scale": 1e3},
            "reference",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["a millimetre, odd OBJ", "1e6 m away, sRGB TIFF", "kilometres, GLB, lamp unknown"],
)
def test_ground_under_a_lamp(make, tmp_path, yaml, options, scale_by):
    scene(tmp_path / "data" / "s", yaml, **options)
    result = make("s")
    assert result.returncode == 0, result.stderr
    assert "stages/" not in make("s").stdout  # nothing is left to do
    found = json.loads((tmp_path / "out" / "s" / "materials.json").read_text())
    ground = found["groups"]["ground"]
    assert found["scale"] == scale_by and ground["identified"]
    np.testing.assert_allclose(ground["rho_d"], RHO, rtol=0.003)
    np.testing.assert_allclose(found["lamps"]["lamp"]["emittance"], E, rtol=0.003)
    if found["transfer"]["kind"] == "gamma":
        assert abs(found["transfer"]["gamma"] - 2.2) < 0.01


CASES = {
    "key twice": ("scene.yaml", lambda b: b + KNOWN.encode(), "scene.yaml: line 3: lamps"),
    "UTF-16": ("scene.yaml", lambda b: b.decode().encode("utf-16"), "scene.yaml: not UTF-8"),
    "tag that runs code": ("scene.yaml", lambda b: b"lamps: !!python/object/apply:os.getcwd []", "scene.yaml: line 1"),
    "emittance too large": ("scene.yaml", lambda b: b.replace(b"3.0", b"1e400"), "lamps.lamp"),
    "corner not finite": (
        "model.obj",
        lambda b: b.replace(b"v -4 ", b"v nan ", 1),
        "model.obj: line 5: vertex x = nan",
    ),
    "corner missing": ("model.obj", lambda b: b.replace(b"f -4", b"f -40", 1), "model.obj: line 9: face index -40"),
    "model is a photograph": (
        "model.obj",
        lambda b: b"\x89PNG\r\n\x1a\n" + bytes(99),
        "model.obj: is a picture (PNG): give it as PHOTO",
    ),
    "photograph cut short": ("left.png", lambda b: b[: len(b) // 2], "left.png: truncated"),
    "photograph damaged": ("left.png", lambda b: b[:400] + bytes([b[400] ^ 255]) + b[401:], "left.png: damaged"),
    "photograph empty": ("left.png", lambda b: b"", "left.png: the file is empty"),
    "camera runs code": (
        "left.posed.cameramodel",
        lambda b: b"__import__('os').getcwd()",
        "left.posed.cameramodel: not a camera model",
    ),
    "camera of another size": (
        "left.posed.cameramodel",
        lambda b: b.replace(b"[96, 72]", b"[97, 72]"),
        "left.png: size: 96 x 72",
    ),
    "focal length negative": (
        "left.posed.cameramodel",
        lambda b: b.replace(b"[80.0,", b"[-80.0,"),
        "intrinsics: fx = -80",
    ),
}


def test_refused_before_anything_is_written(refuses, tmp_path):
    sound = scene(tmp_path / "sound", KNOWN, display=lambda B: B ** (1 / 2.2))
    for i, (file, change, _) in enumerate(CASES.values()):
        folder = tmp_path / "data" / f"bad{i}"
        folder.mkdir(parents=True)
        for path in sound.iterdir():
            (folder / path.name).write_bytes(path.read_bytes() if path.name != file else change(path.read_bytes()))
    lines = refuses(
        "-m",
        "lib.planning.plan",
        "--data",
        tmp_path / "data",
        "--build",
        tmp_path / "out",
        *[f"bad{i}" for i in range(len(CASES))],
    )
    assert len(lines) == len(CASES), lines
    for i, (line, (_, _, said)) in enumerate(zip(lines, CASES.values(), strict=True)):
        assert f"bad{i}/" in line and said in line, line
    assert not (tmp_path / "out").exists()


@pytest.mark.scene
def test_given_materials_are_rendered_and_nothing_is_fitted(make, tmp_path):
    folder = scene(tmp_path / "data" / "s", KNOWN, display=lambda B: B ** (1 / 2.2))
    (folder / "scene.yaml").write_text(KNOWN + "\ngoals: [materials.json, rendered.png]\n")
    ground = {"kind": "diffuse", "rho_d": RHO.tolist(), "rho_s": [0, 0, 0], "identified": True}
    (folder / "materials.json").write_text(
        json.dumps(
            {
                "status": "converged",
                "groups": {"ground": ground},
                "lamps": {"lamp": {"emittance": E.tolist()}},
                "transfer": {"kind": "gamma", "gamma": 2.2},
                "scale": "lamps",
            }
        )
    )
    result = make("s")
    assert result.returncode == 0, result.stderr
    assert (
        "stages/render.py" in result.stdout
        and "stages/fit.py" not in result.stdout
        and "stages/gather.py" not in result.stdout
    )
    shown = cv2.imread(str(tmp_path / "out" / "s" / "rendered.png"), -1)[..., ::-1] / 255.0
    step = np.abs(shown - light() ** (1 / 2.2))
    assert np.median(step) < 0.003 and np.quantile(step, 0.98) < 0.01
