"""The page's section about the reflectance ladder: every rung with what it found; nothing that nobody measured."""

import numpy as np
import pytest

from lib.given.kinds import ORDER
from lib.picture.albedo_maps import AlbedoMap
from lib.verdict.page import build, ladder, summary
from tests.helpers.html import sane
from tests.helpers.page_parts import climbed, everything, parts_of, texture

TITLE = "How each surface reflects"


def ladder_of(files):
    """The section alone, as a tree; None where there is none."""
    page = sane(build.page(parts_of(files)))
    return page.section(TITLE) if TITLE in page.titles else None


def test_where_nothing_climbs_it_cost_nothing():
    section = ladder_of(everything())
    assert (
        "The threshold is 1.25 % of full scale beyond noise. Every group is diffuse within the threshold;"
        " no mirror buffer, no lobe and no texture was computed (0 rays)." in section.one("p", "lead").text
    )
    assert [item.text for item in section.one("ul", "stay").all("li")] == ["card 1.00 %", "wall 0.40 %"]
    assert section.all("u")[0].attributes["style"] == "width:80%"  # of the threshold
    assert not section.all("article") and "What that cost" not in section.text
    assert "not diffuse" not in summary.verdict(parts_of(everything())).sentence


def test_every_rung_is_shown_with_what_it_found():
    section = ladder_of(climbed())
    for words in (
        "5 of 11 groups climbed. Once that is in the balance, shelf is diffuse within the threshold.",
        "glass perfect mirror",
        "brass coloured mirror in truth mirror",
        "tin glossy",
        "steel glossy, anisotropic",
        "print textured",
        "14.0 % → 0.30 %",
        "1 all light, as the word says",
        "R0.9000 ± 0.0020 truth 0.9100 5.0 σ",
        "0.3000 ± 0.0020",
        "x0.2800 ± 0.0100 truth 0.2800 1.0 σ",
        "y0.0700 ± 0.0040 truth 0.0700 +0.0100",
        "(0.80, 0.60, 0.00) ± 1.15° truth (0.80, 0.60, 0.00) 1.2° off",
        "Off by 13.9 % beyond noise as diffuse; ρₛ = 0.9, 0.8, 0.5 is not 1.",
        "facet 7, 0.6 × 0.2 m, 50 % of it told by the photograph",
        "The albedo is off the truth by 2.1 % rms, over the 1,253 pixels that show it.",
        "shelf 2.0 % → 0.30 %",
        "Seen only by way of a mirror, and taken for diffuse: books.",
    ):
        assert words in section.text, (words, section.text)
    assert len(section.all("article")) == len(section.all("rect", "reached")) == 5
    assert [span.text for span in section.one("div", "climbs").all("span", "off")] == ["5.0 σ"]
    assert (
        "not diffuse: 1 mirror, 1 coloured mirror, 2 glossy, 1 textured;"
        in summary.verdict(parts_of(climbed())).sentence
    )


def test_what_was_spent_is_listed_the_largest_first():
    assert [row[:2] for row in ladder_of(climbed()).one("table").rows()] == [
        ["rays in lobes", "3,210,600"],
        ["camera rays to mirrors", "40,782"],
        ["mirrored lamps", "1"],
    ]


def test_a_texture_is_what_no_mirror_and_no_lobe_explains():
    steps = [rect.attributes["class"] for rect in ladder_of(climbed()).all("article")[-1].all("rect")]
    assert steps == ["tried"] * (len(ORDER) - 1) + ["reached"]
    files = climbed()
    files["materials"]["groups"]["print"]["ladder"] = {"rung": "textured", "why": "given in scene.yaml", "tried": []}
    steps = [rect.attributes["class"] for rect in ladder_of(files).all("article")[-1].all("rect")]
    assert steps == ["tried"] + ["passed"] * (len(ORDER) - 2) + ["reached"]


@pytest.mark.parametrize(
    "told, words",
    [
        ({"surfaces": {"wall": "diffuse"}}, "named diffuse in scene.yaml"),
        ({"reference": {"wall": [0.7, 0.6, 0.5]}}, "given as a reference"),
    ],
)
def test_what_scene_yaml_says_is_not_called_a_finding(told, words):
    files = everything()
    files["reports"]["fit"]["arguments"] |= told
    files["reports"]["fit"]["ladder"]["diffuse"]["wall"] = 0.05
    section = ladder_of(files)
    assert section.one("ul", "stay").all("li")[0].text == f"wall 5.0 % {words}" and section.one("i", "over")
    lead = section.one("p", "lead").text
    assert "No group climbed; no mirror buffer, no lobe and no texture was computed (0 rays)." in lead


def test_what_no_rung_explains_is_said_with_its_price():
    files = everything()
    errors = {"wall": 0.015, "card": 0.001}
    rays = {"rays in lobes": 77}
    files["reports"]["fit"]["ladder"] |= {"diffuse": errors, "end": errors, "rays": rays, "rungs": {}}
    section = ladder_of(files)
    lead = section.one("p", "lead").text
    assert "No group climbed: no mirror, lobe or texture explains what wall lacks." in lead and "0 rays" not in lead
    assert section.one("table").text == "rays in lobes 77"


def test_a_mirror_without_the_report_of_the_fit():
    """materials.json may be given: what it says is shown, what nobody measured is not."""
    files = climbed()
    del files["reports"]
    section = ladder_of(files)
    assert "5 of 11 groups climbed." in section.text
    assert not any(words in section.text for words in ("threshold", "0 rays", "What that cost"))
    files = everything()
    del files["reports"]["fit"]["ladder"]  # method: paper
    assert ladder_of(files) is None


def test_a_mirror_is_not_taken_for_a_reference():
    """Both have a rho_d of which nothing is uncertain."""
    rows = sane(build.page(parts_of(climbed()))).section("Materials").one("table").rows()
    words = {row[1].split()[0]: row[1] for row in rows}
    assert words["brass"] == "brass coloured mirror, identified"
    assert [name for name, text in words.items() if "given as a reference" in text] == ["card"]


def test_a_thumbnail_stands_as_the_facet_is_seen_from_its_front():
    thumbnail = ladder.thumbnail(texture(nu=120, nv=40), largest=60)
    picture = thumbnail.picture.astype(int)
    assert picture.shape == (20, 60, 3) and thumbnail.size_m == pytest.approx((0.6, 0.2))
    assert thumbnail.known == pytest.approx(0.5)
    red, green = picture[..., 0], picture[..., 1]
    assert (np.diff(red, axis=1) >= 0).all() and red[0, -1] > 250 and red[0, 0] < 30  # axis 0 to the right
    assert (np.diff(green, axis=0) <= 0).all() and green[0, 0] > 240 and green[-1, 0] < 50  # axis 1 upwards


def test_a_thumbnail_of_one_channel_and_no_size():
    ones = np.ones((1, 1), np.float32)
    dot = AlbedoMap(0, np.full((1, 1, 1), 0.5, np.float32), ones, ones, ones, np.full(1, 0.5), np.zeros((3, 3)), 0)
    assert ladder.thumbnail(dot).picture.shape[2] == 3


def test_large_albums_show_the_largest():
    files = climbed()
    large = {f: ladder.thumbnail(texture(f))._replace(size_m=(f, 1.0)) for f in range(1, 10)}
    files["thumbnails"] = {"print": large}
    album = ladder_of(files).all("article")[-1]
    shown = [caption.text.partition(",")[0] for caption in album.all("figcaption")]
    assert shown == [f"facet {f}" for f in (9, 8, 7, 6, 5, 4)] and "3 smaller ones are not shown." in album.text
