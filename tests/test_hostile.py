"""Files that are made to break a reader: one line, exit 2, at most 1 GB and 5 s; and files damaged by chance."""

import numpy as np
import pytest

from lib.core import artefact, bounded, yaml_file
from lib.core.stage import BadInput
from tests.helpers import confined, fuzz, hostile

PATIENCE = 6  # times the seconds that SECURITY.md promises, of a busy or slow machine; `tests.bench.fuzz` asks them


@pytest.fixture(scope="module", autouse=True)
def loaded():
    """What the readers import is loaded before the memory is bounded."""
    import mapbox_earcut  # noqa: F401
    import scipy.sparse.csgraph  # noqa: F401

    from lib.planning import plan  # noqa: F401

    fuzz.load()


@pytest.mark.parametrize("case", hostile.CASES)
def test_a_hostile_file_and_its_line(case, tmp_path):
    make, read, line = hostile.CASES[case]
    attic = hostile.scene(tmp_path / "data" / "attic")
    make(attic)
    outcome = confined.call(read, attic, cpu_s=PATIENCE * confined.CPU_S)
    assert outcome.end == ("refused" if line else "accepted"), outcome
    if line:
        assert any(line in said.replace(f"{attic}/", "") for said in outcome.lines), outcome.lines
        assert len(outcome.lines) <= 20 and all("\n" not in said for said in outcome.lines)


def test_the_table_is_long_enough():
    assert len(hostile.CASES) >= 90


def test_a_child_of_little_memory_and_time():
    """The five ends of a confined call."""

    def lost():
        raise ValueError("x")

    def endless():
        while True:
            pass

    def refused():
        raise BadInput("a.txt: x")

    ends = [outcome.end for outcome in confined.calls([(lost,), (np.ones, 10**9), (np.ones, 10**3), (refused,)])]
    assert ends == ["traceback", "memory", "accepted", "refused"]
    assert confined.call(endless).end == "hang"


def test_arrays_come_back_as_numpy_has_them(tmp_path):
    rng = np.random.default_rng(1)
    arrays = {
        "a": rng.random((3, 4)),
        "b": np.asfortranarray(rng.random((3, 4))),
        "c": np.array(["x", "long"]),
        "d": np.array(3),
        "e": np.zeros((0, 2), np.int32),
        "f": np.array([True]),
    }
    artefact.write_npz(tmp_path / "a.npz", **arrays)
    found = artefact.read_npz(tmp_path / "a.npz", *arrays)
    for name, array in arrays.items():
        assert (found[name] == array).all() and found[name].dtype == array.dtype and found[name].shape == array.shape
        assert found[name].flags.writeable


LITERALS = (
    "{'a': [1, -2.5e3, .5], 'b': (1,), 'c': 'x' \"y\", # z\n 'd': b'\\x00', 'e': (None), 'f': True,}",
    "[]",
    "''",
)


@pytest.mark.parametrize("text", LITERALS)
def test_a_literal_is_python_s(text):
    import ast

    assert bounded.literal_of("x", text.encode()) == ast.literal_eval(text)


@pytest.mark.parametrize(
    "text", ["", "{1: 2}", "[1,,2]", "1 + 1", "'a' b'c'", "[1", "1]", "{'a' 1}", "x", "'\\x'", "{'a'}", "0x10", "1_0"]
)
def test_what_is_no_literal(text):
    with pytest.raises(ValueError, match="^line 1: "):
        bounded.literal_of("x", text.encode())


def test_aliases_stand_for_their_value(tmp_path):
    (tmp_path / "a.yaml").write_text("a: &x [1, 2]\nb: *x\nc: [*x, *x]\n")
    assert yaml_file.read_yaml(tmp_path / "a.yaml") == {"a": [1, 2], "b": [1, 2], "c": [[1, 2], [1, 2]]}


def test_leaves_around_one_edge_stay_apart(tmp_path):
    """Of a book of 40 leaves around a spine each is two triangles, and one facet."""
    from lib.given import model

    lines = ["usemtl paper", "v 0 0 0", "v 0 0 3"]
    for k in range(40):
        x, y = float(np.cos(2 * np.pi * k / 40)), float(np.sin(2 * np.pi * k / 40))
        lines += [f"v {x} {y} 0", f"v {x} {y} 3", f"f 1 {3 + 2 * k} {4 + 2 * k}", f"f 1 {4 + 2 * k} 2"]
    (tmp_path / "book.obj").write_text("\n".join(lines) + "\n")
    built = model.load(tmp_path / "book.obj")
    assert (np.bincount(built.triangle_facet) == 2).all() and built.n_facets == 40


