"""Models without some of their objects, and with more of them."""

from dataclasses import replace

import numpy as np

from lib.given.model.mesh import Model


def only(model, objects) -> Model:
    """The model's objects of these names alone; facets, objects and groups are numbered anew, in the same order."""
    chosen = np.isin(model.objects, list(objects))
    facets = chosen[model.facet_object]
    triangles = model.triangles[facets[model.triangle_facet]]
    used, where = np.unique(triangles, return_inverse=True)
    things, facet_object = np.unique(model.facet_object[facets], return_inverse=True)
    groups, facet_group = np.unique(model.facet_group[facets], return_inverse=True)
    return Model(
        model.vertices[used],
        where.reshape(-1, 3).astype(np.int32),
        (np.cumsum(facets) - 1)[model.triangle_facet[facets[model.triangle_facet]]].astype(np.int32),
        facet_object.astype(np.int32),
        facet_group.astype(np.int32),
        model.facet_normal[facets],
        model.facet_offset[facets],
        tuple(model.objects[i] for i in things),
        tuple(model.groups[i] for i in groups),
        model.warnings,
        model.closed_objects[things],
    )


def without(model, objects) -> Model:
    """The model without the objects of these names; see `only`."""
    return only(model, set(model.objects) - set(objects))


def joined(model, name, thing) -> Model:
    """The model with all of another one as its last object.  Groups of one name are one group.

    name : of the new object        thing : Model, in the frame of the first
    """
    groups = tuple(dict.fromkeys((*model.groups, *thing.groups)))
    own = np.array([groups.index(group) for group in thing.groups])
    return replace(
        model,
        vertices=np.concatenate([model.vertices, thing.vertices]),
        triangles=np.concatenate([model.triangles, thing.triangles + len(model.vertices)]).astype(np.int32),
        triangle_facet=np.concatenate([model.triangle_facet, thing.triangle_facet + model.n_facets]).astype(np.int32),
        facet_object=np.append(model.facet_object, np.full(thing.n_facets, len(model.objects))).astype(np.int32),
        facet_group=np.append(model.facet_group, own[thing.facet_group]).astype(np.int32),
        facet_normal=np.concatenate([model.facet_normal, thing.facet_normal]),
        facet_offset=np.append(model.facet_offset, thing.facet_offset),
        objects=(*model.objects, name),
        groups=groups,
        closed_objects=np.append(model.closed_objects, thing.closed_objects.all()),
    )
