"""What the scene's folder holds, checked before any stage runs."""

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given.units import METRES
from lib.planning import augment, near_misses
from lib.planning.files import (
    FSPY,
    MODEL,
    OBJECTS,
    PHOTOGRAPH,
    PHOTOS,
    PICKED,
    PICTURES,
    PINHOLE,
    SIDES,
    UNREAD,
    alternatives,
    further,
    lens_of,
    model_groups,
    object_files,
    photograph_of,
    unread_objects,
)
from lib.planning.rules import NAME, show

LABELS = ("group.png", "object.png", "facet.png", "mirror.png")  # of the photograph's size
RESULTS = (
    *("formfactors.npz", "gather.npz", "audit.npz", "coverage.npz", "specular.npz"),
    *("materials.json", "pose.json", "facets.json", "legend.json", "rendered.json", "edges.json"),
)  # read in earnest by the stage that needs them, or by the comparison; here, that they can be read at all


def folder_problems(scene):
    """Files that stand in each other's way: two photographs, two models, a folder where a file should be."""
    for file in (*map(photograph_of, SIDES), MODEL):
        there = [p.name for p in scene.candidates(file)]
        if len(there) > 1:
            yield f"{scene.folder}: {' and '.join(there)}: only one of them may be given"
        for name in alternatives(file):
            if (scene.folder / name).is_dir():
                yield f"{scene.folder / name}: is a folder, not a file"
    yield from _pose_problems(scene)
    yield from _object_problems(scene)
    yield from _photo_problems(scene)
    groups = model_groups(scene.given(MODEL)) if scene.given(MODEL) else None
    if groups:
        yield from _unknown_groups(scene, groups)


def inspect(scene, files) -> list[str]:
    """Open in earnest what lies in the folder, so that bad input is refused before any stage has written anything.

    files : names as in pipeline.yaml, of which the model, photographs and cameras are opened.
    Returns problems, one line each.
    """
    from lib.given import (
        image,
        lenses,
        materials,
        picks,
        picks_frame,
        sight,
    )  # NumPy: a plan whose files were found good does without
    from lib.given import model as models
    from lib.given.view import size_problem

    problems, found = [], {}
    cameras = {f"{side}.{posed}cameramodel": side for side in SIDES for posed in ("posed.", "")}
    readers = {
        MODEL: models.load,
        **{photograph_of(side): image.read_photograph for side in SIDES},
        **dict.fromkeys(cameras, lenses.read),
        scene.views["<curve>"]: materials.read_curve,
    }
    photographs = [scene.given(photograph_of(side)) for side in SIDES if photograph_of(side) in files]
    problems += [line for path in filter(None, photographs) if (line := image.format_problem(path))]
    if problems:
        return problems  # of what is in another format no more is known
    for file, reader in readers.items():
        if file in files and (path := scene.given(file)):
            try:
                found[file] = reader(path)
            except BadInput as bad:
                problems += bad.problems
    picked = [scene.given(file) if file in files else None for file in PICKED]
    metres = METRES[scene.fact("unit")]
    if any(picked):
        where = next(filter(None, picked))
        try:
            told = picks.read(*picked)
            if (n := len(told.p) + len(told.ends)) < picks.LEAST:
                problems.append(f"{where}: {n} picked place{'s' * (n != 1)}: at least {picks.LEAST} are needed")
            elif MODEL in found and (line := picks_frame.otherwise(told.p, found[MODEL].scaled(metres))):
                problems.append(f"{where}: {line}")
        except BadInput as bad:
            problems += bad.problems
    for camera, side in cameras.items():
        photograph = photograph_of(side)
        if camera in found and photograph in found:
            paths = scene.given(photograph), scene.given(camera)
            if problem := size_problem(paths[0], found[photograph].values, found[camera], paths[1]):
                problems.append(problem)
    if MODEL in found:
        problems += _unknown_groups(scene, found[MODEL].groups)
        problems += _object_names(scene, found[MODEL].objects)
    posed = found.get("left.posed.cameramodel")
    if posed and MODEL in found and (line := sight.unseen(posed, found[MODEL].scaled(metres))):
        problems.append(f"{scene.given('left.posed.cameramodel')}: {line}")
    if PHOTOGRAPH in found and found[PHOTOGRAPH].values.shape[2] == 1:
        problems += _coloured(scene)
    problems += _given_results(scene, found)
    if PHOTOS in files:
        problems += _unusable_photos(scene)
    if scene.augment:
        problems += augment.inspect(scene, found.get(MODEL))
    if OBJECTS in files:
        for path in object_files(scene.given(OBJECTS)):
            try:
                models.load(path)
            except BadInput as bad:
                problems += bad.problems
    return problems


def _coloured(scene):
    """Values that differ from channel to channel, beside a photograph that has but one."""
    for key in ("lamps", "reference"):
        for name, value in (scene.fact(key) or {}).items():
            if isinstance(value, list) and max(value) - min(value) > 1e-6 * max(1e-12, *map(abs, value)):
                where, photograph = scene.folder / "scene.yaml", scene.given(PHOTOGRAPH).name
                yield f"{where}: {key}.{name}: {show(value)} is coloured, but {photograph} is grey"


def given_results(scene):
    """Paths of results that lie in the folder, and of truth."""
    there = sorted([*scene.folder.glob("*"), *scene.folder.glob("truth/*")])
    return [path for path in there if path.name in (*LABELS, *RESULTS) and path.is_file()]


