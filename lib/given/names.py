"""Names that stay apart: two things of one name become "Paint" and "Paint.2", and a line says so."""

from __future__ import annotations

import re

MOST_SAID = 5


class Names:
    """A name for each thing: its own, and where that is taken, its own with .2, .3.

    >>> names = Names()
    >>> names("/hall/Paint", "Paint"), names("/bath/Paint", "Paint"), names("/hall/Paint", "Paint")
    ('Paint', 'Paint.2', 'Paint')
    >>> names.lines()
    ['/hall/Paint and /bath/Paint have one name: the second is group Paint.2']
    """

    def __init__(self):
        self.of, self.taken, self.said = {}, {}, []

    def __call__(self, key, name, where=None):
        """key : what tells the thing from all others;  where : words for it in the line, the key without"""
        if key not in self.of:
            name = written(name)
            free, count = name, 1
            while free in self.taken:
                count += 1
                free = f"{name}.{count}"
            where = str(where or key)
            if free != name:
                self.said.append(f"{self.taken[name]:.80} and {where:.80} have one name: the second is group {free}")
            self.of[key], self.taken[free] = free, where
        return self.of[key]

    def lines(self):
        more = len(self.said) - MOST_SAID
        return self.said[:MOST_SAID] + ([f"and {more} more of one name"] if more > 0 else [])


def written(name):
    r"""A name that a line of an OBJ can hold.

    >>> written("my wall\n"), written("C:\\wall"), written("")
    ('my_wall', 'C:_wall', '_')
    """
    return re.sub(r"[\s\\\x00-\x1f]+", "_", name.strip()) or "_"
