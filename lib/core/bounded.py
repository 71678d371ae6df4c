"""Files as others wrote them: sizes, depths and numbers are bounded before anything is made of them.

    data = bounded.content(path)               # bytes;  text(path): UTF-8
    value = bounded.json_of(path, data)        # plain, finite, not too deep
    value = bounded.literal_of(path, data)     # what Python would write as a literal: a file of mrcal's

Each raises BadInput in one line.  Only the standard library is imported.
"""

import ast
import json
import os
import re
import stat
import warnings
from pathlib import PurePosixPath

from lib.core.stage import BadInput

LARGEST_FILE = 2 << 30  # bytes, of any file
LARGEST_TEXT = 32 << 20  # bytes, of a file that becomes Python's objects: they take up to 20 times as much
DEEPEST = 100  # lists and tables in each other
LONGEST_NUMBER = 300  # digits; more do not fit into a float
MOST_WORDS = 50_000  # of a literal; a splined lens has 5,000
UNPACKED_MB, UNPACKED_TIMES = 256, 20  # what a file may unpack to: so much, or so many times its own size
WIDEST_PX, MOST_PX = 65_535, 100_000_000  # of a picture: its longer side, its pixels
FEW_PX, EMPTIEST = 12_000_000, 1 / 50  # a picture of more pixels than that has so many bytes for each in its file


def content(path, most=LARGEST_FILE) -> bytes:
    """The bytes of a file. Refused: no file, a folder or a device, more bytes than `most`."""
    try:
        with opened(path) as file:
            size = os.fstat(file.fileno()).st_size
            check_size(path, size, most)
            return file.read(size)
    except OSError as error:
        raise BadInput(f"{path}: {_why(error)}") from None


def opened(path):
    """A file, open for its bytes. BadInput: a folder, a device, a pipe, which would be waited for; OSError"""
    file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise BadInput(f"{path}: is no file")
    return file


def _without_waiting(path, flags):
    """A pipe is opened, and then refused: without this, opening waits for who writes into it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _why(error):
    return "there is no such file" if isinstance(error, FileNotFoundError) else f"cannot be read: {error.strerror}"


def check_size(path, size, most):
    """BadInput: a file of so many bytes is larger than a reader takes."""
    if size > most:
        raise BadInput(f"{path}: {size} bytes: at most {most} are read")


def text(path, most=LARGEST_TEXT) -> str:
    """The same as text in UTF-8, with or without a mark of the byte order."""
    return text_of(path, content(path, most))


def text_of(path, data) -> str:
    """Text in UTF-8."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        check_utf16(path, data)
        raise BadInput(f"{path}: not UTF-8: {error.reason} at byte {error.start}") from None


def check_utf16(path, data):
    """BadInput: text of two bytes a letter, as Excel and PowerShell write it."""
    if len(data) > 2 and data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput(f"{path}: not UTF-8 but UTF-16: save it as UTF-8")


def check_unpacked(path, what, packed, unpacked):
    """BadInput: what a file of `packed` bytes says that it unpacks to is more than it can mean."""
    if unpacked > max(UNPACKED_MB << 20, UNPACKED_TIMES * packed):
        raise BadInput(
            f"{path}: {what}: {packed} bytes that unpack to {unpacked}: more than {UNPACKED_MB} MB and more than "
            f"{UNPACKED_TIMES} times as much are not read"
        )


def check_picture(path, width, height, size):
    """BadInput: a picture of so many pixels in a file of `size` bytes (None: of any) is larger than any photograph."""
    if not (0 < width <= WIDEST_PX and 0 < height <= WIDEST_PX and width * height <= MOST_PX):
        raise BadInput(
            f"{path}: size: {width} x {height}: a picture has at most {WIDEST_PX} px a side, {MOST_PX:.0e} px"
        )
    if size is not None and width * height > FEW_PX and size < EMPTIEST * width * height:
        raise BadInput(f"{path}: size: {width} x {height} px in {size} bytes is no photograph")


def lies_outside(name) -> bool:
    """A path that is absolute, or that climbs out of its folder.

    >>> lies_outside("a/../../b"), lies_outside("/a"), lies_outside("a/../b")
    (True, True, False)
    """
    depth = 0
    for part in PurePosixPath(name).parts:
        depth += -1 if part == ".." else 1
        if depth < 0 or part == "/":
            return True
    return False


# ---- JSON ----


def json_of(path, data):
    """Any JSON value, of bytes. Refused: not UTF-8, not JSON, a NaN or an infinity, a name used twice, too deep."""
    check_size(path, len(data), LARGEST_TEXT)
    words = text_of(path, data)
    infinite = []

    def number(word):
        value = float(word)
        if value - value != 0:
            infinite.append(word)
        return value

    try:
        _check_depth(words)
        value = json.loads(
            words, parse_constant=_no_number, parse_float=number, parse_int=_whole, object_pairs_hook=_once
        )
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not readable JSON: {str(error) or 'nested too deep'}") from None
    if infinite:
        raise BadInput(f"{path}: {_where_infinite(value)}{infinite[0]:.80} is not a finite number")
    return value


def _where_infinite(value) -> str:
    """The first infinite number of a JSON value: its keys and numbers, as 'facets[0].covariance[2][2]: '."""
    where, todo = "", [("", value)]
    while todo:
        where, value = todo.pop()
        if isinstance(value, float) and value - value != 0:
            break
        if isinstance(value, dict):
            todo += reversed([(f"{where}.{key}".lstrip("."), item) for key, item in value.items()])
        elif isinstance(value, list):
            todo += reversed([(f"{where}[{k}]", item) for k, item in enumerate(value)])
    return f"{where}: " if where else ""


