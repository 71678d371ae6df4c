"""Numbers as they are said, alike on the terminal, the page and in files. Only the standard library."""


def about(share) -> str:
    """How well something is known.

    >>> about(0.0412), about(0.003), about(0.125)
    ('to about 4 %', 'to about .3 %', 'to about 12 %')
    """
    percent = 100 * share
    said = f"{percent:.0f}" if percent >= 9.5 else f"{percent:.1g}"
    return f"to about {said.removeprefix('0') or '0'} %"
