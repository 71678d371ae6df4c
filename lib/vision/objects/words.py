"""What a user should know of where objects are."""

import numpy as np

from lib.core.report import Note

UP = 0.9  # cosine: an axis that points up in the picture is a height


def warnings(result) -> list[str]:
    """Objects that are not there, or of which nothing can be told; moved ones; dimensions that the model has wrong."""
    said = []
    for p in result.placed:
        if p.found is False:
            said.append(Note(f"{p.name}: is not in the photographs, and is left out"))
        elif p.found is None:
            shown = f", {100 * p.fit.support:.0f} % of its edges at the best place" if p.fit and p.fit.number else ""
            said.append(f"{p.name}: the photographs cannot tell where it is, or whether it is there{shown}")
        elif p.why == "refined":
            far = f"{100 * moved_m(result, p):.1f} cm"
            said.append(Note(f"{p.name}: stands {far} from where the model has it, and was moved"))
    for p in result.aside:
        far = f"{100 * moved_m(result, p, is_there=False):.1f} cm"
        said.append(f"{p.name}: stands {far} from where the model has it; `refine: [objects]` would move it")
    return said + [text(size) for size in result.sizes]


def moved_m(result, placed, is_there=True) -> float:
    """How far the middle of an object of the model went, or would go."""
    model = result.model
    thing = model.objects.index(placed.name)
    p = model.vertices[np.unique(model.triangles[model.facet_object[model.triangle_facet] == thing])].mean(axis=0)
    other = placed.T[:3, :3].T @ (p - placed.T[:3, 3]) if is_there else placed.T[:3, :3] @ p + placed.T[:3, 3]
    return float(np.linalg.norm(p - other))


def text(size) -> str:
    """In words: the desk is 2.0 cm higher than the model, 11 sigma."""
    by, sigmas = f"{100 * abs(size.by_m):.1f} cm", f"{abs(size.by_m) / size.sigma_m:.0f} sigma"
    if max(np.abs(size.axis)) > UP and np.argmax(np.abs(size.axis)) == size.up:
        return f"{size.name}: is {by} {'higher' if size.by_m > 0 else 'lower'} than the model, {sigmas}"
    longer = "longer" if size.by_m > 0 else "shorter"
    return f"{size.name}: is {by} {longer} along {_direction(size.axis)} than the model, {sigmas}"


def _direction(way):
    return "[" + ", ".join(f"{x:.2f}" for x in np.asarray(way) + 0.0) + "]"


def facts(result) -> dict:
    """For the report."""
    of = lambda p: {
        "found": p.found,
        "why": p.why,
        "edges_found": p.fit.support if p.fit else None,
        "edges_found_by_chance": p.fit.chance if p.fit else None,
        "evidence_nats": p.fit.nats if p.fit else None,
        "rms_px": p.fit.rms_px if p.fit else None,
        "stands": p.fit.stands if p.fit else None,
    }
    return {p.name: of(p) for p in result.placed}
