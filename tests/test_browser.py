"""The page in Chromium without a window: axe finds nothing, the console is silent, the slider, 400 px and dark work.

axe-core is asked for where `.ci/run` has put it (npm), build/axe/package/axe.min.js; without, what needs it is skipped.
"""

import pytest

from lib.planning import gallery
from lib.verdict.page import build
from tests.helpers.browser import Browser, chromium
from tests.helpers.page_parts import climbed, everything, parts_of

AXE = "build/axe/package/axe.min.js"
VIEWS = [(1280, "light"), (1280, "dark"), (400, "light"), (400, "dark")]
pytestmark = [
    pytest.mark.outside,
    pytest.mark.skipif(chromium() is None, reason="no Chromium: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """{name: file} of pages by hand: all there is, the ladder, one that does not fit, the gallery."""
    folder, refused = tmp_path_factory.mktemp("pages"), everything()
    refused["materials"]["status"] = "does not fit"
    made = {"everything": everything(), "climbed": climbed(), "refused": refused}
    files = {name: folder / f"{name}.html" for name in made}
    for name, content in made.items():
        content["reports"]["index"]["notes"] = ["2 polygons without area were dropped"]
        parts = parts_of(content)
        parts.steps = ["Look at `build/attic/check.png` (`make attic/check` draws it): is it right?", "Then go on."]
        files[name].write_text(build.page(parts), encoding="utf-8")
    cards = [
        gallery.Card(s, s, "0.51 % off the photograph", "a.html", None) for s in ("converged", "does not fit", "x")
    ]
    files["gallery"] = folder / "index.html"
    files["gallery"].write_text(gallery.page(cards), encoding="utf-8")
    return files


PAGES = ["everything", "climbed", "refused", "gallery"]


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("width, scheme", VIEWS)
def test_no_complaint_and_nothing_cut_off(browser, pages, name, width, scheme):
    tab = browser.open(pages[name], width, scheme)
    assert tab.js("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0

    ground = sum(map(int, tab.js("getComputedStyle(document.body).backgroundColor")[4:-1].split(",")))
    assert (ground < 384) == (scheme == "dark")
    assert tab.complaints == []


@pytest.mark.parametrize("width", [1280, 400])
def test_the_first_screen_says_what_now_and_shows_the_picture_before_links(browser, pages, width):
    """On a phone the picture came below links and warnings."""
    tab = browser.open(pages["everything"], width)
    top = lambda place: tab.js(f"document.querySelector('{place}').getBoundingClientRect().top")
    assert top("h1") < top(".hero img, .pair") < min(top("nav"), top("#warnings"), 860)
    assert top(".next") < 860 and (top(".next") > top(".pair")) == (width == 400)


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("width, scheme", VIEWS)
def test_axe_finds_nothing(browser, pages, root, name, width, scheme):
    if not (root / AXE).is_file():
        pytest.skip(f"no axe-core at {AXE}: .ci/run fetches it")
    tab = browser.open(pages[name], width, scheme)
    tab.js((root / AXE).read_text(encoding="utf-8"))
    tab.js("for (const d of document.querySelectorAll('details')) d.open = true")
    found = tab.js(
        "axe.run({resultTypes: ['violations']}).then(r => r.violations.map(v => "
        "[v.id, v.nodes.map(n => n.target.join(' ') + ': ' + n.failureSummary)]))"
    )
    assert found == []


def test_axe_finds_what_is_wrong(browser, tmp_path, root):
    if not (root / AXE).is_file():
        pytest.skip(f"no axe-core at {AXE}: .ci/run fetches it")
    path = tmp_path / "bad.html"
    path.write_text(
        '<html lang="en"><title>x</title><img src="data:,"><p style="color:#999">pale</p><script>a.b</script>'
    )
    tab = browser.open(path)
    tab.js((root / AXE).read_text(encoding="utf-8"))
    found = tab.js("axe.run({resultTypes: ['violations']}).then(r => r.violations.map(v => v.id))")
    assert {"image-alt", "color-contrast"} <= {*found} and tab.complaints


def test_the_slider_moves_by_keys(browser, pages):
    tab = browser.open(pages["everything"])
    at = lambda: float(tab.js("document.querySelector('.pair').style.getPropertyValue('--at').slice(0, -1)"))
    tab.js("document.querySelector('.pair input').focus()")
    before = at()
    tab.key("ArrowRight")
    assert at() == before + 2
    tab.key("PageDown")
    assert at() == before - 18
