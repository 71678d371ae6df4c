"""The comparison of the vision half, against errors that were put in by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lib.buffers import index_buffer
from lib.given import cameras
from lib.given import model as models
from lib.verdict import vision_errors
from lib.verdict.answers import Answers
from lib.verdict.records import Pose
from lib.vision.facets_file import Facet, Plane

ROOT = Path(__file__).resolve().parents[1]


def values(rows):
    return {name: value for name, value, unit in rows}


@pytest.fixture(scope="module")
def office():
    model = models.load(ROOT / "data/office/model.obj")
    camera = cameras.read_cameramodel(ROOT / "data/office/left.posed.cameramodel")
    return model, camera, index_buffer.reference(model, camera)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 90.0, 179.9999])
def test_the_angle_of_a_rotation(angle):
    R = cameras.matrix_from_rt([*np.radians(angle) * np.array([0.6, 0.0, 0.8]), 0, 0, 0])[:3, :3]
    assert vision_errors.angle_deg(R) == pytest.approx(angle, abs=1e-9, rel=1e-6)


def test_a_camera_turned_and_moved(office):
    model, camera, buffer = office
    turn = cameras.matrix_from_rt([0, np.radians(0.1), 0, 0, 0, 0])
    T = turn @ camera.T_cam_world
    assert values(vision_errors.pose(T, camera.T_cam_world)) == pytest.approx(
        {"pose.angle_deg": 0.1, "pose.centre_mm": 0}, abs=1e-9
    )
    moved = camera.T_cam_world.copy()
    moved[:3, 3] += [0.003, 0, 0.004]
    assert values(vision_errors.pose(moved, camera.T_cam_world)) == pytest.approx(
        {"pose.angle_deg": 0, "pose.centre_mm": 5}, abs=1e-9
    )

    sigma = np.array([1, 1, 1, 2, 2, 4.0]) * 1e-3
    assert values(vision_errors.pose(moved, camera.T_cam_world, np.diag(sigma**2)))["pose.in_sigmas"] == pytest.approx(
        np.sqrt(((3 / 2) ** 2 + 1) / 6)
    )

    def project(p):
        return (p / p[:, 2:]) @ camera.K.T[:, :2]

    found = values(
        vision_errors.vertices(
            project, project, T, camera.T_cam_world, model, buffer.depth, (camera.width, camera.height)
        )
    )
    f = camera.K[0, 0]
    assert (
        0.9 * f * np.radians(0.1) < found["pose.vertices_px"] < 1.5 * f * np.radians(0.1)
    )  # f tan of the turn, more towards the edges
    assert 8 <= found["pose.vertices"] < len(model.vertices)
    everything = values(vision_errors.vertices(project, project, T, T, model, None, (camera.width, camera.height)))
    assert everything["pose.vertices"] > found["pose.vertices"] and everything["pose.vertices_max_px"] == 0


def test_two_lenses(office):
    _, camera, _ = office
    longer = camera.K * np.array([[1.01], [1.01], [1]])
    longer[:2, 2] = camera.K[:2, 2]

    def of(K):
        return lambda q: np.column_stack(
            [(q - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(len(q))]
        ), lambda p: (p / p[:, 2:]) @ K.T[:, :2]

    (unproject, _), (unproject_longer, _) = of(camera.K), of(longer)
    assert (
        values(vision_errors.lens(unproject, of(camera.K)[1], unproject, (640, 480), "left"))["lens.left.projection_px"]
        < 1e-9
    )
    error = values(vision_errors.lens(unproject_longer, of(camera.K)[1], unproject, (640, 480), "left"))[
        "lens.left.projection_px"
    ]
    x, y = np.meshgrid(np.linspace(0, 639, 21) - camera.K[0, 2], np.linspace(0, 479, 16) - camera.K[1, 2])
    assert error == pytest.approx(
        0.01 / 1.01 * np.sqrt((x**2 + y**2).mean()), rel=0.1
    )  # a longer lens: each pixel 1 % further out


def test_true_planes_have_no_error_and_moved_ones_the_error_of_the_move(office):
    model, camera, buffer = office
    T, facets = camera.T_cam_world, []
    for label in np.argsort(-np.bincount(buffer.facet.ravel())[1:])[:4] + 1:
        y, x = np.nonzero(buffer.facet == label)
        n = T[:3, :3] @ model.facet_normal[label - 1]
        d = model.facet_offset[label - 1] + n @ T[:3, 3]
        if d > 0:
            n, d = -n, -d
        v = camera.directions(np.column_stack([x, y]))
        p = v / (v @ (n / d))[:, None]
        facets.append(Facet(label, plane=Plane(n, d), polygon=p[:: max(1, len(p) // 5)], covariance=np.eye(3) * 1e-12))
    assert len(facets) >= 2
    found = values(vision_errors.planes(facets, T, model, buffer.facet, buffer.facet))
    assert (
        found["facets.angle_deg"] < 1e-6
        and found["facets.distance_relative"] < 1e-12
        and found["facets.wrong"] == 0
        and found["facets.within_95"] == 1
    )
    further = [replace(f, plane=Plane(f.plane.n, f.plane.d * 1.1)) for f in facets]
    found = values(vision_errors.planes(further, T, model, buffer.facet, buffer.facet))
    assert (
        found["facets.distance_relative"] == pytest.approx(0.1, rel=1e-6)
        and found["facets.wrong"] == 1
        and found["facets.within_95"] == 0
    )


def test_the_disparity_of_a_frontal_plane():
    """d = f b / z, everywhere."""
    K = np.array([[500.0, 0, 50], [0, 500, 40], [0, 0, 1]])
    left = cameras.Camera(K, 100, 80, np.eye(4))
    right = cameras.Camera(K, 100, 80, cameras.matrix_from_rt([0, 0, 0, -0.1, 0, 0]))
    regions = np.zeros((80, 100), int)
    regions[:, :50] = 3
    facet = Facet(3, plane=Plane((0, 0, -1.0), -2.0))
    true = np.full((80, 100), 25.5)
    true[0] = np.nan
    found = values(vision_errors.disparity([facet], left, right, regions, true))
    assert found == pytest.approx({"disparity.median_px": 0.5, "disparity.bad_1px": 0, "disparity.covered": 0.5})


def test_what_is_missing_is_left_out(office):
    """Only what both sides have is compared: a pose without a model has no vertices, without truth there is nothing."""
    model, camera, buffer = office
    rt = tuple(cameras.rt_from_matrix(camera.T_cam_world))
    found, true = Answers(pose=Pose(rt)), Answers(posed=camera)
    names = [name for _, name, _, _ in vision_errors.against_truth(found, true)]
    assert names == ["pose.angle_deg", "pose.centre_mm"]
    found = replace(found, model=model, posed=camera, depth=buffer.depth)
    errors = {name: value for _, name, value, _ in vision_errors.against_truth(found, true)}
    assert errors["pose.vertices_max_px"] < 1e-9 and errors["pose.vertices"] > 8
    assert vision_errors.against_truth(found, Answers()) == [] == vision_errors.against_truth(Answers(), true)


def test_a_symmetric_pose_is_compared_with_its_nearest_equal(office):
    """A model that comes onto itself after half a turn: either pose is as true as the other."""
    _, camera, _ = office
    half = cameras.matrix_from_rt([0, 0, np.pi, 4.0, 3.0, 0])
    moved = cameras.matrix_from_rt([0, 0, 0, 0.003, 0, 0]) @ camera.T_cam_world @ half
    rt = cameras.rt_from_matrix
    said = {
        "rt_cam_world": tuple(rt(moved)),
        "covariance": np.eye(6).tolist(),
        "ambiguous": [{"rt_cam_world": rt(moved @ half)}],
    }
    far, near = (
        values(
            (*row[1:],)
            for row in vision_errors.against_truth(Answers(pose=Pose(**said, status=status)), Answers(posed=camera))
        )
        for status in ("ambiguous", "symmetric")
    )
    assert far["pose.angle_deg"] == pytest.approx(180) and near["pose.angle_deg"] == pytest.approx(0, abs=1e-6)
    assert near["pose.centre_mm"] == pytest.approx(3, abs=1e-6)
