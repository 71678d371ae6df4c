"""Records of JSON files: every wrong value is a line of its own, what is read is written as it was."""

import json
from dataclasses import dataclass

import pytest

from lib.core import record
from lib.core.record import flag, list_of, list_with, matrix, number, numbers, part, table_of, table_with, told, word
from lib.core.stage import BadInput


@dataclass(frozen=True)
class Lamp:
    emittance: tuple | None = told(numbers(3, 0))
    note: str | None = told(word("new", "old"), absent=True)


@dataclass(frozen=True)
class Room:
    name: str | None = told(word(), needed="a name")
    lamps: dict = table_of(Lamp)
    spare: list = list_of(Lamp)
    best: Lamp = part(Lamp)
    other: Lamp | None = part(Lamp, absent=True)
    size_m: float | None = told(number(0, 100))
    lit: bool | None = told(flag)
    pose: tuple | None = told(matrix(2, 3))
    words: list = told(list_with(word(), "words"), list)
    sizes: dict = told(table_with(number(), "numbers"), dict)


WHOLE = {
    "name": "attic",
    "lamps": {"bulb": {"emittance": [1.0, 2.0, 3.0]}},
    "spare": [{"emittance": None, "note": "new"}],
    "best": {"emittance": [0.0, 0.0, 0.5]},
    "other": {"emittance": None},
    "size_m": 2.5,
    "lit": True,
    "pose": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    "words": ["a"],
    "sizes": {"a": 1},
}


def test_what_is_read_is_written_as_it_was(tmp_path):
    path = tmp_path / "room.json"
    path.write_text(json.dumps(WHOLE))
    room = record.read(path, Room)
    assert room.lamps["bulb"].emittance == (1.0, 2.0, 3.0) and room.spare[0].note == "new" and room.pose[1][1] == 1
    assert record.plain(room) == WHOLE


def test_what_is_missing_is_none_or_empty():
    room = record.of({"name": "attic", "more": "is ignored"}, "room.json", Room)
    assert room == Room(name="attic") and room.best == Lamp() and room.other is None and room.lamps == {}
    assert record.plain(room)["best"] == {"emittance": None} and "other" not in record.plain(room)


@pytest.mark.parametrize(
    "change, line",
    [
        ({"name": None}, "name: missing, or not a name"),
        ({"name": 3}, "name: missing, or not a name"),
        ({"size_m": "large"}, "size_m = 'large' is neither null nor a number"),
        ({"size_m": True}, "size_m = True is neither null nor a number"),
        ({"size_m": 101}, "size_m = 101 is outside [0, 100]"),
        ({"lit": 1}, "lit = 1 is neither true nor false"),
        ({"lamps": [1]}, "lamps = [1] is neither null nor a table"),
        ({"lamps": {"bulb": 3}}, "lamps.bulb = 3 is not a table"),
        ({"lamps": {"bulb": {"emittance": [1, 2]}}}, "lamps.bulb.emittance = [1, 2] is neither null nor three numbers"),
        ({"lamps": {"bulb": {"emittance": [1, 2, -1]}}}, "lamps.bulb.emittance = [1, 2, -1] is negative"),
        ({"spare": [{}, {"note": "lost"}]}, "spare.1.note = 'lost' is none of new, old"),
        ({"best": 3}, "best = 3 is neither null nor a table"),
        ({"pose": [[1, 2], [3, 4]]}, "pose = [[1, 2], [3, 4]] is neither null nor 2 x 3 numbers"),
        ({"pose": [[1, 2, None], [3, 4, 5]]}, "pose = [[1, 2, None], [3, 4, 5]] is neither null nor 2 x 3 numbers"),
        ({"words": ["a", 3]}, "words = ['a', 3] is not a list of words"),
        ({"sizes": {"a": "b"}}, "sizes = {'a': 'b'} is not a table of numbers"),
    ],
)
def test_a_value_that_breaks_its_rule_is_one_line(change, line):
    with pytest.raises(BadInput) as refused:
        record.of(WHOLE | change, "room.json", Room)
    assert len(refused.value.problems) == 1 and refused.value.problems[0].startswith(f"room.json: {line}")


def test_every_wrong_value_is_named():
    with pytest.raises(BadInput) as refused:
        record.of({"name": "attic", "size_m": -1, "lit": "yes"}, "room.json", Room)
    assert len(refused.value.problems) == 2


@pytest.mark.parametrize("content", [[], 3, None, "room"])
def test_a_file_that_holds_no_table_is_refused(content):
    with pytest.raises(BadInput, match="room.json: "):
        record.of(content, "room.json", Room)
