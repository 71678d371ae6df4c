"""The synthetic scenes with mirrors, gloss and textures: the photographs show what the recipes say."""

from dataclasses import replace

import numpy as np
import pytest

from lib.given import image, model
from lib.synthetic import recipes
from tests.helpers.made_scenes import DATA, made, truth

kinds = pytest.mark.parametrize("name", recipes.KIND_NAMES)


@kinds
def test_truth_of_kinds(name):
    """kind, rho_s, alpha, tangent, texture are as data/SCENE.md wants them.

    No energy is made, and the tangent lies in its facets.
    """
    recipe, materials = made(name), truth(name, "materials.json")["groups"]
    assert bool(recipe.mirrors()) == ("mirror" in name)  # test_mirror_shows_the_room goes by the name
    assert recipe.surfaces and len(materials) >= 6 and (not name.startswith("office") or len(materials) >= 12)
    assert {
        "office-mirror": "mirror",
        "office-coloured-mirror": "coloured_mirror",
        "two-mirrors": "mirror",
        "poster": "textured",
    }.get(name, "glossy") in {v["kind"] for v in materials.values()}
    for group, value in materials.items():
        surface, rho_d, rho_s = recipe.surface(group), np.array(value["rho_d"]), np.array(value["rho_s"])
        assert (value["kind"], value["rho_s"]) == (surface.kind, list(surface.rho_s))
        assert (rho_d >= 0).all() and (rho_s >= 0).all() and (rho_d + rho_s <= 1).all()
        assert (value["alpha"] is not None) == (value["kind"] == "glossy") and (value["texture"] is not None) == (
            value["kind"] == "textured"
        )
        if value["kind"] in ("mirror", "coloured_mirror"):
            assert not rho_d.any() and (value["kind"] == "coloured_mirror" or value["rho_s"] == [1, 1, 1])
        if value["kind"] == "glossy":
            ax, ay = value["alpha"]
            assert 1 > ax >= ay > 0 and (value["tangent"] is not None) == (ax > ay)
            if value["tangent"]:
                assert np.linalg.norm(value["tangent"]) == pytest.approx(1, abs=1e-12)
                p = next(p.points for p in recipe.polygons if p.group == group)
                assert np.dot(value["tangent"], np.cross(p[1] - p[0], p[2] - p[0])) == pytest.approx(0, abs=1e-12)


@kinds
def test_textures_lie_where_truth_says(name):
    """The image's corners are the facet's; its mean is rho_d.

    Rows run down and columns to the right for one who looks at its front.
    """
    recipe, materials = made(name), truth(name, "materials.json")["groups"]
    textured = {g for g, s in recipe.surfaces.items() if s.texture}
    assert (DATA / name / "truth" / "textures.json").exists() == bool(textured)
    if not textured:
        return
    m, entries = model.load(DATA / name / "model.obj"), truth(name, "textures.json")
    assert set(entries) == textured
    for group, entry in entries.items():
        ((facet, file),) = materials[group]["texture"].items()
        assert m.groups[m.facet_group[int(facet)]] == group and file == entry["file"]
        picture = image.read_exr(DATA / name / "truth" / file)
        assert (
            picture.min() >= 0.03
            and picture.max() <= 0.9
            and picture.mean((0, 1)) == pytest.approx(materials[group]["rho_d"], abs=1e-6)
        )
        assert picture.std((0, 1)).min() > 0.05
        o, u, v = (np.array(entry[k]) for k in ("origin", "u", "v"))
        (polygon,) = (p.points for p in recipe.polygons if p.group == group)
        ours = np.array([o, o + u, o + u + v, o + v])
        assert np.allclose(sorted(ours.tolist()), sorted(polygon.tolist()), atol=1e-6)
        assert u @ v == pytest.approx(0, abs=1e-9)
        assert np.cross(u, v) @ m.facet_normal[int(facet)] < 0 and picture.shape[1] / picture.shape[0] == pytest.approx(
            np.linalg.norm(u) / np.linalg.norm(v), rel=0.01
        )


def linear_left(name):
    """(H, W, 3) linear values of the photograph, (H, W) saturated or beside a group's border, (H, W) labels."""
    recipe = made(name)
    values = image.read_photograph(DATA / name / "left.png").values
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    mixed = np.zeros(labels.shape, bool)
    for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
        mixed |= np.roll(labels, shift, axis) != labels
    return values**recipe.gamma, mixed | (values.max(-1) >= 1), labels


