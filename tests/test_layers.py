"""The architecture of lib/: who may import whom, where compiled functions live, how long a module may be.

`lib/` is a list of packages in the paper's order. Everything here is read from the sources; nothing is imported.
"""

import ast
import functools
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]

# A package imports itself and those before it.
PACKAGES = (
    "core",  # what every stage shares, none of it about pictures
    "given",  # what a scene's folder holds: images, models, cameras, materials
    "planning",  # scene.yaml, pipeline.yaml, the plan for Make
    "buffers",  # what each pixel shows
    "vision",  # from photographs to facets and pose
    "light",  # how light spreads
    "picture",  # from light to a picture
    "export",  # the recovered scene for other programs
    "analysis",  # from a picture to materials
    "verdict",  # errors and the page
    "synthetic",  # scenes with a known answer
)

# Packages with rooms: a room imports itself and those before it.
ROOMS = {
    "analysis": (
        "seen",  # what tiles of the photograph show and receive
        "fit",  # the inverse problem, its solution, sigma and evidence
        "causes",  # what may be wrong with the picture as a whole
        "materials",  # the ladder
        "answer",  # what is said in the end
    )
}

# Imported inside functions only, so that a stage pays for what it uses.
HEAVY = {
    "open3d": "1 s, and only what casts rays needs it",
    "cv2": "0.1 s",
    "scipy": "its parts take 0.05 to 0.3 s each",
    "matplotlib": "0.4 s, only for plots",
    "colour": "1 s, only where a spectrum or a colour difference is asked for",
    "PIL": "0.1 s, only what reads photographs needs it",
    "OpenEXR": "only where a picture of light is read or written",
    "moderngl": "missing where there is no OpenGL: rays are cast then",
    "pycolmap": "only where a pose is estimated from the pair alone",
    "trimesh": "0.6 s",
    "pygltflib": "0.1 s, only for an export",
    "mapbox_earcut": "only for polygons that are not quadrilaterals",
    "jinja2": "only for the page",
    "markupsafe": "Jinja2's",
    "mitsuba": "in an environment of its own",
    "drjit": "Mitsuba's",
    "tifffile": "0.1 s, only for TIFFs that OpenCV does not decode",
    "pxr": "USD's, installed by who needs it",
}
# Other imports inside functions that stay, and why.
LATE = {
    ("lib.core.artefact", "numpy"): "planning writes JSON and does without NumPy, 0.1 s of every `make`",
    ("lib.analysis.answer.own_materials", "lib.analysis.materials.ascent"): "0.1 s of every fit; few scenes climb",
    ("lib.analysis.answer.inversion", "lib.analysis.materials.ascent"): "the same",
    ("lib.analysis.answer.inversion", "lib.analysis.answer.refine"): "0.06 s: only where the light leaves a doubt",
    ("lib.analysis.answer.told_first", "lib.analysis.answer.refine"): "the same",
    ("lib.analysis.answer.told_first", "lib.analysis.answer.strangers"): "with them",
    ("lib.analysis.answer.disagreements", "lib.analysis.answer.strangers"): "the same",
    ("lib.analysis.answer.answers", "lib.analysis.answer.strangers"): "the same",
    ("lib.planning.augment", "lib.given.image"): "NumPy, and only where scene.yaml asks for changed pictures",
    ("lib.planning.augment", "lib.given.lenses"): "the same",
    ("lib.planning.augment", "lib.given.model"): "the same",
    ("lib.planning.augment", "lib.given.motion"): "the same",
    ("lib.planning.folder", "lib.given.materials"): "NumPy, as the lines below",
    ("lib.planning.doctor", "numpy"): "the doctor must run where nothing is installed",
    ("lib.planning.files", "lib.given.lenses"): "NumPy again: only for a pair of given cameras",
    ("lib.planning.files", "lib.given.image"): "NumPy again: only for photographs that are no PNG",
    ("lib.planning.folder", "lib.given.image"): "NumPy again: given files are opened only when they are new",
    ("lib.planning.folder", "lib.given.lenses"): "the same",
    ("lib.planning.folder", "lib.given.model"): "the same",
    ("lib.planning.folder", "lib.given.picks"): "the same",
    ("lib.planning.folder", "lib.given.picks_frame"): "the same",
    ("lib.planning.folder", "lib.given.sight"): "the same",
    ("lib.planning.folder", "lib.given.view"): "the same",
}
LONGEST = 500  # lines of a module
LONG = {}


class Import(NamedTuple):
    """One imported name."""

    importer: str  # module
    module: str  # the module that is imported, or whose name is
    name: str | None  # what is taken from it; None: the module itself
    alias: str  # what it is called in the importer
    line: int
    late: bool  # inside a function