@pytest.mark.parametrize("count", [2, 15, 16, 17, 40])
def test_facets_of_a_crowded_edge_do_not_depend_on_their_number(count, tmp_path):
    """So many coplanar triangles on one side of an edge, as many on the other: one facet, however many there are."""
    from lib.given import model

    lines = ["usemtl paper", "v 0 0 0", "v 0 1 0"]
    for k in range(count):
        lines += [f"v {1 + k / 100} {k / count} 0", f"v {-1 - k / 100} {k / count} 0"]
        lines += [f"f 1 {3 + 2 * k} 2", f"f 1 2 {4 + 2 * k}"]
    path = tmp_path / "a.obj"
    path.write_text("\n".join(lines) + "\n")
    assert model.load(path).n_facets == 1


# ---- spoilt by chance; python -m tests.bench.fuzz spoils more ----

COUNT, SEED = 40, 7


@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_spoilt_files_are_refused_or_good(kind, tmp_path):
    """No traceback, hang or crash, at most 1 GB and 5 s, a line for each problem, and nothing that is not finite."""
    for content, outcome in fuzz.run(fuzz.KINDS[kind], tmp_path, COUNT, SEED):
        assert outcome.end in ("accepted", "refused"), (outcome, content[:500])
        assert all("\n" not in line for line in outcome.lines)


def test_the_same_seed_spoils_alike():
    kind = fuzz.KINDS["materials.json"]
    assert list(fuzz.inputs(kind, 9, 1)) == list(fuzz.inputs(kind, 9, 1)) != list(fuzz.inputs(kind, 9, 2))


# ---- pictures that are damaged ----


def _picture():
    y, x = np.mgrid[0:96, 0:128]
    smooth = np.stack([x, y, 120 + 40 * np.sin(x / 9) * np.cos(y / 7)], -1)
    return np.clip(smooth + np.random.default_rng(0).normal(0, 4, smooth.shape), 0, 255).astype(np.uint8)


def _encoded(suffix):
    """Content of a picture of that kind, of which the decoder can tell damage."""
    import io

    import cv2
    from PIL import Image

    if suffix == ".tif":
        target = io.BytesIO()
        Image.fromarray(_picture()).save(target, "TIFF", compression="tiff_deflate")
        return target.getvalue()
    return cv2.imencode(suffix, _picture())[1].tobytes()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_a_picture_with_one_wrong_bit_is_refused(suffix, tmp_path):
    """Where the file has checksums."""
    from lib.given import image

    content, rng = _encoded(suffix), np.random.default_rng(3)
    believed = 0
    for _ in range(60):
        damaged = bytearray(content)
        damaged[rng.integers(40, len(content) // 2)] ^= 1 << rng.integers(8)
        (tmp_path / f"a{suffix}").write_bytes(damaged)
        try:
            image.read_photograph(tmp_path / f"a{suffix}")
            believed += 1
        except BadInput as bad:
            assert len(bad.problems) == 1
    assert believed == 0


def test_a_jpeg_whose_data_is_damaged_is_refused(tmp_path):
    """A hole in the data: the decoder grumbles and goes on, and we listen."""
    from lib.given import image

    content = _encoded(".jpg")
    middle = len(content) // 2
    (tmp_path / "a.jpg").write_bytes(content[:middle] + content[middle + 300 :])
    with pytest.raises(BadInput, match="a.jpg: damaged: Corrupt JPEG data"):
        image.read_photograph(tmp_path / "a.jpg")


def test_a_damaged_exr_is_refused_without_a_word_beside(tmp_path, capfd):
    from lib.given import image

    image.write_exr(tmp_path / "a.exr", _picture() / 255)
    content = bytearray((tmp_path / "a.exr").read_bytes())
    content[len(content) // 2] ^= 16
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(BadInput, match=r"a.exr: damaged: "):
        image.read_exr(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


# ---- what lies outside ----


def test_mtllib_outside_the_model_s_folder_is_ignored_with_a_warning(tmp_path):
    from lib.given import foreign_models

    (tmp_path / "in").mkdir()
    (tmp_path / "other.mtl").write_text("newmtl a\nKe 1 1 1\n")
    (tmp_path / "in" / "a.obj").write_text("mtllib ../other.mtl\nmtllib /etc/passwd\nv 0 0 0\n")
    files, said = foreign_models.convert(tmp_path / "in" / "a.obj")
    assert list(files) == ["model.obj"]
    assert said == [
        f"mtllib {n} lies outside the model's folder and is ignored" for n in ("../other.mtl", "/etc/passwd")
    ]


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_a_device_is_no_file(device):
    with pytest.raises(BadInput, match="is no file"):
        bounded.content(device)
