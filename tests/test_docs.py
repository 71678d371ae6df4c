"""The documents: no link leads nowhere, no picture is left over, and README names the commands that there are."""

import re

import pytest

from lib.core.stage import BadInput
from lib.planning import scene as scenes
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import walk
from tests.bench import figures, reader_table
from tests.helpers.attic import attic

LINK = re.compile(r"\]\(([^)\s]+)\)")
HEAD = re.compile(r"^#+ +(.*)$", re.MULTILINE)


# What code and documents cite without a link: a file, a heading of a document, a module that is run
FILE = re.compile(r"(?<![\w/.-])((?:docs|lib|stages|tests)/[\w./-]*\.(?:md|py|json|png|jpg|csv|html))\b")
HEADING = re.compile(r"(?<![\w/.-])((?:docs|data)/[\w./-]*\.md), ([A-Z][^`.,;:()\n\"]*)")
RUN = re.compile(r"python -m (tests(?:\.\w+)+)")
PAGE = re.compile(r"# (?P<question>.*)\n\n\*\*(?P<answer>.*)\*\*\n")  # the first lines of docs/decisions/*.md


def documents(root):
    folders = ("*.md", "docs/*.md", "docs/decisions/*.md", "data/*.md", ".github/**/*.md")
    return sorted(path for folder in folders for path in root.glob(folder))


def sources(root):
    """Code and documents that say where something stands. CHANGELOG.md tells of files that went."""
    code = [path for folder in ("lib", "stages", "tests") for path in root.glob(f"{folder}/**/*.py")]
    read = [path for path in documents(root) if path.name != "CHANGELOG.md"]
    return [*code, *read, *root.glob("pipeline.yaml"), *root.glob("Makefile")]


def anchors(path):
    """As GitHub makes them of headings."""
    words = (re.sub(r"[^\w\- ]", "", head.strip().lower()) for head in HEAD.findall(path.read_text(encoding="utf-8")))
    return {word.replace(" ", "-") for word in words}


def dead(path):
    """Links of a document that lead nowhere in the repository."""
    for link in LINK.findall(path.read_text(encoding="utf-8")):
        file, _, anchor = link.partition("#")
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        there = (path.parent / file).resolve() if file else path
        if not there.exists() or anchor and there.suffix == ".md" and anchor not in anchors(there):
            yield link


def test_no_link_is_dead(root):
    found = {str(path.relative_to(root)): list(dead(path)) for path in documents(root)}
    assert not {path: links for path, links in found.items() if links}


def test_a_dead_link_is_found(tmp_path):
    (tmp_path / "b.md").write_text("# Two words\n")
    (tmp_path / "a.md").write_text("[x](b.md#two-words) [y](b.md#three) [z](c.png) [w](https://example.org)")
    assert list(dead(tmp_path / "a.md")) == ["b.md#three", "c.png"]


def lost(root, path):
    """Citations of a source that lead nowhere: files, headings, modules."""
    text = path.read_text(encoding="utf-8")
    for file in FILE.findall(text):  # code also names files of examples and of tests
        if (path.suffix == ".md" or file.startswith("docs/")) and not (root / file).exists():
            yield file
    for file, heading in HEADING.findall(re.sub(r"\n[#\s]*", " ", text)):
        if not (root / file).exists():
            continue
        heads = {head.strip().lower() for head in HEAD.findall((root / file).read_text(encoding="utf-8"))}
        if not any(heading.lower().startswith(head) or head.startswith(heading.strip().lower()) for head in heads):
            yield f"{file}, {heading}"
    for module in RUN.findall(text):
        place = root.joinpath(*module.split("."))
        if not (place.with_suffix(".py").exists() or (place / "__main__.py").exists()):
            yield module


def test_no_citation_is_dead(root):
    found = {str(path.relative_to(root)): list(lost(root, path)) for path in sources(root)}
    assert not {path: cited for path, cited in found.items() if cited}


def test_a_dead_citation_is_found(tmp_path):
    here, gone = ("/".join(("docs", name)) for name in ("here.md", "gone.md"))  # in pieces: this file is asked, too
    module = ".".join(("tests", "gone"))
    (tmp_path / "docs").mkdir()
    (tmp_path / here).write_text("# A heading\n")
    (tmp_path / "a.py").write_text(f"{here}, A heading. {gone} ({here}, No heading). python -m {module} 3\n")
    assert list(lost(tmp_path, tmp_path / "a.py")) == [gone, f"{here}, No heading", module]


def test_the_index_of_decisions_is_of_its_pages(root):
    """Each page begins with its question and its answer, which stand in the index; none is longer than a page."""
    index = (root / "docs/decisions/README.md").read_text(encoding="utf-8")
    for path in sorted(root.glob("docs/decisions/*.md")):
        if path.name != "README.md":
            text = path.read_text(encoding="utf-8")
            page = PAGE.match(text)
            assert page, f"{path.name} does not begin with # question, **answer**"
            assert f"| [{page['question']}]({path.name}) | {page['answer']} |" in index, path.name
            assert len(text.split()) <= 450, f"{path.name} has {len(text.split())} words"


def test_every_picture_is_shown(root):
    shown = " ".join(path.read_text(encoding="utf-8") for path in documents(root))
    assert not [p.name for p in root.glob("docs/*") if p.suffix in (".png", ".jpg") and p.name not in shown]


def test_every_picture_is_made_by_a_command(root):
    """`python -m tests.bench.figures` knows it, and docs/decisions/figures.md says what it is made of."""
    pictures = {p.name for p in root.glob("docs/*") if p.suffix in (".png", ".jpg")}
    assert {figure.file for figure in figures.FIGURES.values()} == pictures
    page = (root / "docs/decisions/figures.md").read_text(encoding="utf-8")
    assert not [name for name in pictures if name not in page]