def _given_results(scene, found):
    """Whether they can be read at all, and have the photograph's size."""
    from lib.given import image
    from lib.given.view import size_problem

    camera = found.get("left.posed.cameramodel")
    for path in given_results(scene):
        try:
            if path.name in LABELS:
                labels = image.read_labels(path)
                if camera and (line := size_problem(path, labels, camera, scene.given("left.posed.cameramodel"))):
                    yield line
            elif path.suffix == ".json":
                artefact.read_json(path)
            else:
                artefact.read_npz(path)
        except BadInput as bad:
            yield from bad.problems


def _pose_problems(scene):
    """Several files or keys that tell the pose of `left`, and a lens beside numbers that tell another."""
    posed = scene.given("left.posed.cameramodel")
    picked = [path.name for path in map(scene.given, PICKED) if path]
    ways = [*([posed.name] if posed else []), *(["camera of scene.yaml"] if scene.camera else [])]
    ways += [" with ".join(picked)] if picked else []
    ways += [path.name for path in map(scene.given, FSPY) if path]
    if len(ways) > 1:
        yield f"{scene.folder}: {' and '.join(ways)}: only one of them may tell the pose of left"
    lens = scene.given("left.cameramodel")
    if scene.camera and lens and lens_of(lens) not in (None, PINHOLE):
        yield f"{lens}: lensmodel: {lens_of(lens)}: camera of scene.yaml is a pinhole: one of them is to go"


def _object_problems(scene):
    """Names in objects/ that will not do."""
    if (scene.folder / "objects").is_file():
        yield f"{scene.folder / 'objects'}: is a file, not a folder"
    for path in unread_objects(scene.given(OBJECTS)):
        yield f"{path}: is not read: objects/ takes .obj and .glb: export it so"
    names = {}
    for path in object_files(scene.given(OBJECTS)):
        if not NAME.fullmatch(path.stem):
            yield f"{path}: {path.stem}: is not a name of letters, digits, _ and -"
        elif path.stem in names:
            yield f"{scene.folder / 'objects'}: {names[path.stem]} and {path.name}: only one of them may be given"
        elif path.stem in scene.movable:
            yield f"{scene.folder / 'scene.yaml'}: movable: {show(path.stem)} is {path} too: one of them is to go"
        names.setdefault(path.stem, path.name)


def _photo_problems(scene):
    """Names in photos/ that will not do, pictures that are not read, and cameras of no photograph."""
    folder = scene.folder / "photos"
    if folder.is_file():
        yield f"{folder}: is a file, not a folder"
    if not scene.given(PHOTOS):
        return
    names = {}
    for one in further(folder):
        if not NAME.fullmatch(one.name):
            yield f"{one.picture}: {one.name}: is not a name of letters, digits, _ and -"
        elif one.name in names:
            yield f"{folder}: {names[one.name]} and {one.picture.name}: only one of them may be given"
        names.setdefault(one.name, one.picture.name)
    for path in sorted(folder.iterdir()):
        if path.suffix == ".cameramodel" and path.name.split(".")[0] not in names:
            yield f"{path}: is the camera of no photograph in {folder}"
        elif path.suffix not in PICTURES and path.suffix.lower() in (*PICTURES, *UNREAD):
            yield f"{path}: is no photograph that can be read: it must end in {', '.join(PICTURES)}"
    for name, said in scene.photos.items():
        for lamp in said.get("lamps", {}):
            if lamp not in scene.lamps:
                known = f"there are {', '.join(sorted(scene.lamps))}" if scene.lamps else "there are none"
                where = f"{scene.folder / 'scene.yaml'}: photos.{name}.lamps.{lamp}"
                yield f"{where}: {show(said['lamps'][lamp])} names no lamp of scene.yaml: {known}"


def _unusable_photos(scene):
    """Photographs and cameras in photos/ that cannot be read, or do not belong together."""
    from lib.given import image, lenses
    from lib.given.view import size_problem

    for one in further(scene.given(PHOTOS)):
        try:
            picture = image.read_photograph(one.picture)
            for path in filter(None, (one.posed, one.lens)):
                if problem := size_problem(one.picture, picture.values, lenses.read(path), path):
                    yield problem
        except BadInput as bad:
            yield from bad.problems


def _object_names(scene, objects):
    """Movable objects that the model has not, and files in objects/ that bear the name of one that it has."""
    model = scene.given(MODEL).name
    for name in scene.movable:
        if name not in objects:
            where = scene.folder / "scene.yaml"
            yield f"{where}: movable: {show(name)} names no object of {model}, which has {', '.join(sorted(objects))}"
    for path in object_files(scene.given(OBJECTS)):
        if path.stem in objects:
            yield f"{path}: {path.stem}: is an object of {model} too: name it under movable, or rename the file"


def _unknown_groups(scene, groups):
    """Groups that scene.yaml names and the model has not."""
    for key in ("lamps", "reference", "surfaces"):
        for name, value in getattr(scene, key).items():
            if name not in groups:
                yield (
                    f"{scene.folder / 'scene.yaml'}: {key}.{name}: {show(value)} names no group of "
                    f"{scene.given(MODEL).name}{near_misses.alike(name, groups)}, which has {', '.join(sorted(groups))}"
                )
