"""What a material of USD is: where it is defined, and whether it emits."""

from __future__ import annotations

import numpy as np

# Inputs of UsdPreviewSurface, standard_surface and OpenPBR, and what they are of an opaque material
CLEAR = {"opacity": 1.0, "geometry_opacity": 1.0, "transmission": 0.0, "transmission_weight": 0.0}
BLENDER = "userProperties:blender:data_name"


def source(prim):
    """What tells a prim from all others: where its opinions stand.

    Blender writes a material once more into each prototype of an instance: it is one by its name there and its content.
    """
    told = prim.GetAttribute(BLENDER)
    if told and (blender := told.Get()):
        return "blender", str(blender), _content(prim)
    return tuple((spec.layer.identifier, str(spec.path)) for spec in prim.GetPrimStack())


def _content(prim):
    """Properties and values at and below a prim, paths as seen from it."""
    from pxr import Usd

    root, rows = str(prim.GetPath()), []
    for one in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
        rows.append(f"{str(one.GetPath()).removeprefix(root)} {one.GetTypeName()}")
        for attribute in one.GetAuthoredAttributes():
            connected = [str(path).removeprefix(root) for path in attribute.GetConnections()]
            rows.append(f"{attribute.GetName()} {attribute.Get(Usd.TimeCode.EarliestTime())} {connected}")
    return tuple(rows)


def emits(material) -> bool:
    """Does one of its shaders emit?"""
    for shader in _shaders(material):
        told = {key: _input(shader, key) for key in ("emissiveColor", "emission", "emission_color")}
        told["luminance"] = _input(shader, "emission_luminance")
        if told["emissiveColor"]:  # UsdPreviewSurface
            return True
        weight = told["emission"] if told["luminance"] is None else told["luminance"]
        if weight and told["emission_color"] is not False:  # standard_surface, OpenPBR: the weight is 0 where not told
            return True
        if weight is None and told["emission_color"]:  # a shader that has no weight
            return True
    return False


def clear(material) -> bool:
    """Does one of its shaders let light through, everywhere?"""
    for shader in _shaders(material):
        for key, opaque in CLEAR.items():
            given = shader.GetInput(key)
            value = given.Get() if given and not given.HasConnectedSource() else None
            try:
                if value is not None and np.any(np.array(value, float) != opaque):
                    return True
            except (TypeError, ValueError):  # no numbers
                continue
    return False


def pictures(material) -> int:
    """How many of its shaders name a file."""
    return sum(any(str(i.GetTypeName()) == "asset" for i in shader.GetInputs()) for shader in _shaders(material))


def _shaders(material):
    from pxr import Usd, UsdShade

    shaders = map(UsdShade.Shader, Usd.PrimRange(material.GetPrim(), Usd.TraverseInstanceProxies()))
    return [shader for shader in shaders if shader]


def _input(shader, key):
    """Is an input above 0? True for one that is connected to a picture; None where it is not told."""
    given = shader.GetInput(key)
    if not given:
        return None
    if given.HasConnectedSource():
        sources = given.GetValueProducingAttributes()
        if any(source.GetName().startswith("outputs:") for source in sources):
            return True
        values = [source.Get() for source in sources]
    else:
        values = [given.Get()]
    values = [value for value in values if value is not None]
    try:
        return any(np.any(np.array(value, float) > 0) for value in values) if values else None
    except (TypeError, ValueError):  # no numbers
        return None