def places(recipe, polygon, pixels):
    """(N, 3) m on the polygon's plane behind pixels (N, 2), and the camera's centre."""
    R, t = recipe.T_cam_world[:3, :3], recipe.T_cam_world[:3, 3]
    eye = -R.T @ t
    d = np.c_[pixels, np.ones(len(pixels))] @ np.linalg.inv(recipe.K).T @ R
    n = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[0])
    return eye + ((polygon[0] - eye) @ n / (d @ n))[:, None] * d, eye


@pytest.mark.parametrize("name", [n for n in recipes.KIND_NAMES if "mirror" in n])
def test_mirror_shows_the_room(name):
    """Borders of what truth says that mirrors show lie on the photograph's edges.

    Sizeable groups are seen in the mirror alone, and rho_s is the mirror's colour.
    """
    recipe = made(name)
    B, bad, labels = linear_left(name)
    shown = image.read_labels(DATA / name / "truth" / "mirror.png")
    mirrors = np.isin(labels, [recipe.groups.index(p.group) + 1 for p in recipe.mirrors()])
    assert 0.05 < mirrors.mean() < 0.25
    assert not shown[~mirrors].any() and (shown[mirrors] > 0).mean() > 0.99
    index = {g: k + 1 for k, g in enumerate(recipe.groups)}
    alone = {
        g: (shown[mirrors] == k).sum() for g, k in index.items() if g not in recipe.lamps and not (labels == k).any()
    }
    assert sum(n >= 1000 for n in alone.values()) >= 1
    # edges: the gradient on borders inside the mirror is less wherever they are shifted
    lightness = image.read_photograph(DATA / name / "left.png").values.mean(-1)
    gradient = np.hypot(*np.gradient(lightness))
    inside = mirrors & ~bad
    y, x = np.nonzero(inside[:, 1:] & inside[:, :-1] & (shown[:, 1:] != shown[:, :-1]))
    assert len(x) > 100
    strength = lambda dx, dy: gradient[y + dy, x + dx].mean()
    assert all(strength(*d) < 0.8 * strength(0, 0) for d in ((3, 0), (-3, 0)))
    # colour: walls in the mirror against walls seen directly
    if name == "office-coloured-mirror":
        wall = index["wall"]
        ratio = B[mirrors & ~bad & (shown == wall)].mean(0) / B[~bad & (labels == wall)].mean(0)
        rho_s = np.array(recipe.surfaces["mirror"].rho_s)
        assert ratio / ratio[0] == pytest.approx(rho_s / rho_s[0], rel=0.08)


def lobe(recipe, surface, x, eye, n, lamp, m=24):
    """Two (N, 3) pi x radiance that the lamp's light leaves at x (N, 3): by Ward's bounded lobe, and by white diffuse.

    Both are sums over m x m points of the lamp.
    """
    a, b = lamp.points[1] - lamp.points[0], lamp.points[3] - lamp.points[0]
    s, t = np.meshgrid((np.arange(m) + 0.5) / m, (np.arange(m) + 0.5) / m)
    y = lamp.points[0] + s.reshape(-1, 1) * a + t.reshape(-1, 1) * b
    l = y[None] - x[:, None]
    d = np.linalg.norm(l, axis=-1, keepdims=True)
    l /= d
    v = eye - x
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    h = l + v[:, None]
    tangent = np.array(surface.tangent or np.cross(n, (0, 0.6, 0.8)))
    tangent = tangent - n * (tangent @ n)
    tangent /= np.linalg.norm(tangent)
    hn, hx, hy = h @ n, h @ tangent, h @ np.cross(n, tangent)
    ax, ay = surface.alpha
    f = (h**2).sum(-1) / hn**4 * np.exp(-((hx / ax) ** 2 + (hy / ay) ** 2) / hn**2) / (np.pi * ax * ay)
    normal = np.cross(a, b)
    g = (l @ n) * np.maximum(-l @ (normal / np.linalg.norm(normal)), 0) / d[..., 0] ** 2 * np.linalg.norm(normal) / m**2
    E = np.array(recipe.lamps[lamp.group])
    return (f * g).sum(1)[:, None] * E * surface.rho_s, (g / np.pi).sum(1)[:, None] * E


