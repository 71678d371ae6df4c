"""stages/augment.py and lib/picture: changes of a recovered scene, by the laws that they must keep."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import cameras, image, lenses, motion
from lib.given import model as models
from lib.given.model import changes
from lib.given.transfer import Transfer
from lib.light import changed_factors, factors_file, form_factors, glints
from lib.light import surface as surfaces
from lib.picture import augmented, curved, differential, grain, rendering
from lib.picture import subject as subjects
from tests.helpers import rooms, small_scenes

GAMMA = 2.2
CAMERA = (np.array([[75.0, 0, 55.5], [0, 75, 41.5], [0, 0, 1]]), 112, 84)
RHO = {"bottom": 0.5, "top": 0.7, "west": 0.6, "east": 0.6, "south": 0.6, "north": 0.6, "crate": 0.4}
CRATE = (2.2, 1.6, 0.0, 2.8, 2.2, 0.6)
QUALITY = subjects.Quality(n_rays=64, shadow_rays=16, n_texels=6000, lobe_rays=16)


def looking(eye, at):
    """World to camera."""
    forward = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = right, np.cross(forward, right), forward
    T[:3, 3] = -T[:3, :3] @ eye
    return T


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """{option: path} of a room with a crate, whose photograph is the project's own rendering."""
    return photographed(tmp_path_factory.mktemp("room"), [3.0, 2.2, 0.6])


def photographed(folder, at):
    """{option: path} of the room, made in a folder, as it is seen from a corner."""
    camera = cameras.Camera(*CAMERA, looking([0.4, 0.4, 1.6], at))
    objects = rooms.room() | rooms.LAMP | rooms.solid("crate", *CRATE)
    studio = small_scenes.Studio(folder, objects, camera, patches=120, rays=256)
    artefact.write_npz(folder / "coverage.npz", **studio.coverage)
    groups = {name: {"kind": "diffuse", "rho_d": [rho] * 3, "rho_s": [0, 0, 0]} for name, rho in RHO.items()}
    lamps = {"lamp": {"emittance": [9.0, 9.0, 9.0]}}
    found = {"status": "converged", "groups": groups, "lamps": lamps, "transfer": {"kind": "gamma", "gamma": GAMMA}}
    artefact.write_json(folder / "materials.json", found)
    image.write_png8(folder / "left.png", np.zeros((84, 112, 3), np.uint8))
    names = {"model": "model.obj", "camera": "camera.cameramodel", "photograph": "left.png", "facet": "facet.png"}
    names |= {name: f"{name}.npz" for name in ("formfactors", "coverage")} | {"materials": "materials.json"}
    files = {name: str(folder / file) for name, file in names.items()}
    linear = rendering.render(subjects.read(**files), QUALITY).linear
    noisy = linear ** (1 / GAMMA) + np.random.default_rng(3).normal(0, 0.01, (84, 112, 3))  # so that it has colours
    image.write_png8(folder / "left.png", np.round(255 * np.clip(noisy, 0, 1)).astype(np.uint8))
    box = {"crate": [("crate", p) for p in rooms.box(*CRATE).values()]}
    rooms.write(folder / "crate.obj", box)
    return files


def made(scene, quality=QUALITY, **entry):
    return augmented.picture(augmented.read({"name": "x"} | entry, scene), quality)


def photograph(scene):
    return np.round(255 * image.read_photograph(scene["photograph"]).values).astype(int)


def rendered(scene):
    return rendering.render(subjects.read(**scene), QUALITY).linear


def test_no_change_is_the_photograph(scene):
    same = made(scene)
    assert (same.values == photograph(scene)).all() and same.facts["changed_pixels"] == 0
    again = made(scene, lamps={"lamp": [9, 9, 9]}, change={"crate": {"rho_d": [0.4] * 3}})
    assert (again.values == photograph(scene)).all()


def test_what_no_light_reaches_changes_nothing(scene):
    """A ball outside the room: every ray ends where it ended, whatever rows were added."""
    ball = {"sphere": 0.3, "at": [9.0, 9, 1], "material": {"kind": "diffuse", "rho_d": [0.9] * 3}}
    assert (made(scene, add=ball).values == photograph(scene)).all()