def _check_depth(words):
    if words.count("[") + words.count("{") <= DEEPEST:
        return
    depth = 0
    for found in re.finditer(r'"(?:[^"\\]|\\.)*"|([\[{])|([\]}])', words, re.S):
        if found.lastindex:
            depth += 1 if found.lastindex == 1 else -1
            if depth > DEEPEST:
                raise ValueError("nested too deep")


def _no_number(word):
    raise ValueError(f"{word} is not a number")


def _whole(word):
    if len(word) > LONGEST_NUMBER:
        raise ValueError(f"{word:.40}... has {len(word)} digits")
    return int(word)


def _once(pairs):
    value = {}
    for key, item in pairs:
        if key in value:
            raise ValueError(f"{key!r} stands there twice")
        value[key] = item
    return value


# ---- Python's literals ----

_WORD = re.compile(
    r"""[ \t\r\n\f]+ | \#[^\n]*
      | (?P<number> [-+]? (?:[0-9]+\.?[0-9]*|\.[0-9]+) (?:[eE][-+]?[0-9]+)? (?![\w.]) )
      | (?P<text> [bruBRU]{0,2} (?: '(?:[^'\\\n]|\\.)*' | "(?:[^"\\\n]|\\.)*" ) )
      | (?P<mark> [\[\](){}:,] )
      | (?P<name> [^\W\d]\w* )""",
    re.X | re.S,
)
_NAMES = {"True": True, "False": False, "None": None}
_CLOSING = {"[": "]", "(": ")", "{": "}"}


def literal_of(path, data):
    """A Python literal of bytes: tables, lists, tuples, texts, numbers, True, False and None, with comments.

    Our own reader, not ast.literal_eval, which takes 5 s for a sum of 200,000 ones and 1 GB for 16 MB of numbers.
    ValueError, with the line: what is none.
    """
    check_size(path, len(data), LARGEST_TEXT)
    return _Literal(data.decode("utf-8-sig", "replace")).whole()


class _Literal:
    """The words of a literal, one of which is ahead."""

    def __init__(self, words):
        self.words, self.at, self.count = words, 0, 0
        self.kind = self.word = None
        self.step()

    def refuse(self, why):
        raise ValueError(f"line {self.words.count(chr(10), 0, self.at) + 1}: {why}")

    def shown(self):
        """The word ahead, for messages."""
        return f"{'name ' if self.kind == 'name' else ''}{self.word:.40}" if self.kind else "the end"

    def step(self):
        """To the next word; its kind is None at the end."""
        while self.at < len(self.words):
            found = _WORD.match(self.words, self.at)
            if not found:
                self.refuse(f"{self.words[self.at : self.at + 20]!r} has no place in it")
            self.at = found.end()
            if found.lastgroup:
                self.kind, self.word = found.lastgroup, found[0]
                self.count += 1
                if self.count > MOST_WORDS:
                    self.refuse(f"it has more than {MOST_WORDS} words")
                return
        self.kind = self.word = None

    def whole(self):
        value = self.value(0)
        if self.kind:
            self.refuse(f"{self.word!r:.80} after its end")
        return value

    def value(self, depth):
        kind, word = self.kind, self.word
        if kind == "text":
            return self.joined_text()
        if kind == "mark" and word in _CLOSING and depth < DEEPEST:
            self.step()
            return self.pairs(depth) if word == "{" else self.items(word, depth)
        if kind == "number":
            value = self.number(word)
        elif kind == "name" and word in _NAMES:
            value = _NAMES[word]
        else:
            self.refuse(f"{self.shown()} where a number, a text or a list should be")
        self.step()
        return value

    def number(self, word):
        if len(word) > LONGEST_NUMBER:
            self.refuse(f"{word:.40}... has {len(word)} digits")
        return int(word) if word.lstrip("+-").isdigit() else float(word)

    def joined_text(self):
        """Texts that follow each other are one."""
        parts = []
        while self.kind == "text":
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # a backslash that means nothing
                    parts.append(ast.literal_eval(self.word))
            except (SyntaxError, ValueError):
                self.refuse(f"{self.word:.40} is no text")
            self.step()
        if len({type(part) for part in parts}) > 1:
            self.refuse("bytes and text side by side")
        return type(parts[0])().join(parts)

    def items(self, opening, depth):
        values, commas = [], 0
        while self.word != _CLOSING[opening]:
            values.append(self.value(depth + 1))
            commas += self.comma(_CLOSING[opening])
        self.step()
        if opening == "[":
            return values
        return values[0] if len(values) == 1 and not commas else tuple(values)

    def pairs(self, depth):
        table = {}
        while self.word != "}":
            if self.kind != "text":
                self.refuse(f"{self.shown()} where a name in quotes should be")
            key = self.value(depth + 1)
            if self.word != ":":
                self.refuse(f"{self.shown()} where a colon should be")
            self.step()
            table[key] = self.value(depth + 1)
            self.comma("}")
        self.step()
        return table

    def comma(self, closing):
        """Whether a comma follows; what else follows must close."""
        if self.word == ",":
            self.step()
            return True
        if self.word != closing:
            self.refuse(f"{self.shown()} where a comma or {closing} should be")
        return False