@pytest.mark.parametrize("name", ["README.md", "docs/tutorial.md", "CONTRIBUTING.md"])
def test_targets_that_are_named_are_there(root, name):
    """`make x` of a document is a target of the Makefile, or a scene or a stage of one."""
    makefile = (root / "Makefile").read_text()
    targets = set(re.search(r"^TARGETS := (.*)$", makefile, re.MULTILINE).group(1).split())
    named = set(re.findall(r"(?:`| {4})make ([a-z-]+)(?=[`\s])", (root / name).read_text(encoding="utf-8")))
    scenes = {p.parent.name for p in root.glob("data/*/scene.yaml")} | {"attic", "study", "x"}
    assert not named - targets - scenes


def test_the_page_of_readers_is_what_the_readers_say(root):
    """`python -m tests.bench.reader_table > docs/readers.md` makes it."""
    assert (root / "docs/readers.md").read_text(encoding="utf-8") == reader_table.page()


def test_the_tutorial_can_be_walked(root, tmp_path, run):
    """Its files are shipped, its picks are those that it prints, and its first command takes them."""
    text = (root / "docs/tutorial.md").read_text(encoding="utf-8")
    named = set(re.findall(r"(?<![\w/.-])((?:data|docs)/[\w/-]+\.\w+)", text)) - {"data/study/scene.yaml"}
    assert named and not [file for file in named if not (root / file).exists()]
    picks = (root / "docs/tutorial/points.csv").read_text(encoding="utf-8")
    assert "".join(f"    {line}\n" for line in picks.splitlines()) in text
    command = re.search(r"\$ make new-scene NAME=study (.*)", text)[1]
    told = [f"--{key.lower()}={root / file}" for key, file in re.findall(r"([A-Z]+)=(\S+)", command)]
    done = run("stages/new_scene.py", f"--data={tmp_path}", "--name=study", *told)
    assert done.returncode == 0 and "picks: 8, 8 of them corners of the model" in done.stdout, done.stderr


# What stands in the list "Not built yet" of data/SCENE.md: {its word there: (how README would promise it, scene.yaml or
# a file that asks for it, what the refusal says)}; None: nothing that a user can ask for
NOT_BUILT = {
    "RAW": (r"\bRAW\b(?! file a 16-bit TIFF)", {"left.dng": b"II*"}, "RAW is not read yet"),
    "brackets/": (r"\bbrackets?\b|exposure series", None, None),
    "colorchecker": (r"colou?r ?checker", "colorchecker: auto", 'colorchecker: "auto" is not built yet'),
    "sky": (r"`sky`|daylight is", "sky: unknown", 'sky: "unknown" is not built yet'),
    "materials": (r"one material in several", "materials: {wall: attic}", "is not built yet"),
    "glass": (r"\bglass\b", "surfaces: {wall: glass}", 'surfaces.wall: "glass" is not built yet'),
    "gradient": (r"\bgradient", "lamps: {lamp: {emittance: unknown, gradient: unknown}}", "lamps.lamp.gradient"),
    "lobe": (r"\bIES\b", "lamps: {lamp: {emittance: unknown, lobe: {ies: a.ies}}}", "lamps.lamp.lobe.ies"),
    "fog": (r"\bfogs?\b", "explain: [fog]", 'explain: "fog" is not built yet'),
    "sweep": (r"/sweep\b", None, None),
    "figures": (r"make \w+/figures", None, None),
    "many": (r"make many", None, None),
    "map_Kd": (r"map_Kd", None, None),
    "baseColorTexture": (r"baseColorTexture", None, None),
    **dict.fromkeys(("surfaces", "model_error")),
    **dict.fromkeys(("materials.json", "explain", "explained", "noise", "photos/", "photos.json", "photos", "lamps")),
}


def not_built(root):
    """The words of the list: RAW, and what stands between backquotes."""
    text = re.search(
        r"> \*\*Not built yet\*\*.*?\n\n", (root / "data/SCENE.md").read_text(encoding="utf-8"), re.DOTALL
    )[0]
    return {*re.findall("`([^`]+)`", text), *re.findall(r"\bRAW\b", text)}


def test_the_list_of_what_is_not_built_is_known_here(root):
    """An entry of the list has a line above, and the other way round: what is built leaves both."""
    assert not_built(root) - {"scene.yaml"} == NOT_BUILT.keys()


@pytest.mark.parametrize("word", [word for word, said in NOT_BUILT.items() if said])
def test_nothing_that_is_not_built_is_promised(root, word):
    """README promised lamps with IES profiles, which are refused."""
    pattern = NOT_BUILT[word][0]
    for name in ("README.md", "docs/tutorial.md"):
        said = (root / name).read_text(encoding="utf-8")
        found = re.search(f".*(?:{pattern}).*", said)
        assert not found, f"{name}: {found[0]}"


@pytest.mark.parametrize("word", [word for word, said in NOT_BUILT.items() if said and said[1]])
def test_what_is_not_built_is_refused(root, tmp_path, word):
    """In a line of file, field and value, before anything runs."""
    _, asked, said = NOT_BUILT[word]
    folder = attic(tmp_path)
    if isinstance(asked, dict):
        for path in folder.glob("left.*"):
            path.unlink()
        for name, content in asked.items():
            (folder / name).write_bytes(content)
        asked = ""
    (folder / "scene.yaml").write_text(("" if asked.startswith("lamps") else "lamps: {lamp: unknown}\n") + asked + "\n")
    stages = read_pipeline(root / "pipeline.yaml")
    with pytest.raises(BadInput) as bad:
        walk(scenes.read(folder, stages), stages, tmp_path / "build", (None,))
    assert any(said in line for line in bad.value.problems), bad.value.problems