def test_twice_the_lamp_is_twice_the_light(scene):
    read = augmented.read({"name": "x", "lamps": {"lamp": [18, 18, 18]}}, scene)
    pair = differential.renderings(read.recovered, read.changed, QUALITY)
    there = pair.before > 0
    assert there.mean() > 0.99 and np.allclose(pair.after[there], 2 * pair.before[there], rtol=1e-5)


def test_a_lamp_switched_off_is_night(scene):
    assert made(scene, lamps={"lamp": [0, 0, 0]}).linear.max() < 1e-6


def test_half_the_lamp_is_half_the_grain(scene):
    """What the rendering did not explain shrinks with the light that falls on it, and stays where there is more."""
    beyond = (photograph(scene) / 255) ** GAMMA - rendered(scene)
    seen = (np.abs(beyond) > 0.01) & (photograph(scene).max(axis=2, keepdims=True) < 255)
    for times, kept in ((0.5, 0.5), (2, 1)):
        left = made(scene, lamps={"lamp": [9 * times] * 3}).linear - times * rendered(scene)
        assert seen.sum() > 50 and abs(np.median((left / beyond)[seen]) - kept) < 0.02


def test_of_a_lamp_switched_off_nothing_is_left(tmp_path):
    """Its rim in the photograph is brighter than its share of the pixel tells: at night that is no light."""
    scene = photographed(tmp_path, [2, 1.5, 2.4])
    read = subjects.read(**scene)
    shows = read.group == read.groups.index("lamp")
    assert shows.sum() > 50
    rim = cv2.dilate(shows.astype(np.uint8), np.ones((3, 3))) > 0
    photo = photograph(scene)
    photo[rim] = 255
    image.write_png8(tmp_path / "left.png", photo.astype(np.uint8))
    assert made(scene, LOW, lamps={"lamp": [0, 0, 0]}).linear[rim].max() < 1e-6
    # where it hung, the wall behind it is dark too
    assert made(scene, LOW, remove=["lamp"]).linear[rim].max() < 1e-6


def test_nothing_of_a_mirrors_picture_stays_on_what_takes_its_place(scene, tmp_path):
    """A smear in the photograph of a mirror was seen in it: painted over, the wall has none. On a wall it stays."""
    found = json.loads(Path(scene["materials"]).read_text())
    found["groups"]["north"] |= {"kind": "mirror", "rho_d": [0] * 3, "rho_s": [1] * 3}
    artefact.write_json(tmp_path / "materials.json", found)
    mirror = scene | {"materials": str(tmp_path / "materials.json")}
    (y, *_), (x, *_) = np.nonzero(subjects.read(**scene).group == subjects.read(**scene).groups.index("north"))
    own = photograph(scene)
    pictures = []
    for value in (40, 200):
        own[y + 3 : y + 6, x + 3 : x + 6] = value
        image.write_png8(tmp_path / "left.png", own.astype(np.uint8))
        smeared = {"photograph": str(tmp_path / "left.png")}
        change = {"change": {"north": GREY}}
        pictures.append([made(files | smeared, LOW, **change).values for files in (mirror, scene)])
    (dark, wall), (bright, wall_too) = pictures
    assert (dark == bright).all() and (wall != wall_too).any()


def test_a_removed_object_put_back_is_the_photograph(scene):
    crate = {"file": scene["model"].replace("model.obj", "crate.obj"), "at": [0, 0, 0]}
    crate["material"] = {"kind": "diffuse", "rho_d": [0.4] * 3}
    back = made(scene, remove=["crate"], add=crate)
    read = subjects.read(**scene)
    shows = read.group == read.groups.index("crate")
    error = (back.values - photograph(scene)) / 255
    assert np.sqrt((error[shows] ** 2).mean()) < 0.013  # noise of 0.01 is not put back
    pure = shows[..., None] | np.zeros(3, bool)
    assert np.abs(error[~pure.all(axis=2) & read.pure]).max() < 0.02
    grainy = made(scene, remove=["crate"], add=crate, grain=True)
    noise = np.std(grainy.values[shows] / 255 - back.values[shows] / 255)
    assert 0.006 < noise < 0.014


