"""What all sections share: numbers as people read them, and the templates."""

from __future__ import annotations

import functools
import math
import os
from pathlib import Path

FOLDER = Path(__file__).resolve().parent


# ---- numbers ----


def finite(value):
    """A number, and neither a boolean nor infinite."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def number(value, digits=3):
    """Significant digits, no exponent where people would not expect one; a dash where there is no number.

    >>> number(0.0123456), number(12345.6), number(2.0), number(0), number(None), number(float("nan")), number(1.2e-7)
    ('0.0123', '12,346', '2', '0', '–', '–', '1.2·10⁻⁷')
    """
    if not finite(value):
        return "–"
    if value == 0:
        return "0"
    if isinstance(value, int) or abs(value) >= 10 ** (digits + 1):
        return f"{value:,.0f}" if abs(value) < 1e15 else _power(value, digits)
    if abs(value) < 1e-4:
        return _power(value, digits)
    text = f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _power(value, digits):
    exponent = math.floor(math.log10(abs(value)))
    mantissa = f"{value / 10.0**exponent:.{digits - 1}f}".rstrip("0").rstrip(".")
    raised = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"10{raised}" if mantissa == "1" else f"{mantissa}·10{raised}"


def fixed(value, decimals, sign=False):
    """
    >>> fixed(0.71234, 3), fixed(-0.0204, 1, sign=True), fixed(None, 2)
    ('0.712', '−0.0', '–')
    """
    return f"{value:{'+' if sign else ''}.{decimals}f}".replace("-", "−") if finite(value) else "–"


def percent(value, decimals=None, sign=False):
    """
    >>> percent(0.00704), percent(0.25), percent(1.0), percent(-0.011, 1, True)
    ('0.70 %', '25 %', '100 %', '−1.1 %')
    """
    if not finite(value):
        return "–"
    p = 100 * value
    if decimals is None:
        decimals = 0 if abs(p) >= 20 else 1 if abs(p) >= 2 else 2
    return fixed(p, decimals, sign) + " %"


def at_least(value, decimals=4):
    """A number that is not 0, as `fixed` shows it, or the smallest one that is not shown as 0.

    >>> at_least(0.0123, 3), at_least(1e-6, 3)
    ('0.012', '<0.001')
    """
    smallest = 10**-decimals
    return fixed(value, decimals) if value >= 0.5 * smallest else "<" + fixed(smallest, decimals)


def pm(value, sigma, decimals=4):
    """
    >>> pm(2.004, 0.003, 3), pm(2.0, None, 2), pm(0.5, 1e-6, 3), pm(0.5, 0, 3)
    ('2.004 ± 0.003', '2.00', '0.500 ± <0.001', '0.500 ± 0.000')
    """
    if not finite(sigma) or not finite(value):
        return fixed(value, decimals)
    return f"{fixed(value, decimals)} ± {at_least(sigma, decimals) if sigma else fixed(sigma, decimals)}"


def coordinate(value):
    """A number in an SVG or in a style; 0 where it is not finite."""
    return f"{value:.2f}".rstrip("0").rstrip(".") if math.isfinite(value) else "0"


# ---- words ----


def plain(name):
    """An error's or a stage's name in words.

    >>> plain("image_rmse"), plain("reflectance.max_absolute")
    ('image rmse', 'reflectance: max absolute')
    """
    return str(name).replace(".", ": ").replace("_", " ")


def sentence(text):
    """With a capital letter; the rest as it is.

    >>> sentence("off by 0.4 dB")
    'Off by 0.4 dB'
    """
    return text[:1].upper() + text[1:]


def listed(names):
    """
    >>> listed(["a"]), listed(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def plural(count, noun):
    """
    >>> plural(1, "group"), plural(0, "group")
    ('group', 'groups')
    """
    return noun + "s" * (count != 1)


def css(rgb):
    """
    >>> css([255, 0, 128])
    '#ff0080'
    """
    return "#" + "".join(f"{int(c):02x}" for c in rgb)


def coded(text):
    """HTML of a line in which what is to be typed stands between backquotes.

    >>> str(coded("Run `make x`: <b>"))
    'Run <code>make x</code>: &lt;b&gt;'
    """
    import markupsafe

    pieces = [markupsafe.escape(piece) for piece in text.split("`")]
    wrapped = [markupsafe.Markup(f"<code>{piece}</code>") if k % 2 else piece for k, piece in enumerate(pieces)]
    return markupsafe.Markup("").join(wrapped)


# ---- templates ----


@functools.cache
def _environment():
    import jinja2

    # compiled templates are kept beside Python's own: 0.2 s for each page without it
    kept = FOLDER / "__pycache__"
    cache = jinja2.FileSystemBytecodeCache(str(kept)) if kept.is_dir() and os.access(kept, os.W_OK) else None
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER / "templates"),
        bytecode_cache=cache,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters = (number, fixed, percent, at_least, pm, coordinate, plain, sentence, listed, css, coded)
    environment.filters |= {function.__name__: function for function in filters}
    environment.globals |= {"finite": finite, "plural": plural}
    return environment


def render(template, **context):
    """The HTML of a template, as text that needs no more escaping; "" where it shows nothing."""
    import markupsafe

    return markupsafe.Markup(_environment().get_template(template).render(**context).strip())


def asset(name):
    """The text of page.css or page.js, to be written into the page as it is."""
    import markupsafe

    return markupsafe.Markup((FOLDER / name).read_text(encoding="utf-8"))
