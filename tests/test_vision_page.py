"""The vision half of the page: a section for what there is, nothing for what there is not, never a NaN."""

from pathlib import Path

import numpy as np
import pytest

from lib.buffers import edges, index_buffer
from lib.core import record
from lib.given import cameras
from lib.given import model as models
from lib.verdict import records
from lib.verdict.page import build, space, vision
from lib.verdict.page.parts import Parts
from lib.vision import facets_file
from tests.helpers.html import sane

ROOT = Path(__file__).resolve().parents[1]
RECORDS = {
    "facets": facets_file.Facets,
    "pose": records.Pose,
    "calibration": records.Calibration,
    "orientation": records.Orientation,
}


@pytest.fixture(scope="module")
def office():
    model = models.load(ROOT / "data/office/model.obj")
    left = cameras.read_cameramodel(ROOT / "data/office/left.posed.cameramodel")
    pair = {
        "left": cameras.Camera(left.K, left.width, left.height, np.eye(4)),
        "right": cameras.Camera(left.K, left.width, left.height, cameras.matrix_from_rt([0, 0.1, 0, -0.4, 0, 0])),
    }
    return model, left, pair


def files(office):
    """JSON and pictures as the stages leave them: a facet that is matched with the model's, a pose in two steps."""
    model, left, pair = office
    rt = [float(x) for x in cameras.rt_from_matrix(left.T_cam_world)]
    grey = np.full((left.height, left.width, 1), 0.5)
    regions = np.ones((left.height, left.width), int)
    regions[:, 300:] = 2
    facet = {
        "left_label": 2,
        "right_label": 1,
        "plane": {"n": [0, 0, -1.0], "d": -3.0},
        "polygon": [[0, 0, 3], [1, 0, 3], [1, 1, 3]],
        "overlap": 0.93,
        "covariance": (np.eye(3) * 1e-6).tolist(),
    }
    steps = [
        {"iteration": 0, "step": "linear", "error_px": None, "rt_cam_world": [r + 0.01 for r in rt]},
        {"iteration": 1, "step": "refined", "error_px": 0.2, "rt_cam_world": rt},
    ]
    return {
        "model": model,
        "cameras": pair,
        "photographs": {"left": grey, "right": grey},
        "regions": {"left": regions, "right": regions},
        "surfaces": {"left": regions, "right": regions},
        "matches": [(2, 1, 0.9)],
        "facets": {"frame": "left", "unit": "m", "facets": [facet]},
        "pose": {
            "rt_cam_world": rt,
            "covariance": (np.eye(6) * 1e-8).tolist(),
            "matches": [{"left_label": 2, "facet": 3}],
            "ambiguous": [],
            "trace": steps,
        },
    }


def seen(office, **changes):
    """vision.Vision of the files, some of them changed."""
    content = files(office) | changes
    for name, cls in RECORDS.items():
        content[name] = record.of(content[name], f"{name}.json", cls) if content.get(name) else None
    return vision.see(**content)


def built(vision):
    return sane(build.page(Parts(scene="room", vision=vision)))


def test_everything_is_shown(office):
    page = built(seen(office))
    assert page.titles == ["Regions", "Facets in space", "Where the camera is"]
    model = office[0]
    name = f"{model.objects[model.facet_object[3]]}, {model.groups[model.facet_group[3]]}"
    sigma = 3**2 * 1e-3  # of z = 1 / m_z, at the facet's middle 3 m away, almost straight ahead
    (row,) = page.section("Facets in space").one("table").rows()
    assert row[:2] == ["2", "3.000"] and float(row[2]) == pytest.approx(sigma, rel=0.1)
    beyond = float(row.pop().replace("\u2212", "-"))
    assert row[3:] == ["93 %", "–", name] and beyond == pytest.approx(seen(office).beyond_m[2], abs=6e-4)
    assert [caption.text for caption in page.section("Where the camera is").all("figcaption")] == [
        "Left, after iteration 1: 0.2 px",
        "Right, after iteration 1: 0.2 px",
        "Left, after the linear step",
        "Right, after the linear step",
    ]
    verdict = page.section("Where the camera is").one("p", "verdict").text
    assert verdict == "Known to 0.0099° and 0.17 mm (1 σ); 1 facet matched."
    assert [figure.text for figure in page.section("Regions").all("figcaption")] == [
        "Left: 2 regions",
        "Right: 2 regions",
        "Left: 2 surfaces",
        "Right: 2 surfaces",
        "Left: 53 % of the picture is matched",
        "Right: 47 % of the picture is matched",
    ]
    views = [caption.text for caption in page.section("Facets in space").all("figcaption")][2:]
    assert len(views) == 3 and views[0].startswith("From above")
    assert all(picture.attributes["alt"] for picture in page.all("img"))
    assert len(page.all("svg")) == 6  # facets, result and linear step over both photographs


