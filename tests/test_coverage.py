"""The A-buffer and the hidden-surface buffer."""

import numpy as np
import pytest

from lib.buffers import coverage as a_buffer
from lib.buffers import edges, index_buffer, opengl
from lib.given import model as models
from tests.helpers.boxes import Objects, coverage_if_possible, draw_if_possible, forward, look, pixel_shares, room


@pytest.fixture
def load(tmp_path):
    return lambda objects, **options: models.load(objects.write(tmp_path / "model.obj", **options))


@pytest.fixture(params=["opengl", "rays"])
def draw(request):
    return draw_if_possible if request.param == "opengl" else index_buffer.reference


@pytest.fixture(params=["opengl", "rays"])
def coverage(request):
    return lambda model, camera, facet: coverage_if_possible(model, camera, facet, request.param)


def test_coverage_by_hand(load, draw, coverage):
    """A facet from x = 0.75 px rightwards and y = -9 to 1.25 px.

    It covers 3/4 of pixel (1, 0), 3/4 of (2, 1) below, and so on.
    """
    model = load(Objects().add("t", [(0.75, -9, 1), (9, -9, 1), (9, 1.25, 1), (0.75, 1.25, 1)], [(0, 1, 2, 3)]))
    camera = forward(4, 3, np.eye(3))
    index = draw(model, camera)
    assert pixel_shares(coverage(model, camera, index.facet)) == {1: {0: 48}, 5: {0: 36}, 6: {0: 48}, 7: {0: 48}}


@pytest.mark.parametrize("seed", range(3))
def test_coverage_both_ways(load, seed):
    model = load(room(seed))
    camera = look((0.2, 0.2 + seed, 1.5), (3, 2.5, 1))
    facet = index_buffer.reference(model, camera).facet
    try:
        drawn = a_buffer.coverage(model, camera, facet, "opengl")
    except opengl.NoGraphics:
        drawn = a_buffer.coverage(model, camera, facet, "rays")
    a, b = pixel_shares(drawn), pixel_shares(a_buffer.coverage(model, camera, facet, "rays"))
    assert all(sum(shares.values()) == 64 for shares in a.values())  # nothing is empty in a closed room
    whole = {p: {int(facet.ravel()[p]): 64} for p in {*a, *b}}
    wrong = [
        sum(abs(shares.get(f, 0) - b.get(p, whole[p]).get(f, 0)) for f in {*shares, *b.get(p, whole[p])}) / 2
        for p, shares in (whole | a).items()
    ]
    assert max(wrong) <= 3 and np.mean(wrong) < 0.05


def test_coverage_sums_to_the_area(load, coverage):
    """A square of 100.3 x 50.7 px covers that many pixels, to the 64th parts that its edges leave open."""
    model = load(
        Objects().add("t", [(x, y, 3) for x, y in ((0, 0), (1.003, 0), (1.003, 0.507), (0, 0.507))], [(0, 1, 2, 3)])
    )
    camera = forward()
    facet = index_buffer.reference(model, camera).facet
    share = (facet == 0).astype(float).ravel()
    arrays = coverage(model, camera, facet)
    share[arrays["pixel"]] = np.add.reduceat(np.append(arrays["count"], 0), arrays["start"][:-1]) / 64
    assert np.isclose(share.sum(), 100.3 * 50.7, atol=0.13 * (100.3 + 50.7))


@pytest.mark.parametrize("width_px", [0.3, 0.6])
def test_a_sliver_thinner_than_a_pixel_is_found(load, coverage, width_px):
    """Between pixel centres: the index buffer does not see it, the A-buffer and the hidden-surface buffer do."""
    x0, x1 = (np.array([20.51, 20.51 + width_px]) - 0.3 - 159.5) / 100
    scene = Objects().add("wall", [(-9, -9, 9), (9, -9, 9), (9, 9, 9), (-9, 9, 9)], [(0, 1, 2, 3)])
    model = load(scene.add("rod", [(x0, -0.5, 3), (x1, -0.5, 3), (x1, 0.5, 3), (x0, 0.5, 3)], [(0, 1, 2, 3)]))
    camera = forward()
    index = index_buffer.reference(model, camera)
    shares = pixel_shares(coverage(model, camera, index.facet))
    middle = [shares[120 * 320 + x].get(1, 0) / 64 for x in range(18, 24) if 120 * 320 + x in shares]
    assert np.isclose(sum(middle), width_px, atol=0.13)
    if width_px < 0.5:
        assert (index.facet != 1).all()
    crossed = edges.visible_edges(model, camera, index.facet, index.depth)
    assert crossed[100:140, 19:23].any(axis=1).all()


def test_hidden_edges_are_hidden(load, draw):
    """A square behind a larger one leaves no edge; in front of it, its outline."""
    front, behind = [
        [(s * x, s * y, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))] for s, z in ((1, 3), (0.5, 4))
    ]
    camera = forward()
    for name, small, others in (("behind", behind, front), ("before", [(x, y, 2) for x, y, _ in behind], front)):
        model = load(Objects().add("large", others, [(0, 1, 2, 3)]).add("small", small, [(0, 1, 2, 3)]))
        index = draw(model, camera)
        inside = edges.visible_edges(model, camera, index.facet, index.depth)[30:210, 70:250]
        assert inside.any() == (name == "before")


def test_edges_inside_a_facet_are_none(load, draw):
    """The diagonal that cuts a square into triangles, and the seam of two polygons of one facet, are no edges."""
    model = load(Objects().add("t", [(x, y, 2) for y in (-9, 9) for x in (-9, 0, 9)], [(0, 1, 4, 3), (1, 2, 5, 4)]))
    index = draw(model, forward())
    assert not edges.visible_edges(model, forward(), index.facet, index.depth).any()
    assert not edges.boundary(index.facet).any()