def dotted(path):
    """
    >>> dotted(ROOT / "lib/given/model/__init__.py"), dotted(ROOT / "stages/fit.py")
    ('lib.given.model', 'stages.fit')
    """
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@functools.cache
def sources():
    """{dotted name: path} of lib/ and stages/."""
    return {dotted(path): path for folder in ("lib", "stages") for path in sorted((ROOT / folder).rglob("*.py"))}


@functools.cache
def tree(module):
    return ast.parse(sources()[module].read_text(encoding="utf-8"))


def lib_modules():
    return [module for module in sources() if module.startswith("lib.")]


@functools.cache
def imports(module):
    """All imports of a module, those inside functions too."""
    found = []

    def visit(node, late):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                for alias in child.names:
                    found.append(
                        Import(module, alias.name, None, alias.asname or alias.name.split(".")[0], child.lineno, late)
                    )
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{module}: imports in lib/ are absolute"
                for alias in child.names:
                    whole = f"{child.module}.{alias.name}"
                    of = (whole, None) if whole in sources() else (child.module, alias.name)
                    found.append(Import(module, *of, alias.asname or alias.name, child.lineno, late))
            visit(child, late or isinstance(child, ast.FunctionDef | ast.Lambda))

    visit(tree(module), late=False)
    return found


def package(module):
    """
    >>> package("lib.given.model.obj")
    'given'
    """
    return module.split(".")[1]


def complaints(lines):
    """A test's failure: all lines, not the first."""
    if lines := list(lines):
        pytest.fail("\n".join(lines), pytrace=False)