@pytest.mark.outside
@pytest.mark.parametrize("name, group", [("desk-glossy", "desktop"), ("desk-glossy", "tin"), ("desk-brushed", "plate")])
def test_highlight_is_where_and_what_ward_says(name, group):
    """From pixel to pixel the photograph changes as the lamp's lobe does, integrated here: the factor is 1.

    It is a weighted median: some places lie in a shadow of the lamp, or show something else as well. A lobe that is
    turned, sharper or blunter fits worse.
    """

    recipe = made(name)
    B, bad, labels = linear_left(name)
    surface = recipe.surfaces[group]
    polygon = max((p.points for p in recipe.polygons if p.group == group), key=lambda p: p[:, 2].min())
    (lamp,) = (p for p in recipe.polygons if p.group in recipe.lamps)
    y, x = np.nonzero(~bad & (labels == recipe.groups.index(group) + 1))
    p, eye = places(recipe, polygon, np.c_[x, y])
    edges = np.roll(polygon, -1, 0) - polygon
    # of a closed box: its top alone
    top = np.all([np.cross(e, p - c)[:, 2] > 0 for c, e in zip(polygon, edges, strict=True)], axis=0)
    x, y, p = x[top], y[top], p[top]

    def fit(surface):
        """The factor per channel, and how far the ratios lie from 1: both medians weighted with the lobe's change."""
        shine = np.full(B.shape, np.nan)
        shine[y, x] = lobe(recipe, surface, p, eye, np.array([0, 0, 1.0]), lamp, 10)[0]
        d = [
            np.concatenate([(a[:, 8:] - a[:, :-8]).reshape(-1, 3), (a[8:] - a[:-8]).reshape(-1, 3)])
            for a in (shine, np.where(np.isnan(shine), np.nan, B))
        ]
        lobes, photograph = (a[~np.isnan(d[0][:, 0])] for a in d)

        def median(values, weights):
            order = np.argsort(values)
            sums = np.cumsum(weights[order])
            return values[order][np.searchsorted(sums, sums[-1] / 2)]

        ratio, weights = photograph / lobes, np.abs(lobes)
        return np.array([median(r, w) for r, w in zip(ratio.T, weights.T, strict=True)]), median(
            np.abs(ratio - 1).ravel(), weights.ravel()
        )

    factor, misfit = fit(surface)
    assert factor == pytest.approx(1, abs=0.06) and misfit < 0.3, (factor, misfit)
    ax, ay = surface.alpha
    wrong = [replace(surface, alpha=(ax / 1.4, ay / 1.4)), replace(surface, alpha=(ax * 1.4, ay * 1.4))]
    if surface.tangent:
        tx, ty, tz = surface.tangent
        wrong += [
            replace(surface, tangent=(-ty, tx, tz)),
            replace(surface, tangent=(tx, -ty, tz)),
            replace(surface, alpha=(np.sqrt(ax * ay),) * 2),
        ]
    for w in wrong:
        assert fit(w)[1] > 1.15 * misfit


@pytest.mark.parametrize("group", ["poster", "rug"])
def test_poster_is_the_texture(group):
    """The photograph over the true albedo is smooth light.

    With the texture mirrored, or shifted by two pixels, it is not.
    """
    recipe = made("poster")
    B, bad, labels = linear_left("poster")
    texture = recipe.surfaces[group].texture
    (polygon,) = (p.points for p in recipe.polygons if p.group == group)
    y, x = np.nonzero(~bad & (labels == recipe.groups.index(group) + 1))
    h, w, _ = texture.image.shape
    frame = np.linalg.pinv(np.column_stack([texture.u, texture.v]))

    def misfit(dx=0, dy=0, picture=texture.image):
        rho = np.zeros((len(x), 3))
        for ox in (-0.375, -0.125, 0.125, 0.375):  # the pixel's square
            for oy in (-0.375, -0.125, 0.125, 0.375):
                p, _ = places(recipe, polygon, np.c_[x + dx + ox, y + dy + oy])
                s, t = frame @ (p - texture.origin).T
                rho += picture[np.clip((t * h).astype(int), 0, h - 1), np.clip((s * w).astype(int), 0, w - 1)] / 16
        light = B[y, x] / rho
        q = np.c_[np.ones(len(x)), x / 320 - 1, y / 240 - 1]
        A = np.c_[q, q[:, 1:] ** 2, q[:, 1:2] * q[:, 2:], q[:, 1:] ** 3]
        k, *_ = np.linalg.lstsq(A, light, rcond=None)
        return np.median(np.abs(light / (A @ k) - 1))

    right = misfit()
    assert right < 0.04
    wrong_ways = [dict(dx=2), dict(dx=-2), dict(dy=2), dict(dy=-2), dict(picture=texture.image[::-1])]
    if group != "rug":  # whose pattern is its own mirror image
        wrong_ways.append(dict(picture=texture.image[:, ::-1]))
    for wrong in wrong_ways:
        assert misfit(**wrong) > 1.3 * right