def test_a_removed_object_leaves_what_the_model_has_behind_it(scene):
    """The picture of the room without the crate is that of a room that never had one."""
    gone = made(scene, remove=["crate"])
    read = augmented.read({"name": "x", "remove": ["crate"]}, scene)
    bare = rendering.render(read.changed, QUALITY).linear
    shows = read.recovered.group == read.recovered.groups.index("crate")
    assert np.abs(gone.linear[shows] - bare[shows]).max() < 0.05 * bare.max()
    assert np.sqrt(np.mean((gone.linear - bare) ** 2)) < 0.02


def test_a_mirror_in_even_light_is_not_seen(tmp_path):
    """Everything glows alike: a perfect mirror, smooth or flat, shows just that."""
    walls = {"room": [("lamp", p) for p in rooms.box(0, 0, 0, 4, 3, 2.5, inward=True).values()]}
    camera = cameras.Camera(*CAMERA, looking([0.4, 0.4, 1.6], [3.0, 2.2, 0.6]))
    studio = small_scenes.Studio(
        tmp_path, walls | rooms.panel("rug", (3, 0.5, 0.01), (3.5, 0.5, 0.01), (3, 1, 0.01)), camera
    )
    artefact.write_npz(tmp_path / "coverage.npz", **studio.coverage)
    groups = {"rug": {"kind": "diffuse", "rho_d": [1.0] * 3}}
    found = {"groups": groups, "lamps": {"lamp": {"emittance": [0.5] * 3}}, "transfer": {"kind": "linear"}}
    artefact.write_json(tmp_path / "materials.json", found)
    image.write_png8(tmp_path / "left.png", np.full((84, 112), 128, np.uint8))
    names = {"model": "model.obj", "camera": "camera.cameramodel", "photograph": "left.png", "facet": "facet.png"}
    names |= {name: f"{name}.npz" for name in ("formfactors", "coverage")} | {"materials": "materials.json"}
    files = {name: str(tmp_path / file) for name, file in names.items()}
    egg = {"ellipsoid": [0.3, 0.4, 0.5], "at": [2, 1.5, 1], "rotate": [0.2, 0.1, 0.5], "material": {"kind": "mirror"}}
    read = augmented.read({"name": "x", "add": egg}, files)
    pair = differential.renderings(read.recovered, read.changed, QUALITY)
    assert pair.new.sum() > 300
    assert np.allclose(pair.after[read.changed.facet >= 0], 0.5, atol=5e-3)


def test_places_on_an_ellipsoid_are_on_it(scene):
    """By hand: a ray down the axis of a sphere, and one a little beside it."""
    ball = {"sphere": 0.5, "at": [2, 1, 1], "material": {"kind": "mirror"}}
    read = augmented.read({"name": "x", "add": ball}, scene).changed
    local = read.surface.local
    eye = local.points([[2, 1, 2.2], [2.1, 1, 2.2]])
    rays = np.hstack([eye, np.tile([0, 0, -1.0], (2, 1))]).astype(np.float32)
    triangle, t = read.surface.caster.closest(rays)
    facet = read.surface.facet[triangle]
    p = eye + t[:, None] * rays[:, 3:]
    p, n = read.curved.place(read.surface, facet, p, rays[:, 3:].astype(float))
    metres = p * local.diagonal + local.centre
    assert np.allclose(metres, [[2, 1, 1.5], [2.1, 1, 1 + np.sqrt(0.24)]], atol=1e-6)
    assert np.allclose(n, [[0, 0, 1], [0.2, 0, np.sqrt(0.96)]], atol=1e-6)


