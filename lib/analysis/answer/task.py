"""What is known of a photograph before its materials are sought: facts, files, and what may be doubted."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from lib.analysis.causes import lamp_lobe
from lib.analysis.causes.lamp_lobe import LampLobe
from lib.analysis.fit import facts
from lib.analysis.fit.problem import Problem
from lib.analysis.seen import gather
from lib.analysis.seen.gather import Gathered
from lib.core.stage import BadInput
from lib.given import cameras, edges_file, materials
from lib.given.cameras import Camera
from lib.given.causes import GEOMETRIC
from lib.given.edges_file import Edges, Found
from lib.given.kinds import LOBES, MIRRORS
from lib.given.transfer import Transfer
from lib.given.view import View
from lib.light import factors_file
from lib.light.factors_file import FormFactors


@dataclass(frozen=True, eq=False)
class Task:
    """What is given.

    view : reads photograph, model, camera and facet.png, which only some scenes need; None where they are not there
    audit : the light of all pixels, or None
    lamps, place_sigma_m, surfaces, transfer, causes : as scene.yaml has them (causes: `explain`, or None)
    curve : that scene.yaml tells, of three channels; what else stands here is under the one that they have in common
    lobes : {lamp: (4,)} that scene.yaml tells, which factors, found and audit know;  lobes_unknown : {lamp} to be found
    lambertian : (factors, found) that do not know them
    gamma : where it starts
    may_refine : camera and model are as given, and another model may be asked for;  refined : [Cause] that were, else
    edges : what the photograph's edges say of camera and model; None where they were not asked
    options : of gauss_newton.gauss_newton
    around : makes the same with what lies outside an open model among its lamps; None where that is there, or the model
        is not known
    asked : [Question] of the search, in the order in which they were asked
    """

    problem: Problem
    found: Gathered
    factors: FormFactors
    camera: Camera | None
    view: Callable[[], View] | None
    audit: Gathered | None
    lamps: dict
    place_sigma_m: dict
    lobes: dict
    lambertian: tuple
    lobes_unknown: set
    surfaces: dict
    transfer: object
    causes: list | None
    gamma: float
    threshold: float
    lobe_rays: int
    may_refine: bool
    refined: list
    options: dict
    edges: Found | None = None
    curve: Transfer | None = None
    around: Callable[[], Task] | None = None
    asked: list = field(default_factory=list)

    @classmethod
    def read(cls, opt) -> Task:
        """What the files and options of stages/fit.py give. BadInput: one is missing, or they do not belong together"""
        factors, found = factors_file.read(opt.formfactors), gather.read(opt.gather)
        audit = gather.read(opt.audit) if opt.audit else None
        transfer, curve = opt.transfer, None
        if isinstance(transfer, dict) and "curve" in transfer:
            if not opt.curve:
                raise BadInput("--curve: missing, and --transfer names one")
            curve = materials.read_curve(opt.curve)
            if curve.channels and found.pixels.shape[1] != 3:
                raise BadInput(f"{opt.curve}: linear, display: three lists, and the photograph is grey")
            found, audit = (gather.under_one_curve(each, curve) for each in (found, audit))
            transfer = curve.common
        shown = opt.audit and opt.camera and opt.model and opt.photograph and opt.facet
        light = {opt.gather: found, opt.audit: audit}
        _check_same(factors, opt.formfactors, light)
        if opt.lobes and not shown:
            raise BadInput("--lobes: without --audit, --camera, --model, --photograph and --facet")
        edges = edges_file.read(opt.edges) if opt.edges else None
        moved = materials.read_causes(opt.refined_causes) if opt.refined_causes else edges.taken if edges else []
        view = functools.cache(lambda: _view(opt, factors, curve, light, edges)) if shown else None
        told = (opt, transfer, curve, view, edges, moved)
        around = lambda: cls._of(*told, *gather.with_outside(view, factors, found, audit))
        task = cls._of(*told, factors, found, audit)
        return replace(task, around=around) if shown else task

    @classmethod
    def _of(cls, opt, transfer, curve, view, edges, moved, factors, found, audit) -> Task:
        """transfer : what all channels have in common of the one that is told;  moved : [Cause] of camera and model"""
        lobes = {lamp: materials.lobe(value) for lamp, value in opt.lobes.items() if value != "unknown"}
        lambertian = factors, found
        if lobes:
            factors, found, audit = lamp_lobe.in_lobes(view(), factors, lobes, found, audit)
        return cls(
            problem=facts.problem_of(factors, found, lamps=opt.lamps, reference=opt.reference, transfer=transfer),
            found=found,
            factors=factors,
            camera=cameras.read_cameramodel(opt.camera) if opt.camera else None,
            view=view,
            audit=audit,
            lamps=opt.lamps,
            place_sigma_m=opt.place_sigma_m,
            lobes=lobes,
            lambertian=lambertian,
            lobes_unknown=opt.lobes.keys() - lobes.keys(),
            surfaces=opt.surfaces,
            transfer=opt.transfer,
            causes=opt.explain,
            gamma=opt.gamma,
            threshold=opt.threshold,
            lobe_rays=opt.lobe_rays,
            may_refine=bool(opt.causes_out) and not moved,
            refined=moved,
            options={"max_iterations": opt.max_iterations, "tolerance": opt.tolerance},
            edges=edges and edges.now,
            curve=curve if curve and curve.channels else None,
        )

    def in_lobes(self, lobes) -> Task:
        """The same with the light of lamps that throw it in lobes {lamp: (4,)}."""
        if not lobes:
            return self
        factors, found, audit = lamp_lobe.in_lobes(self.view(), self.factors, lobes, self.found, self.audit)
        return replace(self, factors=factors, found=found, audit=audit)

    @property
    def lamp_lobes(self) -> LampLobe | None:
        """Of the lamps whose lobe scene.yaml leaves open."""
        told = any(kind in (*MIRRORS, *LOBES) for kind in self.surfaces.values())  # their light looks like a lobe's
        may = not told and (self.causes is None or LampLobe.name in self.causes)
        open_ = self.factors.own_lamps if may else self.lobes_unknown
        wanted = [lamp for lamp in self.factors.own_lamps if lamp in open_ and lamp not in self.lobes]
        if not wanted or not self.can_look:
            return None
        return LampLobe(self.view, self.factors, self.found, tuple(wanted), bool(self.lobes_unknown))

    @property
    def allowed(self):
        """The geometric causes that may be taken."""
        return set(GEOMETRIC if self.causes is None else self.causes)

    @property
    def can_look(self):
        """Whether pixels and edges of the photograph can be looked at, and are worth it."""
        seen = self.view is not None and len(self.problem.tile_group) > 0
        return seen and not gather.out_of_range(self.found)


def _check_same(factors, formfactors, gathered):
    """BadInput: light {path: Gathered or None} of other groups, patches or lamps than the factors have."""
    groups, patches, lamps = len(factors.groups), len(factors.area), len(factors.lamps)
    for path, found in gathered.items():
        if found is None:
            continue
        held = len(found.visible), found.tiles.rows.columns
        if held != (groups, patches):
            raise BadInput(f"{path}: groups, patches: {held[0]}, {held[1]} are not those of {formfactors}")
        if found.tiles.direct.shape[1] != lamps:
            n, names = found.tiles.direct.shape[1], ", ".join(factors.lamps)
            raise BadInput(f"{path}: tiles_direct: {n} lamps are not those of {formfactors}: {names}")


def _view(opt, factors, curve, light, edges: Edges | None):
    """The photograph with its camera and the model that the factors are of.

    curve : that scene.yaml tells, or None;  light : {path: Gathered or None}
    BadInput: the light is that of other facets, or of pixels beyond the photograph; edges of other objects.
    """
    view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph, facet=opt.facet)
    factors_file.check(factors, opt.formfactors, view.model, opt.model)
    for path, found in light.items():
        if found is not None:
            facets, objects, pixels = view.model.n_facets, len(view.model.objects), view.facet.size
            tiles = found.tiles
            _check_below(f"{path}: tiles_facet", tiles.facet, facets, f"facets of {opt.model}")
            _check_below(f"{path}: object", found.object, objects, f"objects of {opt.model}")
            _check_below(f"{path}: tiles_pixel", tiles.pixel, pixels, f"pixels of {opt.facet}")
    named = [*edges.now.covariances, *(cause.subject for cause in edges.taken if cause.subject)] if edges else []
    if strange := set(named) - {*view.model.objects, *view.model.groups}:
        raise BadInput(f"{opt.edges}: object: {min(strange)!r} is none of {opt.model}")
    return view if curve is None else view.under_one_curve(curve)


def _check_below(where, values, size, of):
    if values.max(initial=-1) >= size:
        raise BadInput(f"{where}: value: {values.max()} is beyond the {size} {of}")
