"""What the scene's folder holds, checked before any stage runs."""

from lib.core.stage import BadInput
from lib.planning.files import MODEL, SIDES, alternatives, model_groups, photograph_of
from lib.planning.rules import show


def folder_problems(scene):
    """Files that stand in each other's way: two photographs, two models, a folder where a file should be."""
    for file in (*map(photograph_of, SIDES), MODEL):
        there = [p.name for p in scene.candidates(file)]
        if len(there) > 1:
            yield f"{scene.folder}: {' and '.join(there)}: only one of them may be given"
        for name in alternatives(file):
            if (scene.folder / name).is_dir():
                yield f"{scene.folder / name}: is a folder, not a file"
    groups = model_groups(scene.given(MODEL)) if scene.given(MODEL) else None
    if groups:
        yield from _unknown_groups(scene, groups)


def inspect(scene, files) -> list[str]:
    """Open in earnest what lies in the folder, so that bad input is refused before any stage has written anything.

    files : names as in pipeline.yaml, of which the model, photographs and cameras are opened.
    Returns problems, one line each.
    """
    from lib.given import image, lenses, materials  # NumPy: a plan whose files were found good does without
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
    for file, reader in readers.items():
        if file in files and (path := scene.given(file)):
            try:
                found[file] = reader(path)
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
    return problems


def _unknown_groups(scene, groups):
    """Groups that scene.yaml names and the model has not."""
    for key in ("lamps", "reference", "surfaces"):
        for name, value in getattr(scene, key).items():
            if name not in groups:
                yield (
                    f"{scene.folder / 'scene.yaml'}: {key}.{name}: {show(value)} names no group of "
                    f"{scene.given(MODEL).name}, which has {', '.join(sorted(groups))}"
                )
