"""A page as a tree, and what must hold of every page."""

import re
from html.parser import HTMLParser

VOID = {"meta", "img", "input", "br", "line", "circle", "polyline", "polygon", "rect", "link", "hr", "path"}
INLINE = {"b", "i", "em", "sub", "text"}
NUMBERS = ("points", "x", "y", "x1", "x2", "y1", "y2", "cx", "cy", "r", "d", "viewbox", "width", "height")
ADDRESSES = ("src", "srcset", "href", "data", "poster", "action", "xlink:href")
LIMIT_BYTES = 6_000_000


class Element:
    """tag, attributes {name: text}, children: elements and text."""

    def __init__(self, tag, attributes=()):
        self.tag, self.attributes, self.children = tag, {k: v or "" for k, v in attributes}, []

    @property
    def elements(self):
        """Its children that are no text."""
        return [child for child in self.children if isinstance(child, Element)]

    def all(self, tag=None, kind=None, **attributes):
        """Every element under this one of a tag, of a CSS class, with these attributes; in the page's order."""
        found = []
        for child in self.elements:
            fits = tag in (None, child.tag) and kind in (None, *child.attributes.get("class", "").split())
            if fits and attributes.items() <= child.attributes.items():
                found.append(child)
            found += child.all(tag, kind, **attributes)
        return found

    def one(self, tag=None, kind=None, **attributes):
        """The only such element."""
        (found,) = self.all(tag, kind, **attributes)
        return found

    @property
    def text(self):
        """What is seen, every run of white space one blank; blocks stand apart."""
        return " ".join(self._shown().split())

    def _shown(self):
        if self.tag in ("script", "style"):
            return ""
        inside = "".join(child if isinstance(child, str) else child._shown() for child in self.children)
        return inside if self.tag in INLINE else f" {inside} "

    def rows(self):
        """Of a table: [[text of each cell]], without the head."""
        rows = [row for part in self.elements if part.tag != "thead" for row in part.all("tr")]
        return [[cell.text for cell in row.elements] for row in rows]

    def heads(self):
        """Of a table: the text of each head."""
        return [cell.text for cell in self.one("thead").all("th")]


class _Reader(HTMLParser):
    """Tags must nest."""

    def __init__(self, text):
        super().__init__()
        self.root = Element("page")
        self.open = [self.root]
        self.feed(text)
        self.close()
        assert self.open == [self.root], [element.tag for element in self.open]

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(self.open[-1].children[-1])

    def handle_startendtag(self, tag, attrs):
        self.open[-1].children.append(Element(tag, attrs))

    def handle_endtag(self, tag):
        assert self.open.pop().tag == tag, (tag, [element.tag for element in self.open[-3:]], self.getpos())

    def handle_data(self, data):
        self.open[-1].children.append(data)


class Page(Element):
    """A page that was parsed."""

    def __init__(self, text):
        super().__init__("page")
        self.children = _Reader(text).root.children

    @property
    def titles(self):
        """Of its sections, in order."""
        return [title.text for title in self.all("h2")]

    def section(self, title):
        """The one with a title."""
        (found,) = [section for section in self.all("section") if section.one("h2").text == title]
        return found


def sane(text) -> Page:
    """What must hold of every page; the page as a tree."""
    page = Page(text)
    for element in page.all():
        for name, value in element.attributes.items():
            own = element.tag == "a" and value.startswith(("exports/", "augmented."))  # beside it
            own = own or (element.tag == "a" and name == "href" and value[:1] == "#" and page.all(id=value[1:]))
            assert name not in ADDRESSES or own or value.startswith("data:"), (element.tag, name, value[:80])
            assert not name.startswith("on"), (element.tag, name)
            if name in NUMBERS:
                assert not re.search(r"nan|inf", value, re.IGNORECASE), (element.tag, name, value)
    assert all(image.attributes.get("alt") for image in page.all("img")), "a picture without words"
    assert all(head.text for head in page.all("th")), "a head of a table without words"
    assert not page.all("link") + page.all("object") + page.all("embed") + page.all("base")
    for frame in page.all("iframe"):  # a page within the page
        assert frame.attributes["srcdoc"] and frame.attributes["sandbox"] == "allow-scripts", frame.attributes.keys()
    style, script = ("".join(page.one(tag).children) for tag in ("style", "script"))
    assert "url(" not in style and "@import" not in style
    assert not re.search(r"fetch|XMLHttpRequest|import\(", script)
    bad = re.search(r".{0,30}\b(nan|NaN|inf|Infinity|None|null|True|False)\b", page.text)
    assert not bad, bad
    assert len(text.encode()) < LIMIT_BYTES
    return page