def test_wireframes_are_where_the_model_is(office):
    """The lines of the posed model cross the pixels of its visible edges."""
    model, left, _ = office
    wire = seen(office).wires[-1].left
    buffer = index_buffer.reference(model, left)
    visible = edges.visible_edges(model, left, buffer.facet, buffer.depth)
    ends = np.rint(wire.reshape(-1, 2)).astype(int).clip(0, [left.width - 1, left.height - 1])
    assert visible[ends[:, 1], ends[:, 0]].mean() > 0.99 and len(wire) > 50


def of_the_model(office, facet, factor=1.0):
    """A facet of facets.json that is one of the model's as the left camera sees it, `factor` times as far away."""
    model, left, _ = office
    vertices = np.unique(model.vertices[model.triangles[model.triangle_facet == facet]].reshape(-1, 3), axis=0)
    T = left.T_cam_world
    polygon = factor * (vertices @ T[:3, :3].T + T[:3, 3])
    n = T[:3, :3] @ model.facet_normal[facet]
    return {
        "left_label": 2,
        "plane": {"n": n.tolist(), "d": float(n @ polygon[0])},
        "polygon": polygon.tolist(),
        "overlap": 1.0,
        "covariance": (np.eye(3) * 1e-6).tolist(),
    }


@pytest.mark.parametrize("factor", [1.0, 0.9])
@pytest.mark.parametrize("scale", [None, 0.4])
def test_facets_lie_against_the_model(office, factor, scale):
    """A true facet lies on its place of the model; one that is a tenth too near is drawn and said to be so."""
    facet = of_the_model(office, 3, factor)
    if scale:  # in baselines
        facet["polygon"] = (np.array(facet["polygon"]) / scale).tolist()
    unit = "baseline" if scale else "m"
    pose = files(office)["pose"] | {"scale": scale}
    found = seen(office, facets={"frame": "left", "unit": unit, "facets": [facet]}, pose=pose)
    (ring,) = found.in_space.facets
    assert found.in_space.matched == [True]
    middle = ring.mean(axis=0)
    assert found.beyond_m[2] == pytest.approx(np.linalg.norm(middle) * (1 / factor - 1), abs=1e-9)
    corners = np.concatenate([found.in_space.model, found.in_space.seen]).reshape(-1, 3)
    nearest = np.linalg.norm(corners - ring[:, None] / factor, axis=2).min(axis=1)
    assert nearest.max() < 1e-9 and len(found.in_space.seen) > 20


def test_views_of_space_are_across_the_axis(office):
    """What is moved along the left camera's axis moves up the picture from above, and to the left from its left."""
    found = seen(office).in_space
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0.0]])
    place = lambda axes, p: axes[:2] @ p
    for axes, ahead in ((space.ABOVE, [0, -1]), (space.SIDE, [-1, 0])):
        np.testing.assert_allclose(place(axes, np.array([0, 0, 1.0])), ahead, atol=1e-12)
    for _, axes in space.VIEWS:
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)
        picture = space.drawn(found._replace(facets=[square + [0, 0, 3]], matched=[True]), axes, 300)
        assert picture.shape[1] == 300 and 90 <= picture.shape[0] <= 300
        assert (picture == space.MATCHED).all(axis=2).sum() > 50  # its outline
        assert not (picture == space.OTHER).all(axis=2).any()
    assert space.views(found._replace(facets=[], matched=[]), 300) == []