def test_every_package_is_in_the_list():
    folders = {path.name for path in (ROOT / "lib").iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders == set(PACKAGES)
    assert all((ROOT / "lib" / name / "__init__.py").read_text().startswith('"""') for name in PACKAGES)


def test_a_package_imports_itself_and_those_before_it():
    for module in lib_modules():
        complaints(
            f"{module}:{i.line} imports {i.module}, which comes later"
            for i in imports(module)
            if i.module.startswith("lib.") and PACKAGES.index(package(i.module)) > PACKAGES.index(package(module))
        )


def room(module):
    """
    >>> room("lib.analysis.fit.problem"), room("lib.analysis")
    ('fit', None)
    """
    return (module.split(".") + [None])[2]


def test_every_room_is_in_the_list():
    for name, rooms in ROOMS.items():
        files = {path.relative_to(ROOT / "lib" / name).parts[0] for path in (ROOT / "lib" / name).rglob("*.py")}
        assert files == {*rooms, "__init__.py"}
        assert all((ROOT / "lib" / name / r / "__init__.py").read_text().startswith('"""') for r in rooms)


def test_a_room_imports_itself_and_those_before_it():
    for module in lib_modules():
        rooms = ROOMS.get(package(module))
        own = rooms and room(module)
        complaints(
            f"{module}:{i.line} imports {i.module}, which comes later"
            for i in (imports(module) if own else ())
            if i.module.startswith(f"lib.{package(module)}.") and rooms.index(room(i.module)) > rooms.index(own)
        )


def test_contributing_lists_packages_and_rooms():
    """It had ten packages of eleven for a week."""
    listed = {line.strip() for line in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines()}
    complaints(
        f"CONTRIBUTING.md lacks the line: {'  '.join(names)}"
        for names in (PACKAGES, *ROOMS.values())
        if "  ".join(names) not in listed
    )


def test_lib_knows_neither_stages_nor_tests():
    for module in lib_modules():
        complaints(
            f"{module}:{i.line} imports {i.module}"
            for i in imports(module)
            if i.module.split(".")[0] in ("stages", "tests")
        )


def test_there_are_no_circles():
    graph = {m: {i.module for i in imports(m) if i.module in sources()} - {m} for m in lib_modules()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("a circle: " + " -> ".join(reversed(error.args[1])), pytrace=False)


def test_no_module_takes_anothers_private_name():
    """Neither `from lib.x import _y` nor `x._y`."""
    private = lambda name: name.startswith("_") and not name.startswith("__")
    for module in sources():
        taken = [i for i in imports(module) if i.module.startswith("lib.")]
        lines = [f"{module}:{i.line} takes {i.module}.{i.name}" for i in taken if i.name and private(i.name)]
        modules = {i.alias: i.module for i in taken if i.name is None}
        attributes = (node for node in ast.walk(tree(module)) if isinstance(node, ast.Attribute))
        for node in (node for node in attributes if isinstance(node.value, ast.Name) and private(node.attr)):
            if of := modules.get(node.value.id):
                lines.append(f"{module}:{node.lineno} takes {of}.{node.attr}")
        complaints(lines)


def test_compiled_functions_live_in_kernels_modules():
    """An edit of the story around them compiles nothing, and a kernel's cache knows all that it is made of."""
    is_kernels = lambda module: module.endswith("_kernels")
    for module in sources():
        for i in imports(module):
            where = f"{module}:{i.line}"
            if i.module.split(".")[0] == "numba" and module != "lib.core.compiled":
                complaints([f"{where} imports numba: only lib.core.compiled does"])
            if i.module == "lib.core.compiled" and not is_kernels(module):
                complaints([f"{where} imports lib.core.compiled: only *_kernels modules do"])
            sees = is_kernels(i.module) or i.module == "lib.core.compiled" or not i.module.startswith("lib.")
            if is_kernels(module) and not sees:
                complaints([f"{where} imports {i.module}, which is no kernels module"])
            if is_kernels(module) and i.late:
                complaints([f"{where} imports inside a function: the cache would not see it"])


def test_imports_inside_functions_are_of_heavy_packages():
    late = [i for module in lib_modules() for i in imports(module) if i.late]
    complaints(
        f"{i.importer}:{i.line} imports {i.module} inside a function"
        for i in late
        if i.module.split(".")[0] not in HEAVY and (i.importer, i.module) not in LATE
    )
    found = {(i.importer, i.module) for i in late}
    complaints(f"LATE names {exception}, which is not there" for exception in LATE if exception not in found)


def test_no_heavy_package_is_imported_at_the_top():
    complaints(
        f"{module}:{i.line} imports {i.module} at its top"
        for module in lib_modules()
        for i in imports(module)
        if not i.late and i.module.split(".")[0] in HEAVY
    )


def test_no_module_is_too_long():
    length = {module: len(path.read_text().splitlines()) for module, path in sources().items()}
    complaints(
        f"{module} has {lines} lines" for module, lines in length.items() if lines > LONGEST and module not in LONG
    )
    complaints(f"LONG names {module}, which is not too long" for module in LONG if length.get(module, 0) <= LONGEST)


# ---- do the checks find what they look for? ----

LISTS = "\n\n".join("    " + "  ".join(names) for names in (PACKAGES, *ROOMS.values()))
SOUND = {f"lib/{name}/__init__.py": '"""A package."""' for name in PACKAGES} | {
    "CONTRIBUTING.md": LISTS,
    "lib/core/compiled.py": "import numba\n",
    "lib/given/a.py": "import numpy\nfrom lib.core import compiled_by\n",
    "lib/core/compiled_by.py": "def f():\n    import cv2\n",
    "lib/light/b_kernels.py": "import numpy as np\nfrom lib.core.compiled import njit\n",
    **{f"lib/{name}/{room}/__init__.py": '"""A room."""' for name, rooms in ROOMS.items() for room in rooms},
    "lib/analysis/fit/x.py": "from lib.analysis.seen.x import y\n",
    "lib/analysis/seen/x.py": "y = 1\n",
    "lib/light/b.py": "from lib.light import b_kernels\nfrom lib.given import a\na.public\n",
}
CHECKS = {
    test_every_package_is_in_the_list: {"lib/other/__init__.py": '"""Not in the list."""'},
    test_a_package_imports_itself_and_those_before_it: {"lib/core/x.py": "def f():\n    from lib.given import a\n"},
    test_every_room_is_in_the_list: {"lib/analysis/x.py": '"""A module that stands in no room."""'},
    test_a_room_imports_itself_and_those_before_it: {"lib/analysis/seen/z.py": "from lib.analysis.fit import x\n"},
    test_contributing_lists_packages_and_rooms: {"CONTRIBUTING.md": LISTS.replace("  export", "")},
    test_lib_knows_neither_stages_nor_tests: {"lib/core/x.py": "import tests.helpers\n"},
    test_there_are_no_circles: {"lib/core/x.py": "from lib.core import y\n", "lib/core/y.py": "import lib.core.x\n"},
    test_no_module_takes_anothers_private_name: {"stages/x.py": "from lib.given import a as b\nb._c()\n"},
    test_compiled_functions_live_in_kernels_modules: {"lib/light/x_kernels.py": "from lib.given.a import C\n"},
    test_no_heavy_package_is_imported_at_the_top: {"lib/core/x.py": "import scipy.sparse\n"},
    test_no_module_is_too_long: {"lib/core/x.py": "a = 1\n" * (LONGEST + 1)},
    test_imports_inside_functions_are_of_heavy_packages: {"lib/core/x.py": "def f():\n    import json\n"},
}


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_a_check_finds_what_it_looks_for(check, tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    monkeypatch.setitem(globals(), "LATE", {})
    monkeypatch.setitem(globals(), "LONG", {})

    def written(files):
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
        for cached in (sources, tree, imports):
            cached.cache_clear()

    try:
        written(SOUND)
        check()
        written(CHECKS[check])
        with pytest.raises((pytest.fail.Exception, AssertionError)):
            check()
    finally:
        for cached in (sources, tree, imports):
            cached.cache_clear()
