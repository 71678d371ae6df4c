"""What a composed USD stage shows, as meshes: runs in the process of usd_process.py alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.core.stage import BadInput
from lib.given import round_shapes, usd_materials
from lib.given.formats import LeftOut
from lib.given.names import Names

MOST_SHOWN = 50_000  # prims that are visited, those of instances each time, of a small file;
SHOWN_BYTES = 16  # and of a large one, so many bytes for each
MOST_CORNERS = 2_000_000  # of all faces, of a small file;
CORNER_BYTES = 4  # and of a large one, so many bytes for each
MOST_DEEP = 20  # point instancers in each other
SHOWN = ("default", "render")
# How an axis that is not z is reached: columns of a rotation, of (x, y, z) as they are modelled
AXES = {"Z": (0, 1, 2), "X": (2, 0, 1), "Y": (1, 2, 0)}
NO_FACES = {"BasisCurves": "curve", "NurbsCurves": "curve", "HermiteCurves": "curve", "Points": "point cloud"}
NO_FACES |= {"Volume": "volume", "ParticleField3DGaussianSplat": "point cloud"}


class Frame(NamedTuple):
    """Where an instance of a prototype stands. T : (4, 4), rows: p' = (p, 1) T, from the prototype's own root"""

    root: object
    T: np.ndarray
    deep: int


def load():
    """Everything that is imported, before memory is bounded."""
    from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdShade, UsdSkel, UsdUtils, Vt  # noqa: F401

    Usd.Stage.CreateInMemory().DefinePrim("/a", "Mesh")


def read(name, found, allow=lambda size, prims: None) -> tuple[list, dict, list]:
    """(parts, {group: emits}, lines to say).  found : of usd_layers.look;  parts : as usd_process.write takes them

    allow : takes the bytes of all layers and the prims that instances make, raises what is allowed
    """
    from pxr import Usd, UsdUtils

    silent = UsdUtils.CoalescingDiagnosticDelegate()
    stage = Usd.Stage.Open(found.path)
    errors = [" ".join(str(error).replace(found.path, name).split()) for error in stage.GetCompositionErrors()]
    if errors:
        more = f" and {len(errors) - 1} more" if len(errors) > 1 else ""
        raise BadInput(f"{name}: does not compose: {errors[0][:300]}{more}: put what it names beside it, or mend it")
    metres, said = _unit(name, stage)
    said += _other_units(stage)
    reader = _Reader(name, stage, metres, found, allow)
    reader.pose()
    reader.walk(stage.GetPseudoRoot(), None)
    del silent
    line = reader.left.line()
    if not reader.parts:
        raise BadInput(f"{name}: has no mesh{f' ({line})' if line else ''}")
    return reader.parts, reader.emits, said + reader.lines() + ([line] if line else [])


def _unit(name, stage):
    """(metres to its unit, lines to say)"""
    from pxr import UsdGeom

    metres = UsdGeom.GetStageMetersPerUnit(stage)
    if not 0 < metres < np.inf:
        raise BadInput(f"{name}: metersPerUnit = {metres:g} is no length: write 1 for metres, 0.01 for centimetres")
    told = "" if UsdGeom.StageHasAuthoredMetersPerUnit(stage) else " (it tells none, and USD means centimetres)"
    up = str(UsdGeom.GetStageUpAxis(stage)).lower()
    return metres, [
        f"USD, {metres:g} m to its unit{told}: written in metres",
        *([f"its up axis is {up}"] if up != "z" else []),
    ]


def _other_units(stage):
    """USD composes files of other units and axes as they stand."""
    lines, root = [], stage.GetRootLayer()
    for key in ("metersPerUnit", "upAxis"):
        own = stage.GetMetadata(key)
        for layer in stage.GetUsedLayers():
            told = layer.pseudoRoot.GetInfo(key) if layer != root and layer.pseudoRoot.HasInfo(key) else own
            if told != own:
                lines.append(f"{layer.GetDisplayName()} has {key} {told}, not {own}: USD does not convert it")
    return sorted(lines)[:5]


class _Reader:
    """What has been read so far."""

    def __init__(self, name, stage, metres, found, allow):
        from pxr import Usd, UsdGeom

        self.name, self.stage, self.metres, self.found, self.allow = name, stage, metres, found, allow
        self.most = max(MOST_CORNERS, found.size // CORNER_BYTES)
        self.most_shown = max(MOST_SHOWN, found.specs, found.prims, found.size // SHOWN_BYTES)
        self.time = Usd.TimeCode.EarliestTime()
        self.places = UsdGeom.XformCache(self.time)
        self.all = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
        self.parts, self.emits, self.lights, self.cages, self.refused = [], {}, [], {}, []
        self.left, self.groups, self.objects = LeftOut(), Names(), Names()
        self.animated, self.first, self.visited, self.corners, self.round = set(), np.inf, 0, 0, False
        self.looked, self.clear = set(), []
        self.shapes, self.counts, self.tangled, self.allowed = {}, {}, 0, 0

    def refuse(self, prim, problem):
        raise BadInput(f"{self.name}: {prim.GetPath() if hasattr(prim, 'GetPath') else prim}: {problem}")

    def lines(self):
        said = []
        if self.refused:
            named = ", ".join(self.refused[:5])
            raise BadInput(f"{self.name}: shapes that are not read: {named}; make meshes of them")
        if self.animated:
            count = len(self.animated)
            verb = "prims are" if count > 1 else "prim is"
            said.append(f"{count} {verb} animated: read at the earliest time code, {self.first:g}")
        for scheme, count in self.cages.items():
            said.append(f"{count} subdivision surface{'s' if count > 1 else ''} ({scheme}): the control cage is read")
        if self.tangled:
            said.append(f"{self.tangled} faces are in several subsets: the last one holds")
        said += [round_shapes.WORDS] if self.round else []
        said += self.groups.lines()
        if self.clear:
            named = ", ".join(f"{name:.80}" for name in self.clear[:5])
            said.append(f"materials that let light through are taken for opaque ones: {named}")
        if self.lights:
            more = f" and {len(self.lights) - 5} more" if len(self.lights) > 5 else ""
            said.append(f"lights without faces are left out, draw them: {', '.join(self.lights[:5])}{more}")
        return said

    # ---- the walk ----

    def pose(self):
        """Skinned meshes get their points, at the earliest time code, in the session layer."""
        from pxr import Gf, Usd, UsdSkel

        self.stage.SetEditTarget(Usd.EditTarget(self.stage.GetSessionLayer()))
        while shared := self.shared_skins():  # nothing can be written into an instance
            for prim in shared:
                prim.SetInstanceable(False)
        roots = [prim.GetPath() for prim in self.stage.Traverse() if prim.IsA(UsdSkel.Root)]
        start = self.stage.GetStartTimeCode() if self.stage.HasAuthoredTimeCodeRange() else 0.0
        for path in roots:  # what refers to one within the file is posed with it, and is no root any more
            prim = UsdSkel.Root.Get(self.stage, path)
            if prim and not UsdSkel.BakeSkinning(prim, Gf.Interval(start, start)):
                self.left.add("unposed skin")
        self.places.Clear()

    def shared_skins(self):
        """Instances that hold a skinned mesh or are held by one, the outermost of each, without repetition."""
        from pxr import Usd, UsdSkel

        found = {}
        for root in self.stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
            if root.IsA(UsdSkel.Root):
                prim = root
                while prim.IsInstanceProxy():
                    prim = prim.GetParent()
                below = (one for one in Usd.PrimRange(prim) if one.IsInstance())
                found |= {one.GetPath(): one for one in ([prim] if prim.IsInstance() else below)}
        return list(found.values())

    def walk(self, root, frame):
        """All that is shown at and below a prim. frame : Frame of an instance, None: it stands in the stage"""
        from pxr import UsdGeom, UsdLux

        todo = [root]
        while todo:
            prim = todo.pop()
            self.visited += 1
            if self.visited > 2 * self.most_shown:
                self.refuse(prim, f"more than {self.visited - 1:,} prims are drawn: make fewer instances")
            if frame is None and not self.is_there(prim):
                continue
            imageable = UsdGeom.Imageable(prim)
            if imageable:
                if self.get(imageable.GetVisibilityAttr(), prim) == "invisible":
                    self.left.add("invisible prim")
                    continue
                self.watch_place(prim)
            if prim.IsA(UsdGeom.PointInstancer):
                if self.is_shown(prim, "point instancer"):
                    self.instances(UsdGeom.PointInstancer(prim), frame)
                continue
            if prim.IsA(UsdGeom.Gprim):
                self.shape(prim, frame)
            elif prim.HasAPI(UsdLux.LightAPI):
                self.lights.append(prim.GetName())
            elif prim.IsA(UsdGeom.Camera):
                self.left.add("camera")
            elif prim.GetTypeName() and not imageable and not prim.GetPrimTypeInfo().GetSchemaType():
                self.left.add(f"{prim.GetTypeName():.40} (unknown type) prim")
            todo += reversed(prim.GetFilteredChildren(self.all))

    def is_there(self, prim):
        if prim.IsPseudoRoot():
            return True
        if not prim.IsActive():
            self.left.add("inactive prim")
        elif not prim.IsDefined() and not prim.IsAbstract():
            self.left.add("undefined over")
        return prim.IsActive() and prim.IsDefined() and not prim.IsAbstract()

    def is_shown(self, prim, what):
        from pxr import UsdGeom

        purpose = str(UsdGeom.Imageable(prim).ComputePurpose())
        if purpose not in SHOWN:
            self.left.add(f"{purpose} {what}")
            return False
        seen = purpose != "render" or not prim.HasAPI(UsdGeom.VisibilityAPI)
        if not seen and UsdGeom.Imageable(prim).ComputeEffectiveVisibility("render", self.time) == "invisible":
            self.left.add("invisible prim")
            return False
        return True

    def get(self, attribute, prim):
        """Its value at the earliest time code."""
        if attribute.ValueMightBeTimeVarying():
            self.watch(attribute, prim)
        return attribute.Get(self.time)

    def array(self, attribute, prim, kind):
        """The same as an array; an empty one where it is not told."""
        value = self.get(attribute, prim) if attribute else None
        try:
            return np.array(value if value is not None else [], kind)
        except (TypeError, ValueError):
            self.refuse(prim, f"{attribute.GetName()}: {value!r:.80} are no numbers")

    def watch(self, attribute, prim):
        low = attribute.GetBracketingTimeSamples(-1e300)
        if low:
            self.first = min(self.first, low[0])
            self.animated.add(str(prim.GetPath()))

    def watch_place(self, prim):
        from pxr import UsdGeom

        place = UsdGeom.Xformable(prim)
        if place and place.TransformMightBeTimeVarying():
            for op in place.GetOrderedXformOps():
                self.watch(op.GetAttr(), prim)

    def place(self, prim, frame):
        """(4, 4), rows: of a prim's own points to the stage, in its units."""
        if frame is None:
            return np.array(self.places.GetLocalToWorldTransform(prim))
        relative = self.places.ComputeRelativeTransform(prim, frame.root)
        return np.array(relative[0] if isinstance(relative, tuple) else relative) @ frame.T

    def instances(self, instancer, frame):
        """Each prototype where the instances stand; the prototypes themselves are not drawn."""
        from pxr import Usd, UsdGeom

        prim, deep = instancer.GetPrim(), frame.deep + 1 if frame else 1
        which = self.array(instancer.GetProtoIndicesAttr(), prim, int)
        positions = self.array(instancer.GetPositionsAttr(), prim, float)
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        if not len(which):
            self.left.add("empty point instancer")
            return
        if len(positions) != len(which):
            self.refuse(prim, f"positions: {len(positions)} of {len(which)} instances (protoIndices)")
        if which.min() < 0 or which.max() >= len(targets):
            wrong = which[(which < 0) | (which >= len(targets))][0]
            self.refuse(prim, f"protoIndices: {wrong} is out of range: it has {len(targets)} prototypes")
        if deep > MOST_DEEP:
            self.refuse(prim, f"point instancers are nested deeper than {MOST_DEEP}")
        if frame is None:
            if (count := self.count(prim, 0)) > self.most_shown:
                most = f"at most {self.most_shown:,} are read"
                self.refuse(prim, f"instances make {count:,} prims, and {most}: make fewer of them")
            self.allowed += count
            self.allow(self.found.size, self.found.prims + self.allowed)
        times = [a.GetBracketingTimeSamples(-1e300)[:1] for a in prim.GetAttributes() if a.GetNumTimeSamples()]
        time = Usd.TimeCode(min(t[0] for t in times)) if times else Usd.TimeCode.Default()
        placed = instancer.ComputeInstanceTransformsAtTime(
            time, time, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
        )
        if len(placed) != len(which):
            self.refuse(prim, "orientations, scales: they are not as many as its instances (protoIndices)")
        mask = list(instancer.ComputeMaskAtTime(time)) or [True] * len(which)
        outer = self.place(prim, frame)
        for index, T, seen in zip(which, placed, mask, strict=True):
            root = self.stage.GetPrimAtPath(targets[index])
            if not root:
                self.refuse(prim, f"prototypes: {targets[index]} is not there")
            if seen:
                self.walk(root, Frame(root, np.array(T) @ outer, deep))
        self.left.add("hidden instance", mask.count(False))

    def count(self, prim, deep):
        """Prims at and below one, those of point instancers as often as they are drawn."""
        from pxr import UsdGeom

        key = str(prim.GetPath())
        if key in self.counts or deep > MOST_DEEP:
            return self.counts.get(key, 1)
        self.counts[key] = 1  # while it is counted: a circle ends here
        if not prim.IsA(UsdGeom.PointInstancer):
            total = 1 + sum(self.count(child, deep) for child in prim.GetFilteredChildren(self.all))
        else:
            instancer = UsdGeom.PointInstancer(prim)
            which = self.array(instancer.GetProtoIndicesAttr(), prim, int)
            roots = map(self.stage.GetPrimAtPath, instancer.GetPrototypesRel().GetForwardedTargets())
            each = [int((which == k).sum()) * self.count(root, deep + 1) if root else 0 for k, root in enumerate(roots)]
            total = 1 + sum(each)
        self.counts[key] = total
        return total

    # ---- shapes ----

    def shape(self, prim, frame):
        from pxr import UsdGeom

        kind = str(prim.GetTypeName())
        is_mesh = prim.IsA(UsdGeom.Mesh)
        if not is_mesh and kind in NO_FACES:
            self.left.add(NO_FACES[kind])
            return
        if not self.is_shown(prim, "shape"):
            return
        key = str(prim.GetPath())
        if key not in self.shapes:
            self.shapes[key] = self.of_mesh(UsdGeom.Mesh(prim)) if is_mesh else self.of_solid(prim, kind)
        made = self.shapes[key]
        if made is None:
            self.refused.append(f"{prim.GetName()} ({kind})")
            return
        points, counts, corners, groups, left_handed = made
        if not len(counts):
            return
        self.corners += len(corners)
        if self.corners > self.most:
            self.refuse(prim, f"all faces have more than {self.most:,} corners together: make fewer instances")
        T = self.place(prim, frame)
        with np.errstate(all="ignore"):
            points = self.metres * (points @ T[:3, :3] + T[3, :3])
        if not np.isfinite(points).all():
            self.refuse(prim, f"points: {np.argwhere(~np.isfinite(points))[0][0]} is not finite where it is placed")
        if left_handed != (np.linalg.det(T[:3, :3]) < 0):
            # backwards within each face: the whole row backwards, and the faces back in their order
            ends = np.cumsum(counts)
            within = np.arange(len(corners)) - np.repeat(ends - counts, counts)
            corners = corners[np.repeat(ends, counts) - 1 - within]
        self.add(prim, points, counts, corners, groups)

    def add(self, prim, points, counts, corners, groups):
        """One part for each of its groups."""
        thing = self.objects(self.visited, prim.GetName())  # each visit is a thing of its own
        for group in dict.fromkeys(groups.tolist()):
            mine = groups == group
            used, index = np.unique(corners[np.repeat(mine, counts)], return_inverse=True)
            self.parts.append((thing, group, points[used], counts[mine], index.reshape(-1)))

    def of_mesh(self, mesh):
        """(points (V, 3), counts (F,), corners (C,), group of each face, left-handed?), in its own units."""
        prim = mesh.GetPrim()
        points = self.array(mesh.GetPointsAttr(), prim, float).reshape(-1, 3)
        counts = self.array(mesh.GetFaceVertexCountsAttr(), prim, np.int64)
        corners = self.array(mesh.GetFaceVertexIndicesAttr(), prim, np.int64)
        bad = len(counts) and counts.min() < 0 or counts.sum() != len(corners)
        if bad or len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            faces = f"its {len(counts)} faces and {len(points)} points"
            self.refuse(prim, f"faceVertexIndices do not belong to {faces}")
        if not np.isfinite(points).all():
            self.refuse(prim, f"points: {np.argwhere(~np.isfinite(points))[0][0]} is not finite")
        scheme = str(mesh.GetSubdivisionSchemeAttr().Get() or "none")
        if scheme != "none" and len(counts):
            told = mesh.GetSubdivisionSchemeAttr().HasAuthoredValue()
            scheme = scheme if told else f"{scheme}, as it tells no other"
            self.cages[scheme] = self.cages.get(scheme, 0) + 1
        groups = self.by_subset(mesh, np.full(len(counts), self.group(prim), object))
        kept = counts >= 3
        self.left.add("degenerate face", int((~kept).sum()))
        holes = self.array(mesh.GetHoleIndicesAttr(), prim, np.int64)
        self.check_faces(prim, "holeIndices", holes, len(counts))
        self.left.add("hole", int(kept[holes].sum()))
        kept[holes] = False
        left_handed = mesh.GetOrientationAttr().Get() == "leftHanded"
        return points, counts[kept], corners[np.repeat(kept, counts)], groups[kept], left_handed

    def by_subset(self, mesh, groups):
        """The group of each face, where subsets are bound to materials of their own."""
        from pxr import UsdGeom, UsdShade

        several = np.zeros(len(groups), bool)
        for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
            prim = subset.GetPrim()
            bound = self.bound(prim, own=True)
            if not bound:
                continue
            family, element = str(subset.GetFamilyNameAttr().Get() or ""), str(subset.GetElementTypeAttr().Get())
            if family != UsdShade.Tokens.materialBind or element != "face":
                self.left.add("other family's material subset")
                continue
            faces = self.array(subset.GetIndicesAttr(), prim, np.int64)
            self.check_faces(prim, "indices", faces, len(groups))
            self.tangled += int(several[faces].sum())
            several[faces] = True
            groups[faces] = self.material(bound)
        return groups

    def check_faces(self, prim, what, faces, count):
        wrong = faces[(faces < 0) | (faces >= count)]
        if len(wrong):
            self.refuse(prim, f"{what}: face {wrong[0]} is out of range: the mesh has {count}")

    def of_solid(self, prim, kind):
        """The same of a shape that has no points of its own; None of one that is not read."""
        made = self.solid(prim, kind)
        if made is None:
            return None
        points, faces = made
        if not np.isfinite(points).all():
            self.refuse(prim, "its size is not finite")
        if kind not in ("Cube", "Sphere"):
            points = points[:, AXES.get(str(prim.GetAttribute("axis").Get()), AXES["Z"])]
        counts = np.array([len(face) for face in faces])
        corners = np.array([k for face in faces for k in face])
        left_handed = prim.GetAttribute("orientation").Get() == "leftHanded"
        return points, counts, corners, np.full(len(counts), self.group(prim), object), left_handed

    def solid(self, prim, kind):
        told = {}
        for key in ("size", "width", "length", "radius", "height", "radiusTop", "radiusBottom"):
            value = self.array(prim.GetAttribute(key), prim, float)
            told[key] = float(value) if value.ndim == 0 else 1.0
            if not 0 <= told[key] < np.inf:
                self.refuse(prim, f"{key} = {told[key]:g} is no length")
        half, r = told["height"] / 2, told["radius"]
        self.round |= kind not in ("Cube", "Plane")
        if kind == "Cube":
            return round_shapes.CUBE * told["size"] / 2, round_shapes.CUBE_FACES
        if kind == "Plane":
            # width is along x and length along y, but along z and x where the axis is y (and z, y where it is x)
            sides = (told["width"], told["length"])
            sides = sides if prim.GetAttribute("axis").Get() == "Z" else sides[::-1]
            return round_shapes.SQUARE * [sides[0] / 2, sides[1] / 2, 1], [(0, 1, 2, 3)]
        if kind == "Sphere":
            return round_shapes.sphere(r)
        if kind == "Cylinder":
            return round_shapes.closed_tube(r, r, -half, half)
        if kind == "Cylinder_1":
            return round_shapes.closed_tube(told["radiusBottom"], told["radiusTop"], -half, half)
        if kind == "Cone":
            return round_shapes.closed_tube(r, 0, -half, half)
        if kind == "Capsule":
            return round_shapes.capsule(r, -half, half)
        if kind == "Capsule_1" and told["radiusBottom"] == told["radiusTop"]:
            return round_shapes.capsule(told["radiusTop"], -half, half)
        return None

    # ---- materials ----

    def bound(self, prim, own=False):
        """The bound UsdShade.Material, an invalid one where there is none. own : not of what is above the prim"""
        from pxr import UsdShade

        binding = UsdShade.MaterialBindingAPI(prim)
        if own and not any(name.startswith("material:binding") for name in prim.GetPropertyNames()):
            return None
        for purpose in (UsdShade.Tokens.full, UsdShade.Tokens.preview):
            material = binding.ComputeBoundMaterial(purpose)[0]
            if material:
                return material
        if any(r.GetTargets() for r in (binding.GetDirectBindingRel(),) if r):
            self.left.add("dangling material binding")
        return None

    def group(self, prim):
        from pxr import UsdLux

        bound = self.bound(prim)
        if bound and not prim.HasAPI(UsdLux.LightAPI):
            return self.material(bound)
        name = self.groups(usd_materials.source(prim), prim.GetName(), str(prim.GetPath()))
        if prim.HasAPI(UsdLux.LightAPI):  # a light that is a mesh
            self.emits[name] = True
        return name

    def material(self, material):
        """The name of its group. One definition that is composed at several places is one material."""
        prim = material.GetPrim()
        name = self.groups(usd_materials.source(prim), prim.GetName(), str(prim.GetPath()))
        if name not in self.looked:
            self.looked.add(name)
            self.left.add("material picture", usd_materials.pictures(material))
            if usd_materials.emits(material):
                self.emits[name] = True
            elif usd_materials.clear(material):
                self.clear.append(name)
        return name
