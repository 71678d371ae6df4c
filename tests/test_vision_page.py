"""The vision half of report.html: a section for what there is, nothing for what there is not, never a NaN."""
from pathlib import Path

import numpy as np
import pytest

from lib import cameras, model as models, page, vision_page
from tests.test_page import sane

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def office():
    model = models.load(ROOT / "data/office/model.obj")
    left = cameras.read_cameramodel(ROOT / "data/office/left.posed.cameramodel")
    pair = {"left": cameras.Camera(left.K, left.width, left.height, np.eye(4)), "right": cameras.Camera(left.K, left.width, left.height, cameras.matrix_from_rt([0, .1, 0, -.4, 0, 0]))}
    return model, left, pair


def seen(office, **changes):
    model, left, pair = office
    rt = [float(x) for x in cameras.rt_from_matrix(left.T_cam_world)]
    grey = np.full((left.height, left.width, 1), 0.5)
    regions = np.ones((left.height, left.width), int)
    regions[:, 300:] = 2
    facet = {"left_label": 2, "right_label": 1, "plane": {"n": [0, 0, -1.0], "d": -3.0}, "polygon": [[0, 0, 3], [1, 0, 3], [1, 1, 3]], "overlap": 0.93, "covariance": (np.eye(3) * 1e-6).tolist()}
    there = dict(model=model, cameras=pair, photographs={"left": grey, "right": grey}, regions={"left": regions, "right": regions}, matches=[(2, 1, 0.9)],
                 facets={"frame": "left", "unit": "m", "facets": [facet]}, calibration=None, orientation=None,
                 pose={"rt_cam_world": rt, "covariance": (np.eye(6) * 1e-8).tolist(), "matches": [{"left_label": 2, "facet": 3}], "ambiguous": [],
                       "trace": [{"iteration": 0, "step": "linear", "error_px": None, "rt_cam_world": [r + 0.01 for r in rt]}, {"iteration": 1, "step": "refined", "error_px": 0.2, "rt_cam_world": rt}]})
    return vision_page.see(**{**there, **changes})


def built(vision):
    text = page.build(page.Parts(scene="room", vision=vision))
    sane(text)
    return text


def test_everything_is_shown(office):
    text = built(seen(office))
    for title in ("Regions", "Facets in space", "Where the camera is"):
        assert f"<h2>{title}</h2>" in text
    assert "after the linear step" in text and "after iteration 1: 0.2 px" in text and "<h2>Lenses</h2>" not in text
    assert office[0].objects[office[0].facet_object[3]] in text                  # the facet of the model by its name
    assert text.count("<svg viewBox") >= 6                                       # facets, result and linear step over both photographs


def test_wireframes_are_where_the_model_is(office):
    """The lines of the posed model cross the pixels of its visible edges."""
    model, left, pair = office
    wire = seen(office).wires[-1]["left"]
    from lib import index_buffer
    buffer = index_buffer.reference(model, left)
    edges = index_buffer.visible_edges(model, left, buffer.facet, buffer.depth)
    ends = np.rint(wire.reshape(-1, 2)).astype(int).clip(0, [left.width - 1, left.height - 1])
    assert edges[ends[:, 1], ends[:, 0]].mean() > 0.99 and len(wire) > 50


@pytest.mark.parametrize("missing", ["photographs", "regions", "cameras"])
def test_what_is_missing_is_left_out(office, missing):
    built(seen(office, **{missing: {}}))


def test_no_match_no_facet_no_pose(office):
    text = built(seen(office, matches=[], facets={"frame": "left", "unit": "m", "facets": []}, pose=None))
    assert "0 % of the picture is matched" in text and "Facets in space" not in text and "Where the camera is" not in text


def test_other_poses_are_said(office):
    pose = seen(office).pose
    text = built(seen(office, pose={**pose, "ambiguous": [{"rt_cam_world": pose["rt_cam_world"]}]}))
    assert "1 other pose would explain" in text and ">Ambiguous</span>" in text and "The pose is ambiguous" in text


def test_lenses_in_words_and_colours(office):
    camera = {"lens": "LENSMODEL_OPENCV8", "size": [640, 480], "fx": 500.0, "fy": 501.0, "cx": 320.0, "cy": 240.0, "rms": 0.1, "boards": 12, "corners": 648, "outliers": 2,
              "uncertainty": {"distance_m": 3.0, "centre_px": 0.2, "sigma_px": [[0.1, None], [20.0, 0.01]]}}
    calibration = {"verdict": "good to 0.2 px at 3 m", "cameras": {"left": camera, "right": camera}, "pair": {"baseline_m": 0.4, "baseline_sigma_m": 0.001, "angle_deg": 6.0}}
    text = built(seen(office, calibration=calibration, orientation={"inliers": 120, "rms_px": 0.4, "angle_deg": 6.2}))
    assert "Good to 0.2 px at 3 m." in text and "400 ± 1 mm apart, axes 6° apart" in text and "120 point matches" in text
    unknown = {**camera, "uncertainty": {"sigma_px": None}, "rms": None}
    assert "<h2>Lenses</h2>" in built(seen(office, calibration={"verdict": None, "cameras": {"left": unknown}, "pair": {}}))
