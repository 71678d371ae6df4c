"""The gallery of changed pictures: what the entries of `augment` made, before and after."""

from __future__ import annotations

from lib.verdict.page.html import render
from lib.verdict.page.parts import Parts
from lib.verdict.page.pictures import photo_uri


def changed_section(parts: Parts, width):
    """A slider for each change of the photograph, a picture for each other camera; "" where nothing was asked."""
    if not parts.changed:
        return ""
    photo, cards = parts.photograph, []
    for one in parts.changed:
        after, over = None, False
        if one.picture is not None:
            after = photo_uri(one.picture, width)
            over = photo is not None and one.picture.shape[:2] == photo.shape[:2] and not _from_elsewhere(parts, one)
        cards.append({"name": one.name, "address": one.address, "after": after, "over": over})
    before = photo_uri(photo, width) if any(card["over"] for card in cards) else None
    return render("changed.html", cards=cards, before=before, shape=None if photo is None else photo.shape[:2])


def _from_elsewhere(parts, one):
    """Whether the entry has a camera of its own."""
    report = parts.reports.get(f"augment.{one.name}")
    entry = report.arguments.get("entry") if report else None
    return isinstance(entry, dict) and "camera" in entry