@pytest.mark.parametrize(
    "missing, titles, pictures",
    [
        ("photographs", ["Regions", "Facets in space", "Where the camera is"], 9),
        ("regions", ["Regions", "Facets in space", "Where the camera is"], 13),
        ("surfaces", ["Regions", "Facets in space", "Where the camera is"], 11),
        ("cameras", ["Regions", "Facets in space", "Where the camera is"], 6),
    ],
)
def test_what_is_missing_is_left_out(office, missing, titles, pictures):
    page = built(seen(office, **{missing: {}}))
    assert page.titles == titles and len(page.all("img")) == pictures


def test_no_match_no_facet_no_pose(office):
    page = built(seen(office, matches=[], facets={"frame": "left", "unit": "m", "facets": []}, pose=None))
    assert page.titles == ["Regions"]
    captions = [caption.text for caption in page.section("Regions").all("figcaption")]
    assert captions[4:] == ["Left: 0 % of the picture is matched", "Right: 0 % of the picture is matched"]


def test_other_poses_are_said(office):
    pose = files(office)["pose"]
    page = built(seen(office, pose=pose | {"ambiguous": [{"rt_cam_world": pose["rt_cam_world"]}]}))
    assert "1 other pose would explain the facets as well." in page.section("Where the camera is").text
    assert page.one("span", "badge").text == "Ambiguous" and "The pose is ambiguous: 1 other" in page.text
    page = built(
        seen(office, pose=pose | {"status": "symmetric", "ambiguous": [{"rt_cam_world": pose["rt_cam_world"]}]})
    )
    assert page.one("span", "badge").text != "Ambiguous"
    assert "the model comes onto itself: as good as 1 other pose." in page.section("Where the camera is").text


CAMERA = {
    "lens": "LENSMODEL_OPENCV8",
    "size": [640, 480],
    "fx": 500.0,
    "fy": 501.0,
    "cx": 320.0,
    "cy": 240.0,
    "rms": 0.1,
    "boards": 12,
    "corners": 648,
    "outliers": 2,
    "uncertainty": {"distance_m": 3.0, "centre_px": 0.2, "sigma_px": [[0.1, None], [20.0, 0.01]]},
}


def test_lenses_in_words_and_colours(office):
    calibration = {
        "verdict": "good to 0.2 px at 3 m; boards do not reach the top left",
        "cameras": {"left": CAMERA, "right": CAMERA},
        "pair": {"baseline_m": 0.4, "baseline_sigma_m": 0.001, "angle_deg": 6.0},
    }
    orientation = {"inliers": 120, "rms_px": 0.4, "angle_deg": 6.2}
    section = built(seen(office, calibration=calibration, orientation=orientation)).section("Lenses")
    assert section.one("p", "verdict").text == "Good to 0.2 px at 3 m."
    assert [item.text for item in section.all("li")] == ["Boards do not reach the top left."]
    numbers = ["500", "501", "320", "240", "0.1", "12 boards, 648 corners, 2 of them outliers"]
    assert section.one("table").rows() == [[side, "OPENCV8", *numbers] for side in ("left", "right")]
    assert "The cameras stand 400 ± 1 mm apart, axes 6° apart." in section.text
    assert "up to scale: 120 point matches, 0.4 px rms, axes 6.2° apart." in section.text
    assert len(section.all("img")) == 2 and section.all("figcaption")[0].text.endswith(
        "0.2 px at most over the middle of the picture"
    )


def test_a_lens_whose_uncertainty_is_not_known(office):
    unknown = {**CAMERA, "uncertainty": {"sigma_px": None}, "rms": None}
    calibration = {"verdict": None, "cameras": {"left": unknown}, "pair": None}
    section = built(seen(office, calibration=calibration)).section("Lenses")
    (row,) = section.one("table").rows()
    assert row[6] == "–" and not section.all("img") and "apart" not in section.text


def test_colours_of_uncertainty():
    """Grey where it is not known, the ends of the scale beyond them."""
    shown = vision.uncertainty_colours(np.array([np.nan, 1e-6, vision.LOW_PX, vision.HIGH_PX, 1e6]))
    low, high = vision.UNCERTAINTY_COLOURS[[0, -1]].astype(int)
    assert shown.tolist() == [[128] * 3, list(low), list(low), list(high), list(high)]
