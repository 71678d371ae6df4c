"""An entry of `augment` applied to a recovered scene: another model, other materials and lamps (data/SCENE.md).

    change = apply(entry, "materials.json", found, model, lamps)
    changed = subject(change, recovered)            # what lib/picture/differential.py renders

Facets keep their numbers. Those of removed objects have no triangles any more; a moved object's are new, as are those
of what is added, and stand behind the model's. A mirror of more than a few facets, and any on an ellipsoid, is
*curved*: the eye sees what it reflects, but to its surroundings it is a diffuse surface that reflects as much. That is
exact in power; its caustics are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from lib.core.stage import BadInput
from lib.given import image
from lib.given import model as models
from lib.given.kinds import LOBES, MIRRORS, NAMELESS
from lib.given.materials import Group, Lamp, Materials
from lib.given.model import Model, changes
from lib.given.model.parts import joined
from lib.given.transfer import linear_from_srgb
from lib.light import changed_factors, outside, throws
from lib.light import surface as surfaces
from lib.picture import albedo_maps, appearance
from lib.picture.curved import Curved, Ellipsoid
from lib.picture.subject import Subject

MEANING = {"rho_s": (*LOBES, *MIRRORS), "alpha": LOBES, "tangent": LOBES}  # fields, and the kinds that have them
LARGEST = 10  # times the surface of a scene that an added object may have
PLANE = 12  # facets of a mirror from which on it counts as curved


@dataclass(frozen=True, eq=False)
class Change:
    """model, found : as they are now;  lamps : names of the groups that emit, the old ones first
    twins : {facet: the one that it was before it was moved};  images : {group: (H, W, 3) reflectances}
    curved : {group: rho_s (3,)} of curved mirrors, which `found` has as diffuse;  ellipsoids : of lib/picture/curved.py
    """

    model: Model
    found: Materials
    lamps: tuple
    twins: dict = field(default_factory=dict)
    images: dict = field(default_factory=dict)
    curved: dict = field(default_factory=dict)
    ellipsoids: list = field(default_factory=list)


def apply(entry, path, found: Materials, model: Model, lamps, channels=3) -> Change:
    """The scene that an entry of `augment` asks for, whose files are paths.

    channels : of the photograph; a grey one sees the mean of a colour
    found : what materials.json at `path` holds;  lamps : names of the groups that emit
    BadInput: names that the scene has not, materials that cannot be, files that cannot be used.
    """
    _known(entry, path, found, model, lamps)
    entry = _grey(entry) if channels == 1 else entry
    made = Change(model, found, tuple(lamps))
    removed = entry.get("remove", [])
    if removed:
        made = replace(made, model=changes.emptied(made.model, removed))
    for name, offset in entry.get("move", {}).items():
        made = _moved(made, name, offset)
    for group, material in entry.get("change", {}).items():
        made = _with_group(made, group, _merged(f"change.{group}", found.groups[group], material), material)
    for name, emittance in entry.get("lamps", {}).items():
        own = {name: replace(found.lamps[name], emittance=tuple(map(float, emittance)))}
        made = replace(made, found=replace(made.found, lamps=made.found.lamps | own))
    things = entry.get("add", [])
    for number, thing in enumerate(things if isinstance(things, list) else [things]):
        made = _added(made, number, thing)
    if not len(made.model.triangles):
        raise BadInput("entry: remove: nothing is left of the model")
    return _with_curved(made)


def _grey(value, key=None):
    """An entry with the means of its colours."""
    if isinstance(value, dict):
        return {k: _grey(v, k if key != "lamps" else "emittance") for k, v in value.items()}
    if key in ("rho_d", "rho_s", "emittance"):
        return 3 * [sum(value) / 3]
    return [_grey(v) for v in value] if isinstance(value, list) else value


def _known(entry, path, found, model, lamps):
    """BadInput: names that the model or materials.json have not."""
    problems = []
    for key, known in (("remove", model.objects), ("move", model.objects), ("change", model.groups), ("lamps", lamps)):
        for name in entry.get(key, ()):
            if name not in known:
                problems.append(f"entry: {key}: {name!r} is none of {', '.join(known)}")
            elif key == "change" and name in lamps:
                problems.append(f"entry: change: {name!r} is a lamp")
            elif key == "change" and name not in found.groups:
                problems.append(f"{path}: groups: {name!r} is missing")
    if problems:
        raise BadInput(*problems)


def _moved(made: Change, name, offset):
    number = made.model.objects.index(name)
    before = np.flatnonzero(made.model.facet_object == number)
    model = changes.moved(made.model, name, offset)
    twins = dict(zip(range(made.model.n_facets, model.n_facets), map(int, before), strict=True))
    return replace(made, model=model, twins=made.twins | twins)


def _merged(where, before: Group, material) -> Group:
    """A group with the fields that a material names; of another kind nothing else stays."""
    kind = material.get("kind", before.kind)
    group = before if kind == before.kind else Group(kind=kind)
    own = {f.name for f in fields(Group)}
    values = {key: value for key, value in material.items() if key in own and key != "texture"}
    group = replace(group, **{key: tuple(map(float, v)) if isinstance(v, list) else v for key, v in values.items()})
    if group.is_mirror and group.rho_s is None and kind == "mirror":
        group = replace(group, rho_s=(1.0, 1.0, 1.0))
    if group.is_specular and group.rho_d is None:
        group = replace(group, rho_d=(0.0, 0.0, 0.0))
    if "texture" in material:
        group = replace(group, texture=None)
    for key, kinds in MEANING.items():
        if key in material and group.kind not in kinds:
            raise BadInput(f"entry: {where}.{key}: has no meaning for {group.kind}, which the group is")
    if group.rho_d is not None and group.rho_s is not None:
        total = np.add(group.rho_d, group.rho_s)
        if total.max() > 1 + 1e-9:
            raise BadInput(f"entry: {where}: rho_d + rho_s = {total.round(4).tolist()} exceeds 1")
    return group


def _with_group(made: Change, name, group: Group, material):
    images = dict(made.images)
    if "texture" in material:
        images[name] = _picture(material["texture"])
        group = replace(group, rho_d=tuple(images[name].mean(axis=(0, 1)).tolist()))
    return replace(made, found=replace(made.found, groups=made.found.groups | {name: group}), images=images)


def _picture(path):
    """(H, W, 3) reflectances: an EXR as it is, any other picture decoded from sRGB."""
    read = image.read_photograph(path)
    values = read.values if read.linear else linear_from_srgb(read.values)
    if values.max() > 1:
        raise BadInput(f"{path}: a value of {values.max():.3g} is no reflectance: it exceeds 1")
    return np.broadcast_to(values, (*values.shape[:2], 3))


def _added(made: Change, number, thing):
    """With one object more, whose groups bear names that no model has."""
    one = f"added {number}"
    turn, at, scale = changes.turned(thing.get("rotate", [0, 0, 0])), thing.get("at", [0, 0, 0]), thing.get("scale", 1)
    ellipsoids = list(made.ellipsoids)
    material = thing["material"]
    whole = any(not isinstance(value, dict) for value in material.values())
    if "file" in thing:
        bare = models.load(thing["file"], bare=NAMELESS if whole else None)
    else:
        axes = np.array(thing.get("ellipsoid") or 3 * [thing["sphere"]], float)
        bare = changes.luminous(axes, one) if "emittance" in thing["material"] else changes.ellipsoid(axes, one)
        facets = made.model.n_facets + np.arange(bare.n_facets)
        if "emittance" not in thing["material"]:
            ellipsoids.append(Ellipsoid(facets, np.asarray(at, float), np.diag(1 / (scale * axes)) @ turn.T))
    of = {group: material if whole else material.get(group) for group in bare.groups}
    if missing := [group for group, value in of.items() if value is None]:
        raise BadInput(f"entry: add: material: group {missing[0]!r} of {thing['file']} is missing")
    names = [f"{one} {group}" for group in bare.groups]
    put = changes.placed(changes.renamed(bare, names), turn, at, scale)
    area, room = put.facet_area().sum(), made.model.facet_area().sum()
    if area > LARGEST * room:  # its patches and texels are as fine as the scene's
        raise BadInput(f"entry: add: an object of {area:.3g} m2 is too large for a scene of {room:.3g} m2")
    made = replace(made, model=joined(made.model, one, put), ellipsoids=ellipsoids)
    for name, value in zip(names, of.values(), strict=True):
        if "emittance" in value:
            rho = tuple(map(float, value["rho_d"])) if "rho_d" in value else None
            lamp = {name: Lamp(emittance=tuple(map(float, value["emittance"])), rho_d=rho)}
            lamps = made.found.lamps | lamp
            made = replace(made, lamps=(*made.lamps, name), found=replace(made.found, lamps=lamps))
        else:
            group = _merged("add.material", Group(), value)
            made = _with_group(made, name, group, value)
    return made


def _with_curved(made: Change) -> Change:
    """Mirrors of many facets become diffuse surfaces that reflect as much; see the head of this file."""
    count = np.bincount(made.model.facet_group[np.unique(made.model.triangle_facet)], minlength=len(made.model.groups))
    groups, curved = dict(made.found.groups), {}
    for name, number in zip(made.model.groups, count, strict=True):
        group = groups.get(name)
        if name not in made.lamps and group is not None and group.kind in MIRRORS and number > PLANE:
            curved[name] = group.rho_s
            groups[name] = Group(kind="diffuse", rho_d=group.rho_s)
    return replace(made, found=replace(made.found, groups=groups), curved=curved)


# ---- what is to be rendered ----


def subject(change: Change, recovered: Subject, stored, view, coverage, path, *, n_rays=512) -> Subject:
    """The changed scene, seen by a view of its model.

    recovered : the scene as it was found;  stored : FormFactors of its file;  view, coverage : of the changed model
    path : of materials.json, beside which its textures lie;  n_rays : of each new patch
    """
    before = recovered.surface
    if change.model is recovered.view.model and change.lamps == stored.lamps:
        surface, factors = before, stored
    else:
        surface = surfaces.surface(change.model, change.lamps, before)
        factors = changed_factors.changed(stored, before, surface, change.lamps, n_rays=n_rays)
    factors = outside.with_outside(factors, lambda: surface)
    channels, model = recovered.channels, change.model
    look, warnings = appearance.of(change.found, path, factors.groups, factors.lamps, channels, model.n_facets)
    factors = throws.in_lobes(factors, surface, change.found.lobes)
    maps = dict(look.maps)
    for facet, was in change.twins.items():
        if was in maps:
            maps[facet] = replace(maps[was], facet=facet)
    for group, picture in change.images.items():
        own = picture if channels == 3 else picture.mean(axis=2, keepdims=True)
        for f in np.flatnonzero(model.facet_group == model.groups.index(group)):
            if f in surface.facet:
                maps[int(f)] = albedo_maps.painted(surface, int(f), own)
    traced = recovered.traced
    same = surface is before and traced is not None and look.finish is not None
    if not (same and traced.fits(look.finish, len(factors.mesh), factors.lobe_of_lamps)):
        traced = None
    return replace(
        recovered,
        view=view,
        surface=surface,
        factors=factors,
        coverage=coverage,
        appearance=replace(look, maps=maps),
        traced=traced,
        warnings=warnings,
        curved=Curved.of(surface, change.curved, change.ellipsoids, channels),
    )
