"""What to do next: from how a run ended to one to three lines, for the terminal's end and for the page.

    for line in steps(read("build/attic", "attic")):
        print(line)

Only the standard library: this runs at the end of every `make`. A line is a whole sentence, and names the key of
scene.yaml, the file or the command. What stands between backquotes is to be typed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given.causes import BUILT

MOST = 3  # lines
LOOSE = 0.05  # relative sigma of the typical reflectance, from which a known one is worth telling
MORE = 4  # times the rays, where rays are too few: half the noise
MAKE = re.compile(r"^# again: (make .*)$", re.MULTILINE)  # in the head of plan.mk
ELSEWHERE = {"pose", "principal_point", "camera", "units", "up_axis", "objects", "lamp_place", "unknown"}  # see edges


@dataclass(frozen=True)
class State:
    """make : the command of the scene, `make attic`;  build : the folder of its outputs, as one types it

    materials, pose, check : content of the JSON files, {} without;  reports : {stage: content of its report}
    """

    make: str
    build: str
    materials: dict = field(default_factory=dict)
    pose: dict = field(default_factory=dict)
    check: dict = field(default_factory=dict)
    reports: dict = field(default_factory=dict)

    @property
    def status(self):
        """Of the materials, None without."""
        return self.materials.get("status")

    def argument(self, name):
        """What scene.yaml told the fit."""
        return _table(_table(self.reports.get("fit")).get("arguments")).get(name)

    @property
    def picture(self):
        return f"{self.build}/check.png"


def read(build, scene, stages=None) -> State:
    """How the scene in the folder `build` stands. stages : whose reports and files count; None: all that are there"""
    build = Path(build)
    found = {path.name.removesuffix(".report.json"): path for path in sorted(build.glob("*.report.json"))}
    reports = {name: _json(path) for name, path in found.items() if stages is None or name in stages}
    of = lambda stage, file: _json(build / file) if stages is None or stage in stages else {}
    pose = _json(build / "pose.json") if {"pose", "recognise", "place"} & reports.keys() else {}
    materials = of("fit", "materials.json")
    check = of("check", "check.json") if not materials else {}
    return State(_again(build, scene), _shown(build), materials, pose, check, reports)


def _again(build, scene):
    """The command that made the folder: the plan says it."""
    try:
        found = MAKE.search((build / "plan.mk").read_text(encoding="utf-8", errors="replace")[:2000])
    except OSError:
        found = None
    return found[1] if found else f"make {scene.partition('/')[0]}"


def _shown(build):
    """A path as short as it can be typed where `make` runs."""
    try:
        return build.resolve().relative_to(Path.cwd()).as_posix()
    except ValueError:
        return str(build)


def _json(path):
    try:
        return _table(artefact.read_json(path))
    except BadInput:
        return {}


def _table(value):
    return value if isinstance(value, dict) else {}


def steps(state: State) -> list[str]:
    """One to three lines, the first thing first; none where the run says nothing of how it ended."""
    return list(dict.fromkeys(line for rule in RULES for line in rule(state)))[:MOST]


# ---- rules: one for each way to end; what stands above comes first ----


def _ambiguous(state):
    """The pose: of a pair, or of picked places."""
    status = state.pose.get("status")
    if status == "ambiguous":
        more = "more corners, in other depths," if "pose" in state.reports else "eight or more corners of the model"
        yield (
            f"Pick {more} in the photograph and write them into `pose.csv` of the scene's folder: another pose fits"
            " as well (`ambiguous` in pose.json), and all that follows rests on the first."
        )
    elif status == "symmetric":
        yield (
            "The model comes onto itself, and the poses are equal: if one is meant, pick eight corners into `pose.csv`."
        )


def _nothing_there(state):
    """A stage of the geometry that found nothing."""
    if _status_of(state, "match") == "nothing matched":
        yield (
            "Take two photographs from places closer together (5 to 10 degrees), or tell the pose of one: pick eight"
            " corners into `pose.csv`."
        )
    elif _status_of(state, "reconstruct") == "nothing reconstructed":
        yield "Tell the pose of one photograph instead: pick eight corners of the model into `pose.csv`."


def _nothing_seen(state):
    if "nothing seen" not in (state.status, *(_status_of(state, name) for name in ("index", "gather"))):
        return
    if _status_of(state, "index") == "nothing seen":
        yield _look(state, "no pixel shows the model: the camera looks past it")
        yield "Correct the pose, or write `model: {unit: cm}` or `model: {up: y}` in scene.yaml if that is so."
    else:
        yield _look(state, "the model is there, and no pixel of it can be used")
        yield (
            "Give a photograph that is neither white nor black there; where facets are small in the picture write"
            " `params: {index: {margin_px: 1, keep: 1.0}}` in scene.yaml."
        )


def _does_not_fit(state):
    if state.status not in ("approximate", "does not fit"):
        return
    why = [_table(one) for one in state.materials.get("why") or []]
    first = [one for one in why if one.get("cause") != "unknown"] or why
    elsewhere = not why or any(one.get("cause") in ELSEWHERE for one in why[:2])
    if elsewhere:
        yield _look(state, "where lines lie beside the edges, the pose or the model is wrong")
    for one in first[:MOST]:
        if line := _way_out(state, one):
            yield line
    if not elsewhere:
        yield _look(state, "lines beside the edges would mean another pose or model")


def _not_converged(state):
    for stage, report in state.reports.items():
        if report.get("status") != "not converged" or state.status == "does not fit":
            continue
        told = _table(report.get("arguments"))
        kind = stage.partition(".")[0]
        if kind == "fit" and not _unbalanced(report):
            yield _raise(state, stage, {"max_iterations": 2 * (_whole(told.get("max_iterations")) or 40)})
        elif kind in ("fit", "formfactors") or _unbalanced(report):
            yield (
                "Light stays between surfaces that reflect almost all of it: tell the lamps' numbers, or one known"
                f" reflectance (`{_reference(state)}` in scene.yaml)."
            )
        elif kind == "radiosity":
            yield _raise(state, stage, {"method": "krylov"})
        elif "rays" in told:
            yield _raise(state, stage, {"rays": MORE * (_whole(told.get("rays")) or 256)})


def _noisy(state):
    """New pictures whose light is mottled."""
    for stage, report in state.reports.items():
        if report.get("noisy") and report.get("status") != "not converged":
            rays = MORE * (_whole(_table(report.get("arguments")).get("rays")) or 256)
            told = f"params: {{augment: {{rays: {rays}}}}}"
            yield f"Write `{told}` in scene.yaml, then `{state.make}`: {stage} is mottled."


def _scale(state):
    """Every lamp is unknown, and what fixes the scale is weak."""
    if state.status not in ("converged", "not converged") or state.argument("reference"):
        return
    scale, loose = state.materials.get("scale"), _looseness(state)
    if scale == "convention" or scale == "interreflection" and loose is not None and loose > LOOSE:
        known = "right up to one factor" if scale == "convention" else f"known to {100 * loose:.0f} % only"
        yield (
            f"Tell one reflectance that you know, `{_reference(state)}` in scene.yaml: the lamps are unknown, and"
            f" without it all values are {known}."
        )


def _doubtful(state):
    """After `make <scene>/check`."""
    if not state.check:
        return
    doubts = sum(bool(_table(found).get("doubt")) for found in state.check.get("findings") or [])
    yield _look(state, "the lines should lie on the edges of the photograph", made=True)
    if doubts:
        yield f"Then mend what is marked ! above ({doubts} doubt{'s' * (doubts != 1)}); each line names the way out."
    yield f"If all is right: `{state.make}`."


def _geometry(state):
    """Cameras, facets or a pose, and no photometry was asked for: what the next thing needs."""
    if state.materials or state.check or "fit" in state.reports:
        return
    if state.pose.get("status") in ("unique", "symmetric"):
        yield (
            "For materials and light leave `goals` out of scene.yaml and write which groups are lamps,"
            f" `lamps: {{lamp: unknown}}`; then `{state.make}`."
        )
    elif _status_of(state, "reconstruct") == "complete" and "recognise" not in state.reports:
        yield f"Put the room's model (`model.obj`, metres) into the scene's folder: `{state.make}` then finds the pose."
    elif "calibrate" in state.reports and len(state.reports) <= 3:
        yield (
            f"The lens is found: copy `{state.build}/left.cameramodel` into the folders of scenes that were taken"
            " with it, the same zoom and focus."
        )


def _made(state):
    """It fits: what it is good for."""
    if state.status not in ("converged", "approximate") or state.pose.get("status") == "ambiguous":
        return
    if "export" not in state.reports:
        yield f"Take it to Blender, Mitsuba, Radiance or USD: `{state.make}/export` writes `{state.build}/exports/`."
    group = _largest(state)
    if group and not any(name.startswith("augment.") for name in state.reports):
        change = f"augment: [{{name: red, change: {{{_word(group)}: {{rho_d: [0.6, 0.1, 0.1]}}}}}}]"
        yield (
            f"For a new picture write `{change}` in scene.yaml, then `{state.make}`: `{state.build}/augmented.red.png`"
            " (docs/augment.md has more)."
        )


RULES = (
    *(_ambiguous, _nothing_there, _nothing_seen, _does_not_fit, _not_converged, _noisy, _scale, _doubtful),
    *(_geometry, _made),
)


# ---- why it does not fit: the way out of each cause ----


WAYS = {  # {name} is the subject
    "curve": "Write `transfer: auto` in scene.yaml, and give the camera's own file: the curve is not as told.",
    "matrix": "Write `transfer: auto` in scene.yaml: the camera mixes colours.",
    "vignetting": "Let `explain` in scene.yaml name vignetting, or leave `explain` out.",
    "transfer": "Write `transfer: auto` in scene.yaml: another curve of the camera fits better than the one told.",
    "range": "Multiply the photograph's values: they use a part of the file's range (12 bits in 16: times 16).",
    "lamp_power": "Write `lamps: {{{name}: unknown}}` in scene.yaml: its emittance is not as told.",
    "lamp_colour": "Write `lamps: {{{name}: unknown}}` in scene.yaml: its colour is not as told.",
    "lamp_lobe": "Write `lamps: {{{name}: {{emittance: unknown, lobe: unknown}}}}` in scene.yaml: it throws a lobe.",
    "lamp_flipped": "Turn the faces of {name} round in the model (Blender: Mesh, Normals, Flip): its front looks away.",
    "lamp_place": (
        "Put {name} where it hangs in the model, or write in scene.yaml"
        " `lamps: {{{name}: {{emittance: unknown, place_sigma_m: 0.3}}}}`."
    ),
    "glow": "Draw the wall or the window that is missing in the model: light comes in there.",
    "open_model": "Draw the wall or the window that is missing in the model: light comes in there.",
    "pose": "Pick the corners anew (`pose.csv`), the farthest and the nearest too: the camera stood elsewhere.",
    "camera": "Pick the corners anew (`pose.csv`), and check `model: {{unit: ..., up: ...}}` in scene.yaml.",
    "principal_point": "Give the photograph uncropped, or its calibrated lens (`left.cameramodel`).",
    "objects": "Move {name} in the model to where it stands in the photograph.",
    "units": "Write `model: {{unit: ...}}` in scene.yaml: the model was drawn in another unit.",
    "up_axis": "Write `model: {{up: ...}}` in scene.yaml: the model's axes are not as told.",
    "object_missing": "Draw what is missing into the model, a box will do, with a material of its own.",
    "group_wrong": "Give {name} a material of its own in the model, or take it out if the room has it not.",
    "noise": "Give the JPEG itself, or a picture that was none: what blocks of 8 pixels hide is lost.",
    "unknown": "Look at the difference on the page: where it is strong, a lamp, an object or a material is wrong.",
}
LEAVE = {"matrix": "curve", "principal_point": "pose"}  # whose leave `explain` gives under another name


def _way_out(state, why):
    """A line, or None for a cause that this does not know."""
    cause, subject, text = why.get("cause"), why.get("subject"), str(why.get("text") or "")
    leave, allowed = LEAVE.get(cause, cause), state.argument("explain")
    if isinstance(allowed, list) and leave in BUILT and leave not in allowed:
        return f"Let `explain` in scene.yaml name {leave}, or leave `explain` out: {leave} may then be put right."
    if cause == "group_wrong" and text.startswith("reference."):
        told = f"reference: {{{_word(subject)}: ...}}"
        return f"Correct `{told}` in scene.yaml, a linear share of the light, or leave it out."
    if found := re.search(r"`?(model: \{\w+: [\w-]+\})`?", text):
        return f"Write `{found[1]}` in scene.yaml."
    line = WAYS.get(cause)
    return line.format(name=_word(subject) if subject else "what is meant") if line else None


# ---- parts of lines ----


def _look(state, why, made=False):
    """check.png is the first thing to look at."""
    made = made or (Path(state.build) / "check.png").is_file()
    return f"Look at `{state.picture}`{'' if made else f' (`{state.make}/check` draws it)'}: {why}."


def _raise(state, stage, params):
    """params : {name: value} of a stage, or of one of its entries"""
    told = ", ".join(f"{name}: {value}" for name, value in params.items())
    kind = stage.partition(".")[0]
    return f"Write `params: {{{kind}: {{{told}}}}}` in scene.yaml, then `{state.make}`: {stage} has not converged."


def _unbalanced(report):
    said = " ".join(map(str, report.get("warnings") or []))
    return "the light balance is" in said


def _status_of(state, stage):
    return _table(state.reports.get(stage)).get("status")


def _whole(value):
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _groups(state):
    """{name: content} of the diffuse groups that the photograph determines, those with most pixels first."""
    groups = {name: _table(g) for name, g in _table(state.materials.get("groups")).items()}
    good = [name for name, g in groups.items() if g.get("identified") and g.get("kind") in (None, "diffuse")]
    pixels = lambda name: groups[name].get("pixels") if isinstance(groups[name].get("pixels"), int) else 0
    lamps = _table(state.materials.get("lamps"))
    return {name: groups[name] for name in sorted(good, key=lambda name: -pixels(name)) if name not in lamps}


def _largest(state):
    return next(iter(_groups(state)), None)


def _reference(state):
    return f"reference: {{{_word(_largest(state) or 'wall')}: [0.8, 0.8, 0.8]}}"


def _looseness(state):
    """The median of sigma / rho_d, over groups and channels; None where nothing says it."""
    shares = []
    for group in _groups(state).values():
        rho, sigma = group.get("rho_d"), _table(group.get("sigma")).get("rho_d")
        if isinstance(rho, list | tuple) and isinstance(sigma, list | tuple):
            pairs = zip(rho, sigma, strict=False)
            shares += [s / r for r, s in pairs if isinstance(r, int | float) and isinstance(s, int | float) and r > 0]
    return sorted(shares)[len(shares) // 2] if shares else None


def _word(name):
    """A name as YAML takes it.

    >>> _word("wall"), _word("wall: left"), _word("3d")
    ('wall', '"wall: left"', '"3d"')
    """
    text = str(name)
    plain = re.fullmatch(r"[A-Za-z_][\w.-]*", text) and text.lower() not in ("yes", "no", "on", "off", "true", "null")
    return text if plain else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