def test_only_touched_rays_are_cast_anew_and_all_of_them(scene):
    """Rows of the changed scene are those of casting every ray."""
    model = models.load(scene["model"])
    stored = factors_file.read(scene["formfactors"])
    before = surfaces.surface(model, ("lamp",))
    egg = changes.placed(changes.renamed(changes.ellipsoid([0.3, 0.2, 0.4], "a"), ["egg"]), np.eye(3), [1.5, 1, 0.8])
    from lib.given.model.parts import joined

    after = surfaces.surface(joined(changes.moved(model, "crate", [0.3, -0.2, 0]), "egg", egg), ("lamp",), before)
    found = changed_factors.changed(stored, before, after, ("lamp",))
    every = form_factors.rays(after, found.mesh, n_rays=256)
    there = np.flatnonzero(np.isin(found.mesh.side // 2, after.facet))
    for half in (None, 0, 1):  # of disjoint rays each, and so is their difference the sampling error
        difference = (found.rows.matrix(half) - every.matrix(half)).tocsr()[there]
        assert abs(difference).sum() < 2e-5 * every.matrix(half).sum()
    assert np.abs(found.rows.valid_half - every.valid_half)[there].max() <= 2
    assert np.abs(found.rows.valid - every.valid)[there].max() <= 2
    assert found.lamp_factor.shape == (len(found.mesh), 1) and (found.lamp_factor[there] >= 0).all()


def test_an_icosphere_is_closed_and_faces_outwards():
    ball = changes.ellipsoid([1, 1, 1], "ball", finer=2)
    assert len(ball.triangles) == 320 and (ball.facet_offset > 0.95).all()
    edges = np.sort(np.concatenate([ball.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_the_photographs_camera_shows_the_rendering(scene):
    own = made(scene, camera=scene["camera"])
    assert np.allclose(own.linear, rendered(scene), atol=0.02 * rendered(scene).max())
    assert own.bits == 8 and own.values.shape == (84, 112, 3)


def test_a_bent_lens_shows_the_pinholes_picture_bent(scene, tmp_path):
    path = tmp_path / "lens.cameramodel"
    text = Path(scene["camera"]).read_text().replace("LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4")
    path.write_text(text.replace("55.5, 41.5,", "55.5, 41.5, 0.0, 0.0, 0.0, 0.0,"))
    straight = made(scene, camera=str(path)).linear  # its coefficients are 0: resampled, and the same
    assert np.sqrt(np.mean((straight - made(scene, camera=scene["camera"]).linear) ** 2)) < 0.05
    path.write_text(text.replace("55.5, 41.5,", "55.5, 41.5, -0.05, 0.0, 0.0, 0.0,"))
    lens = lenses.read(path)
    camera, where = augmented._pinhole(lens)
    v = camera.directions(where)
    assert np.abs(lens.project(v) - np.stack(np.meshgrid(range(112), range(84)), axis=-1)).max() < 1e-6


def test_a_sequence_has_its_frames_and_a_film(scene, tmp_path):
    way = tmp_path / "way.csv"
    way.write_text("eye_x,eye_y,eye_z,at_x,at_y,at_z\n0.4,0.4,1.6,3,2.2,0.6\n0.8,0.4,1.6,3,2.2,0.6\n")
    read = augmented.read({"name": "x", "cameras": str(way), "frames": 3}, scene)
    shares = []
    count = augmented.sequence(read, QUALITY, tmp_path / "frames", tmp_path / "x.mp4", shares.append)["frames"]
    assert count == 3 and shares == [1 / 3, 2 / 3, 1]
    assert [p.name for p in sorted((tmp_path / "frames").iterdir())] == ["0001.png", "0002.png", "0003.png"]
    first = image.read_photograph(tmp_path / "frames" / "0001.png").values
    assert np.sqrt(np.mean((first - made(scene, camera=scene["camera"]).values / 255) ** 2)) < 0.03
    film = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 3 and film.read()[1].shape == (84, 112, 3)


def test_cameras_go_straight_and_turn_evenly(scene):
    a = lenses.read(scene["camera"])
    b = replace(a, T_cam_ref=looking([2.4, 0.4, 1.6], [3.0, 2.2, 0.6]))
    way = motion.between([a, b], 5)
    assert np.allclose([c.centre[0] for c in way], [0.4, 0.9, 1.4, 1.9, 2.4])
    turns = [
        np.arccos((np.trace(x.T_cam_ref[:3, :3] @ y.T_cam_ref[:3, :3].T) - 1) / 2) for x, y in itertools.pairwise(way)
    ]
    assert np.allclose(turns, turns[0])


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x,y\n1,2\n", "header: x,y is not eye_x,"),
        ("eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,0,1,0,0\n", "rows: 1 are less than two"),
        ("eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,0,1,0,0\n0,0,0,1,0\n", "line 3: 5 fields instead of 6"),
        ("eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,0,1,0,0\n0,0,0,1,0,q\n", "line 3: at_z: 'q' is not a number"),
        ("eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,0,1,0,0\n0,0,0,1,0,inf\n", "line 3: at_z: inf is not finite"),
        ("eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,0,1,0,0\n0,0,0,0,0,1\n", "line 3: at: "),
    ],
)
def test_a_way_that_cannot_be_gone(tmp_path, text, line):
    (tmp_path / "way.csv").write_text(text)
    with pytest.raises(BadInput) as refused:
        motion.read_csv(tmp_path / "way.csv")
    assert line in str(refused.value)


def test_saturated_light_is_the_renderings():
    """A lamp of 4.0 seen clipped: halved it is still clipped, at a tenth of it it is seen as 0.4."""
    shown = np.ones((1, 1, 1))
    seen = image.Photograph(shown, 8, False, 1)
    T, pair = Transfer("gamma", GAMMA), differential.Pair(4 * shown, 2 * shown, 0 * shown, {})
    assert differential.composed(seen, pair, T)[1].all()
    out, still = differential.composed(seen, replace(pair, after=0.4 * shown), T)
    assert not still.any() and np.allclose(out, 0.4)
    # less than half a step of 8 bits is no change
    half = image.Photograph(np.full((1, 1, 1), 128 / 255), 8, False, 1)
    light = (128 / 255) ** GAMMA
    slight = replace(pair, before=np.full((1, 1, 1), light), after=np.full((1, 1, 1), light * 1.008))
    assert differential.composed(half, slight, T)[1].all()
    assert not differential.composed(half, replace(slight, after=slight.before * 1.01), T)[1].any()


def test_noise_is_told_by_brightness():
    rng = np.random.default_rng(5)
    ramp = np.tile(np.linspace(0.05, 0.95, 200), (200, 1))[..., None]
    sigma = 0.005 + 0.02 * ramp
    curve = grain.noise_curve(ramp + sigma * rng.standard_normal(ramp.shape), ramp, np.ones((200, 200), bool))
    middle = (np.arange(grain.BINS) + 0.5) / grain.BINS
    assert np.abs(curve / (0.005 + 0.02 * middle) - 1)[1:-1].max() < 0.15


def test_a_painted_picture_hangs_upright(scene, tmp_path):
    """A wall with a picture of four colours: each quarter where a person before the wall would see it."""
    quarters = np.array([[[200, 0, 0], [0, 200, 0]], [[0, 0, 200], [200, 200, 0]]], np.uint8)
    image.write_png8(tmp_path / "flag.png", np.repeat(np.repeat(quarters, 8, axis=0), 8, axis=1))
    change = {"north": {"kind": "textured", "texture": str(tmp_path / "flag.png")}}
    read = augmented.read({"name": "x", "change": change}, scene).changed
    (f,) = np.flatnonzero(read.surface.group == read.groups.index("north"))
    # the north wall faces -y: a person before it has west on the left
    p = read.surface.local.points([[0.5, 3, 2.2], [3.5, 3, 2.2], [0.5, 3, 0.3], [3.5, 3, 0.3]])
    from lib.picture import albedo_maps

    seen = albedo_maps.lookup(read.appearance.maps[int(f)], read.surface, p)
    assert (seen > 0.3).tolist() == (quarters.reshape(4, 3) > 0).tolist()


@pytest.mark.scene
def test_the_stage_from_outside(scene, tmp_path, run, refuses):
    words = [w for name, path in scene.items() for w in (f"--{name}", path)]
    out = {name: tmp_path / f"x.{end}" for name, end in (("picture", "png"), ("exr", "exr"), ("report", "json"))}
    more = [w for name, path in out.items() for w in (f"--{name}", path)]
    entry = {"name": "x", "change": {"bottom": {"rho_d": [0.6, 0.2, 0.2]}}}
    done = run("stages/augment.py", *words, *more, "--rays", 32, "--entry", json.dumps(entry))
    assert done.returncode == 0, done.stderr
    picture = image.read_photograph(out["picture"])
    assert picture.bits == 8 and picture.values.shape == (84, 112, 3)
    assert json.loads(out["report"].read_text())["changed_pixels"] > 3000
    for path in out.values():
        path.unlink()
    for entry, line in (
        ({"name": "x", "remove": ["chair"]}, "entry: remove: 'chair' is none of room, lamp, crate"),
        ({"name": "x", "change": {"bottom": {"rho_d": [2, 0, 0]}}}, "entry.change.bottom.rho_d: [2, 0, 0] is outside"),
        (
            {"name": "x", "change": {"bottom": {"kind": "glossy", "rho_d": [0.9] * 3, "rho_s": [0.1] * 3}}},
            "alpha: is missing",
        ),
    ):
        (said,) = refuses("stages/augment.py", *words, *more, "--entry", json.dumps(entry))
        assert line in said
    assert not any(path.exists() for path in out.values())


def test_nothing_of_the_eye_goes_into_a_smooth_mirrors_inside(scene):
    """A mirror ball on the floor shows no black: all rays that it sends on meet the room."""
    ball = {"sphere": 0.3, "at": [2, 1, 0.3], "material": {"kind": "mirror"}}
    read = augmented.read({"name": "x", "add": ball}, scene)
    pair = differential.renderings(read.recovered, read.changed, QUALITY)
    inside = read.changed.curved.has(read.changed.facet)
    assert inside.sum() > 100 and pair.after[inside].min() > 0.02
    assert isinstance(read.changed.curved, curved.Curved)


@pytest.mark.slow
def test_a_smooth_glossy_ball_shows_its_lobe(scene):
    """Narrow and without a diffuse part it is a mirror ball, but for light that mirrors bring beside it."""
    quality, pictures = replace(QUALITY, lobe_rays=64), []
    ball = {"sphere": 0.4, "at": [2, 1, 0.8]}
    sharp = {"kind": "glossy", "rho_d": [0.0] * 3, "rho_s": [1.0] * 3, "alpha": [0.01, 0.01]}
    for material in ({"kind": "mirror"}, sharp, sharp | {"rho_s": [0.0] * 3}):
        read = augmented.read({"name": "x", "add": ball | {"material": material}}, scene)
        pictures.append(differential.renderings(read.recovered, read.changed, quality).after)
    shows = cv2.erode(read.changed.curved.has(read.changed.facet).astype(np.uint8), np.ones((3, 3))) > 0
    mirror, gloss, black = (picture[shows] for picture in pictures)
    assert len(mirror) > 200 and black.max() < 1e-9
    assert abs(np.median(gloss / mirror) - 1) < 0.03
    assert np.sqrt(np.mean((np.minimum(gloss, 1) - np.minimum(mirror, 1)) ** 2)) < 0.05


def test_a_mirror_ball_shows_the_lobe_of_a_floor(scene):
    """A floor that reflects in a lobe alone is not black in a ball above it."""
    floor = {"bottom": {"kind": "glossy", "rho_d": [0.0] * 3, "rho_s": [0.8] * 3, "alpha": [0.3, 0.3]}}
    ball = {"sphere": 0.4, "at": [2, 1, 0.8], "material": {"kind": "mirror"}}
    read = augmented.read({"name": "x", "add": ball, "change": floor}, scene)
    after = differential.renderings(read.recovered, read.changed, QUALITY).after
    shows = cv2.erode(read.changed.curved.has(read.changed.facet).astype(np.uint8), np.ones((3, 3))) > 0
    assert (after[shows].max(axis=1) > 0.02).all()


LOW = subjects.Quality(n_rays=16, shadow_rays=4, n_texels=2000, lobe_rays=8)
GREY = {"kind": "diffuse", "rho_d": [0.5] * 3}
ANYTHING = {
    "lamp removed": {"remove": ["lamp"]},
    "lamp moved": {"move": {"lamp": [0.3, 0.2, -0.3]}},
    "all at once": {
        "remove": ["crate"],
        "lamps": {"lamp": [5, 5, 6]},
        "change": {"north": {"kind": "mirror"}, "east": {"rho_d": [0.2, 0.3, 0.4]}},
        "add": [
            {"sphere": 0.2, "at": [2, 2, 0.2], "material": {"emittance": [3, 2, 1]}},
            {
                "ellipsoid": [0.3, 0.2, 0.2],
                "at": [2.6, 1.4, 0.3],
                "material": {"kind": "coloured_mirror", "rho_s": [1, 0.8, 0.5]},
            },
        ],
    },
    "glossy": {"change": {"bottom": {"kind": "glossy", "rho_d": [0.3] * 3, "rho_s": [0.4] * 3, "alpha": [0.2, 0.1]}}},
    "ball of plaster": {"add": {"sphere": 0.3, "at": [2, 1.2, 0.3], "material": GREY}},
    "half in the floor": {"add": {"sphere": 0.3, "at": [2, 1.2, 0.0], "material": GREY}},
}


@pytest.mark.parametrize("entry", ANYTHING.values(), ids=ANYTHING)
def test_any_change_gives_a_whole_picture(scene, entry):
    one = made(scene, LOW, **entry)
    assert np.isfinite(one.linear).all() and (one.linear >= 0).all()
    assert one.values.shape == (84, 112, 3) and one.facts["changed_pixels"] > 100


@pytest.mark.parametrize(
    "entry, line",
    [
        ({"add": {"sphere": 0.3, "at": [0.4, 0.4, 1.6], "material": GREY}}, "stands inside the object 'added 0'"),
        ({"move": {"crate": [-2.1, -1.5, 1.3]}}, "stands inside the object 'crate moved'"),
        ({"add": {"sphere": 100, "material": GREY}}, "m2 is too large for a scene of"),
        ({"change": {"crate": {"rho_s": [0.1] * 3}}}, "change.crate.rho_s: has no meaning for diffuse"),
        ({"change": {"crate": {"alpha": [0.1, 0.1]}}}, "change.crate.alpha: has no meaning for diffuse"),
    ],
)
def test_what_would_be_no_picture_is_refused(scene, entry, line):
    with pytest.raises(BadInput, match=line):
        augmented.read({"name": "x"} | entry, scene)


def test_a_file_of_many_mirrors_is_curved_and_one_of_few_is_not(scene, tmp_path):
    ball = changes.ellipsoid([0.3, 0.3, 0.3], "steel", finer=1)
    from lib.given.model import glb_writer

    glb_writer.write_glb(tmp_path / "ball.glb", ball)
    mirror = {"kind": "mirror"}
    for file, curved_ones in ((str(tmp_path / "ball.glb"), 80), (scene["model"].replace("model", "crate"), 0)):
        add = {"file": file, "at": [0, 0, 0.4], "material": {"steel": mirror} if curved_ones else mirror}
        read = augmented.read({"name": "x", "remove": ["crate"], "add": add}, scene).changed
        found = 0 if read.curved is None else int(read.curved.mirror.sum())
        assert found == curved_ones and (read.appearance.finish is None) == (curved_ones > 0)
        assert np.isfinite(made(scene, LOW, remove=["crate"], add=add).linear).all()


def test_a_file_without_materials_has_the_entrys(scene, tmp_path):
    """As programs write a mesh that nobody painted. A material for each group does not say which is meant."""
    from lib.given.model import glb_writer

    file = tmp_path / "bare.glb"
    glb_writer.write_glb(file, models.load(scene["model"].replace("model", "crate")))
    content = file.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    gltf = json.loads(content[20 : 20 + length])
    for mesh in gltf["meshes"]:
        for primitive in mesh["primitives"]:
            del primitive["material"]
    del gltf["materials"], gltf["extras"]
    text = json.dumps(gltf).encode().ljust(length)
    file.write_bytes(content[:20] + text + content[20 + length :])
    obj = tmp_path / "bare.obj"
    lines = Path(scene["model"].replace("model", "crate")).read_text().splitlines()
    obj.write_text("\n".join(line for line in lines if not line.startswith("usemtl")))
    green = {"kind": "diffuse", "rho_d": [0.1, 0.6, 0.1]}
    where = {"at": [-1.0, 0, 0], "material": green}
    painted = made(scene, add={"file": scene["model"].replace("model", "crate"), **where})
    for bare in (file, obj):
        put = made(scene, add={"file": str(bare), **where})
        assert put.facts["changed_pixels"] > 500 and (abs(put.values - painted.values) <= 3).all()
        with pytest.raises(BadInput, match="has no material"):
            made(scene, add={"file": str(bare), "material": {"crate": green}})


def test_a_grey_photograph_stays_grey(scene, tmp_path):
    values = image.read_photograph(scene["photograph"]).values.mean(axis=2)
    image.write_png8(tmp_path / "left.png", np.round(255 * values).astype(np.uint8))
    grey = scene | {"photograph": str(tmp_path / "left.png")}
    same = made(grey)
    assert same.values.shape == (84, 112, 1) and (same.values == photograph(grey)).all()
    reddish = made(grey, LOW, change={"bottom": {"rho_d": [0.9, 0.3, 0.3]}})  # as bright as 0.5, which it was
    assert np.abs(reddish.values - photograph(grey)).max() <= 1


def test_a_linear_photograph_is_changed_as_it_is(scene, tmp_path):
    """An EXR has no steps: what no light reaches stays to the last bit, a lamp twice as bright adds what it adds."""
    linear = 1.5 * rendered(scene)
    image.write_exr(tmp_path / "left.exr", linear)
    found = json.loads(Path(scene["materials"]).read_text()) | {"transfer": {"kind": "linear"}}
    artefact.write_json(tmp_path / "materials.json", found)
    files = scene | {"photograph": str(tmp_path / "left.exr"), "materials": str(tmp_path / "materials.json")}
    stored = image.read_exr(tmp_path / "left.exr")
    assert (made(files).linear == stored).all()
    brighter = made(files, lamps={"lamp": [18, 18, 18]})
    assert np.median(np.abs(brighter.linear - stored - rendered(scene))) < 0.01 and brighter.bits == 8


def test_shares_are_no_wider_than_the_model(scene):
    """Columns are picked of them, which takes memory for every column."""
    subject = subjects.read(**scene)
    n = subject.view.model.n_facets
    shares = differential.shares(subject, n)
    assert shares.shape == (84 * 112, n + 1) and np.allclose(shares.sum(axis=1), 1)
    pure, facet = subject.pure.reshape(-1), subject.facet.reshape(-1)
    assert (shares[np.flatnonzero(pure), facet[pure]] == 1).all()


@pytest.mark.slow
def test_noise_of_gathered_light_is_told(scene, monkeypatch):
    """By gathering rays alone a narrow lobe on the floor is noisy, and told to be as noisy as many rays show."""
    gloss = {"change": {"bottom": {"kind": "glossy", "rho_d": [0.2] * 3, "rho_s": [0.75] * 3, "alpha": [0.03] * 2}}}
    shown = lambda made: np.clip(made.linear, 0, 1) ** (1 / GAMMA)
    best = shown(made(scene, replace(QUALITY, n_rays=4096), **gloss))
    sought = made(scene, **gloss)
    monkeypatch.setattr(glints, "LARGE", 2.0)  # no plane is large enough to be sought by
    met = made(scene, **gloss)
    read = subjects.read(**scene)
    walls = np.isin(read.group, [read.groups.index(n) for n in ("top", "west", "east", "south", "north")])
    walls &= read.pure
    off, off_met = (np.sqrt(((shown(m) - best)[walls] ** 2).mean()) for m in (sought, met))
    told, told_met = (max(m.facts["noise"][n] for n in ("east", "north")) for m in (sought, met))
    assert off < off_met / 2 and told < told_met / 2
    assert 0.5 * off_met < told_met < 4 * off_met
    assert "east" in differential.mottled(met.facts["noise"])
