"""`make verify`: its laws hold, place by place; and a broken one is said, with exit status 1."""

import pytest

from tests.verify import __main__ as verify
from tests.verify import page, walks
from tests.verify.walks import Found, Walk, at_most, near, refused

EVERY = walks.every()
SECONDS = ("photometry", "told otherwise", "facets")
MINUTES = (
    "1e6 m away",
    "in mm",
    "polygons in another order",
)  # whole makes: test_told_otherwise.py asks both of small rooms


DEAR = {"the baseline towards 0": 0.05}  # 20 s at each place: `make test` asks this one


def marks(walk, place):
    slow = place in MINUTES or DEAR.get(walk.name, place) != place
    return [pytest.mark.slow] * slow + [pytest.mark.scene] * (walk.part in SECONDS)


PLACES = [
    pytest.param(w, place, id=f"{w.part}: {w.name}: {place}", marks=marks(w, place))
    for w in EVERY
    for place in w.places(whole=False)
]


@pytest.mark.parametrize("walk, place", PLACES)
def test_the_law_holds(walk, place):
    found = walk.point(place).found
    assert found.holds, found


def test_every_walk_has_a_name_of_its_own_and_places():
    assert len({(w.part, w.name) for w in EVERY}) == len(EVERY)
    assert all(w.at and w.law and len(w.short) <= 3 for w in EVERY)
    assert all(bool(w.axis) == isinstance(w.at[0], float | int) for w in EVERY)


def test_what_is_not_a_number_is_broken():
    assert near([1.0, 2.0], [1.0, 2.5], 0.4) == Found(2.0, 2.5, 0.5, 0.4, None, "")
    assert not near(float("nan"), 1.0, 1e9).holds and not near(float("inf"), 1.0, 1e9).holds
    assert near(1.1, 1.0, 0.2, relative=True).holds and at_most(0.0, 0.0).holds

    def work():
        raise ValueError("no balance exists: patch 1")

    assert refused(work, "no balance").holds and not refused(work, "other words").holds
    assert not refused(lambda: None, "no balance").holds


def test_a_broken_law_is_said(tmp_path, monkeypatch, capsys):
    def error(_):
        raise KeyError("it")

    broken = [
        Walk("a part", "right", "law", "x", (1.0, 10.0, 100.0), (0, 1, 2), lambda x: near(x, 2 * x, 1e3)),
        Walk("a part", "wrong", "law", "", ("<here>",), (0,), lambda _: near(1.0, 2.0, 0.5)),
        Walk("a part", "an error", "law", "", ("there",), (0,), error),
    ]
    monkeypatch.setattr(walks, "every", lambda: broken)
    opt = verify.options().parse_args(["--page", str(tmp_path / "v/report.html")])
    assert verify.main(opt) == 1
    said = capsys.readouterr().out
    assert "BROKEN wrong, <here>" in said and "KeyError" in said and "3 of 5 hold" in said
    text = (tmp_path / "v/report.html").read_text()
    assert "&lt;here&gt;" in text and "<svg" in text and "3 of 5 hold" in text
    monkeypatch.setattr(walks, "every", lambda: broken[:1])
    assert verify.main(opt) == 0
    assert verify.main(verify.options().parse_args(["nothing", "--page", str(tmp_path / "x.html")])) == 2


def test_a_page_of_nothing(tmp_path):
    page.write(tmp_path / "report.html", [], 0.0)
    assert "All 0 hold" in (tmp_path / "report.html").read_text()
