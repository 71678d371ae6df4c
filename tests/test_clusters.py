"""Face clusters: patches of many small facets, whose light is that of a patch for each facet."""

import numpy as np
import pytest

from lib.given.rays import shifts, sobol
from lib.light import adapt, clusters
from lib.light.cells_kernels import patch_points, sides_of_points
from lib.light.lamps import emitters
from tests.helpers import rooms


def ball(n, centre, radius):
    """A sphere of n x 2 n quadrilaterals and triangles."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    p = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    p[:, -1] = p[:, 0]
    p = np.array(centre) + radius * p
    return {
        "ball": [("ball", [p[i, j], p[i + 1, j], p[i + 1, j + 1], p[i, j + 1]]) for i in range(n) for j in range(2 * n)]
    }


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A ball of 512 facets in a room with a lamp."""
    path = tmp_path_factory.mktemp("ball") / "m.obj"
    return rooms.surface(path, rooms.room() | rooms.LAMP | ball(16, (2, 1.5, 0.7), 0.5))


def mesh(scene, many, monkeypatch, **size):
    monkeypatch.setattr(clusters, "MANY", many)
    size = {"patches": 150, "max_level": 2, "contrast": 0.02} | size
    return adapt.build(scene, **size, emitters=emitters(scene, ["lamp"]))


def test_a_cluster_has_the_area_and_the_places_of_its_facets(scene, monkeypatch):
    """Of one object and group, facing one way; its points are spread by area, each on its own facet."""
    each, few = mesh(scene, 10**6, monkeypatch, max_level=0), mesh(scene, 0, monkeypatch, max_level=0)
    assert not each.is_cluster.any() and few.is_cluster.sum() > 20 and len(few) < len(each) / 3
    assert np.isclose(few.area.sum(), each.area.sum()) and (few.tri_cdf[few.tri_start[1:] - 1] == 1).all()
    owner = np.repeat(np.arange(len(few)), np.diff(few.tri_start))
    for of in (scene.group, scene.object):
        assert (of[few.tri_side // 2] == of[few.side[owner] // 2]).all()
    normal = scene.normal * (1 - 2 * 0)
    assert (np.einsum("ij,ij->i", normal[few.tri_side // 2], normal[few.side[owner] // 2]) > 0.3).all()
    there = each.leaf >= 0
    assert len(each.leaf) == len(few.leaf) and (few.leaf[there] >= 0).all()
    shift = shifts(len(few), 1024, 0)
    p = patch_points(1024, sobol(1024), shift, few.pieces, scene.arrays)
    side = sides_of_points(1024, sobol(1024), shift, few.pieces)
    height = np.einsum("ij,ij->i", p - scene.origin[side // 2], scene.normal[side // 2])
    assert np.abs(height).max() < 1e-9
    assert np.allclose(p.reshape(len(few), 1024, 3).mean(axis=1), few.centre, atol=2e-3)


def test_their_light_is_that_of_a_patch_for_each_facet(scene, monkeypatch):
    """Of each group, reflected light among it: .02 % with many rays; and clusters fall apart where light is uneven."""
    means, seen = [], [g for g, name in enumerate(scene.groups) if name != "lamp"]
    for many in (10**6, 0):
        m = mesh(scene, many, monkeypatch)
        light, exposed = rooms.light_of(scene, m, emitters(scene, ["lamp"]), 1024)
        group = scene.group[m.side // 2]
        area = m.area * exposed
        means.append([np.average(light[group == g], weights=area[group == g]) for g in seen])
    assert len(m) > len(mesh(scene, 0, monkeypatch, max_level=0))
    assert np.allclose(*means, rtol=3e-3)


def test_few_facets_have_no_clusters(scene, monkeypatch):
    """The same mesh to the last number, so that rooms of boxes stay as they are."""
    m = mesh(scene, clusters.MANY, monkeypatch, max_level=1)
    tree = adapt.Tree(scene, adapt.live_sides(scene), 1.0)
    assert not m.is_cluster.any() and np.array_equal(tree.element, np.arange(len(tree.leaves)))
