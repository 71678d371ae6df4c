"""What is to be rendered: a view, its geometry, how it looks, and how well the picture is to be made."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lib.core import arrays, artefact
from lib.core.arrays import Starts, Whole
from lib.given.falloff import Lens
from lib.given.transfer import Transfer, display_of_linear
from lib.given.transfer_kinds import OF_LIGHT
from lib.given.view import View
from lib.light import factors_file, outside, specular_file, throws
from lib.light import surface as surfaces
from lib.light.factors_file import FormFactors
from lib.light.specular_file import Traced
from lib.light.surface import Surface
from lib.picture import appearance, display
from lib.picture.appearance import Appearance
from lib.picture.curved import Curved
from lib.picture.texels import TEXELS


@dataclass(frozen=True, eq=False)
class Subject:
    """What a rendering needs. C channels: one where the photograph is grey.

    transfer : how the finished picture is displayed;  coverage : the A-buffer, see lib/buffers/coverage.py
    traced : light past mirrors and glossy surfaces, where `fit` has traced it
    falloff : (H, W, 1) of the lens, or None
    fitted : {group: display RMSE} that a fit which converged says of its tiles
    curved : smooth surfaces and mirrors of many facets, None where there are none
    """

    view: View
    surface: Surface
    factors: FormFactors
    coverage: dict
    appearance: Appearance
    transfer: Transfer
    traced: Traced | None = None
    warnings: list = field(default_factory=list)
    falloff: np.ndarray | None = None
    curved: Curved | None = None
    fitted: dict = field(default_factory=dict)

    @property
    def channels(self):
        return self.appearance.channels

    @property
    def groups(self):
        return self.factors.groups

    @property
    def lamp_groups(self):
        """(L,) numbers of the groups that emit, -1 for the outside."""
        return self.factors.lamp_groups

    @property
    def facet(self):
        return self.view.facet

    @property
    def group(self):
        """(H, W) int, -1 = nothing."""
        return np.where(self.facet >= 0, self.surface.group[self.facet], -1)

    @property
    def pure(self):
        """(H, W) bool: the pixel shows one facet."""
        result = self.facet >= 0
        result.reshape(-1)[np.asarray(self.coverage["pixel"], np.int64)] = False
        return result

    @property
    def counted(self):
        """(H, W) bool: pixels that say something of the light: of the model, no lamp, neither black nor saturated."""
        values = self.view.photograph.values
        usable = (values > 2 / 255).all(axis=2) & ((values < 250 / 255).all(axis=2) | self.view.photograph.linear)
        return self.pure & usable & ~np.isin(self.group, self.lamp_groups)

    @property
    def wanted(self):
        """(H, W, C) the photograph in display values; a linear one under the power 1 / 2.2."""
        return self.view.photograph.display

    @property
    def simple(self):
        """Whether T() is a function of the radiosity alone."""
        return self.view.photograph.linear or self.transfer.kind in OF_LIGHT

    def through_lens(self, B):
        """The light (H, W, C) as the lens lets it through."""
        return B if self.falloff is None else B * self.falloff

    def show(self, B):
        """Linear -> display values in [0, 1], any shape for functions of light alone, whole pictures for the others."""
        if self.view.photograph.linear:
            return display_of_linear(B)
        if self.simple:
            return display.finished(B, self.transfer)
        return display.finished(B, self.transfer, self.wanted, self.group, self.pure)

    def quantised(self, shown):
        """What the file will say, and its largest number; an EXR is compared as it is and shown in 8 bits."""
        depth = 65535 if self.view.photograph.bits == 16 else 255
        return (shown if self.view.photograph.linear else np.round(shown * depth) / depth), depth

    def channels_of_file(self, values):
        """(H, W, C) with as many channels as the photograph's file."""
        return np.repeat(values, self.view.photograph.channels_in_file // values.shape[2], axis=2)


COVERAGE = {
    "pixel": Whole("P", below="pixels"),
    "start": Starts("P+1", into="S"),
    "facet": Whole("S", below="facets"),
    "count": Whole("S"),
}


def read(*, model, camera, photograph, facet, formfactors, materials, coverage, specular=None) -> Subject:
    """All files of a rendering, each checked against the others; BadInput names what does not fit.

    specular : specular.npz of the fit; it is passed over where it was traced for other surfaces than materials.json has
    """
    view = View.read(camera=camera, model=model, photograph=photograph, facet=facet)
    factors = factors_file.read(formfactors, view.model, model)
    surface = surfaces.surface(view.model, factors.lamps)
    factors = outside.with_outside(factors, lambda: surface)
    pieces = artefact.read_npz(coverage, *COVERAGE)
    arrays.check(coverage, pieces, COVERAGE, {"pixels": view.facet.size, "facets": view.model.n_facets})
    channels = view.photograph.values.shape[2]
    look, found, warnings = appearance.read(materials, factors.groups, factors.lamps, channels, view.model.n_facets)
    factors = throws.in_lobes(factors, surface, found.lobes)
    traced = specular_file.read(specular) if specular and look.finish is not None else None
    if traced is not None and not traced.fits(look.finish, len(factors.mesh), factors.lobe_of_lamps):
        traced = None
    T, gain = found.transfer.function, falloff(found, view)
    is_fitted = found.status == "converged" and T.kind in OF_LIGHT
    fitted = {g: told.error for g, told in found.groups.items() if told.error} if is_fitted else {}
    return Subject(view, surface, factors, pieces, look, T, traced, warnings, gain, fitted=fitted)


def falloff(found, view):
    """(H, W, 1) what the lens lets through, None where nothing was found of it."""
    cause = next((cause for cause in found.explained if cause.cause == "vignetting"), None)
    if cause is None:
        return None
    height, width = view.shape
    lens = Lens(tuple(cause.values["centre_px"]), (width, height))
    return lens.gain(lens.pixels, cause.values["k"]).reshape(height, width, 1)


@dataclass(frozen=True)
class Quality:
    """n_rays : gathering rays at each place;  shadow_rays : per pixel and lamp in a penumbra
    contact, tolerance : see indirect.gather;  lobe_rays : per pixel of a glossy surface
    n_texels : about so many in the light map;  step : local, their width instead, see texels.light_map
    steady : the same rays at a pixel whatever else is in the picture
    """

    n_rays: int = 256
    shadow_rays: int = 64
    contact: float = 0.35
    tolerance: float = 0.01
    lobe_rays: int = 64
    n_texels: int = TEXELS
    step: float | None = None
    steady: bool = False


STANDARD = Quality()
