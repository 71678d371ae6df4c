"""The documents: no link leads nowhere, no picture is left over, and README names the commands that there are."""

import re

import pytest

from tests.bench import reader_table

LINK = re.compile(r"\]\(([^)\s]+)\)")
HEAD = re.compile(r"^#+ +(.*)$", re.MULTILINE)


def documents(root):
    return sorted([*root.glob("*.md"), *root.glob("docs/*.md"), *root.glob("data/*.md"), *root.glob(".github/**/*.md")])


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


def test_every_picture_is_shown(root):
    shown = " ".join(path.read_text(encoding="utf-8") for path in documents(root))
    assert not [p.name for p in root.glob("docs/*") if p.suffix in (".png", ".jpg") and p.name not in shown]


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
