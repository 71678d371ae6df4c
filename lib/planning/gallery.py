"""build/index.html: all scenes that were run, each with badge, error, time, a picture, and the way to its page.

Only the standard library: this runs at the end of every `make`.
"""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import NamedTuple

from lib.core import artefact

INDEX, HEAD = "index.html", 8000  # the file; its first characters, which tell whose it is
PICTURES = ("rendered.png", "check.png")
KINDS = {"converged": "good", "unique": "good", "does not fit": "bad", "nothing seen": "bad"}  # of a badge, else warn
STYLE = """
:root { color-scheme: light dark; --paper: #fbfbf9; --ink: #1d1f21; --muted: #5f6368; --line: #e3e3de;
  --good: #1f7a4a; --good-bg: #e4f3ea; --warn: #8a5a00; --warn-bg: #fbf0d9; --bad: #b3261e; --bad-bg: #fbe6e4 }
@media (prefers-color-scheme:dark) { :root { --paper: #15171a; --ink: #e8e9ea; --muted: #9aa0a6; --line: #30343a;
  --good: #6fcf97; --good-bg: #173324; --warn: #e6b455; --warn-bg: #392c10; --bad: #f28b82; --bad-bg: #40201d } }
body { margin: 0 auto; max-width: 1120px; padding: 32px 16px; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui,sans-serif }
ul { list-style: none; margin: 0; padding: 0; display: grid; gap: 24px;
  grid-template-columns: repeat(auto-fill,minmax(240px,1fr)) }
a { color: inherit; font-weight: 600; overflow-wrap: anywhere }
img, .none { display: block; width: 100%; aspect-ratio: 4/3; object-fit: cover; border-radius: 8px;
  background: var(--line); margin-bottom: 8px }
.badge { border-radius: 999px; font-size: 13px; font-weight: 600; padding: 2px 10px }
.good { color: var(--good); background: var(--good-bg) }
.warn { color: var(--warn); background: var(--warn-bg) }
.bad { color: var(--bad); background: var(--bad-bg) }
p { margin: 4px 0 0; color: var(--muted); font-size: 14px }
"""


class Card(NamedTuple):
    """What the gallery shows of a scene. page, picture : as index.html names them, or None"""

    name: str
    status: str
    words: str
    page: str
    picture: str | None


def is_ours(path) -> bool:
    """Is an index.html one that `write` wrote?"""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            head = file.read(HEAD)
    except OSError:
        return False
    return re.search(r"<title>\d+ scenes</title>", head) is not None and "<h1>Scenes</h1>" in head


def write(build):
    """index.html of a folder of outputs: of every scene that has a page. One that is not ours stays."""
    cards = [card for folder in sorted(Path(build).iterdir()) if (card := _card(folder))]
    path = Path(build) / INDEX
    if cards and (is_ours(path) or not path.exists()):
        with artefact.writing(path) as partial:
            Path(partial).write_text(page(cards), encoding="utf-8")


def page(cards) -> str:
    """cards : [Card]"""
    items = "\n".join(map(_item, cards))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{len(cards)} scenes</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        f"<h1>Scenes</h1>\n<ul>\n{items}\n</ul>\n</main>\n</body>\n</html>\n"
    )


def _item(card):
    name, e = html.escape(card.name), html.escape
    picture = (
        f'<img src="{e(card.picture)}" alt="{name}" loading="lazy">' if card.picture else '<div class="none"></div>'
    )
    badge = f'<span class="badge {KINDS.get(card.status, "warn")}">{e(card.status)}</span>'
    return f'<li>{picture}<a href="{e(card.page)}">{name}</a> {badge}<p>{e(card.words)}</p></li>'


def _card(folder) -> Card | None:
    if not (folder / "report.html").is_file():
        return None
    status = _read(folder / "materials.json").get("status") or _read(folder / "pose.json").get("status") or "complete"
    reports = [_read(path) for path in folder.glob("*.report.json")]
    words = []
    rmse = _read(folder / "rendered.json").get("rmse")
    if isinstance(rmse, float):
        words.append(f"{100 * rmse:.2f} % off the photograph")
    if warnings := sum(len(r.get("warnings") or []) for r in reports):
        words.append(f"{warnings} warning{'s' * (warnings != 1)}")
    words.append(f"{sum(r.get('waited_s') or 0 for r in reports):.0f} s")
    picture = next((f"{folder.name}/{p}" for p in PICTURES if (folder / p).is_file()), None)
    return Card(folder.name, str(status), ", ".join(words), f"{folder.name}/report.html", picture)


def _read(path):
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return found if isinstance(found, dict) else {}
    except (OSError, ValueError):
        return {}
