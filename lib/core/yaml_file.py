"""YAML read strictly: plain types, no key twice, one line for each problem."""

import re

import yaml

from lib.core import bounded
from lib.core.bounded import DEEPEST
from lib.core.stage import BadInput

MOST_VALUES = 20_000  # of a document, those behind aliases counted each time
LARGEST = 1 << 20  # bytes of a file
FARTHEST = 1e15  # the largest number
PLAIN = "tag:yaml.org,2002:"


class _Loader(yaml.SafeLoader):
    """Safe YAML with plain types alone: no tags, no key twice, values and depth bounded.

    Plain scalars mean what YAML 1.2 says: `no` and `on` are words, 1e-3 is a number, 1:30 and 010 are not sixty-based
    or octal.  An alias stands for its value, and counts as often as it stands there.
    """

    allowed = frozenset()  # tags that may stand before a mapping or a list

    def __init__(self, text):
        super().__init__(text)
        self.depth, self.values, self.composed = 0, {}, 0

    def compose_node(self, parent, index):
        event = self.peek_event()
        if getattr(event, "tag", None) is not None and event.tag not in self.allowed:
            tag = event.tag.replace(PLAIN, "!!")
            self.refuse(f"{tag:.40}: tags are not read: write the value alone", event)
        self.composed += 1  # what is too long is not read to its end
        if self.composed > MOST_VALUES:
            self.refuse(f"more than {MOST_VALUES} values", event)
        self.depth += 1
        if self.depth > DEEPEST:
            self.refuse(f"lists and mappings lie more than {DEEPEST} deep in each other", event)
        node = super().compose_node(parent, index)
        self.depth -= 1
        if isinstance(event, yaml.AliasEvent):
            if id(node) not in self.values:
                self.refuse(f"*{event.anchor:.40} stands for a value that holds it", event)
        else:
            self.values[id(node)] = 1 + sum(self.values[id(child)] for child in _children(node))
        if self.values[id(node)] > MOST_VALUES:
            self.refuse(f"more than {MOST_VALUES} values", event)
        return node

    @staticmethod
    def refuse(why, event):
        raise yaml.constructor.ConstructorError(None, None, why, event.start_mark)


def _children(node):
    if isinstance(node, yaml.MappingNode):
        return [child for pair in node.value for child in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


def _construct_mapping(loader, node):
    value = {}
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        try:
            twice = key in value
        except TypeError:
            raise yaml.constructor.ConstructorError(None, None, "a key must be a word", key_node.start_mark) from None
        if twice:
            raise yaml.constructor.ConstructorError(
                None, None, f"{key}: the key stands there twice", key_node.start_mark
            )
        value[key] = loader.construct_object(value_node, deep=True)
    return value


def _construct_number(loader, node):
    word = loader.construct_scalar(node)
    value = float(word.lower().replace(".inf", "inf").replace(".nan", "nan"))
    if abs(value) == float("inf"):
        return value  # whoever wants a number refuses it, and knows what it is for
    if abs(value) > FARTHEST:
        loader.refuse(f"{word:.40}{'...' * (len(word) > 40)} is larger than {FARTHEST:g}", node)
    return int(word) if node.tag == f"{PLAIN}int" else value


_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    ("int", r"^[-+]?[0-9]+$", list("-+0123456789")),
    (
        "float",
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        list("-+0123456789."),
    ),
):
    _Loader.add_implicit_resolver(f"{PLAIN}{_tag}", re.compile(_pattern), _first)
_Loader.add_constructor(f"{PLAIN}int", _construct_number)
_Loader.add_constructor(f"{PLAIN}float", _construct_number)
_Loader.add_constructor(f"{PLAIN}map", _construct_mapping)


def _hint(text, mark):
    """What is wrong, where it is one of two common slips near the mark."""
    lines = text.split("\n")
    for number in range(max(0, mark.line - 1), min(mark.line + 1, len(lines) - 1) + 1):
        if re.match(r" *\t", lines[number]):
            return f"line {number + 1}: a tab: indent with blanks"
        if re.match(r"\s*[\w-]+:[^\s]", lines[number]):
            return f"line {number + 1}: a blank is missing after the colon"
    return None


def read_yaml(path):
    """The one document in path.  BadInput in one line: not there, not UTF-8, not YAML, a key twice, tags, too much."""
    return _load(path, bounded.text(path, LARGEST), _Loader)


class _OpenCV(_Loader):
    """What OpenCV's FileStorage writes: its matrices bear a tag."""

    allowed = frozenset({f"{PLAIN}opencv-matrix", f"{PLAIN}opencv-nd-matrix"})


for _tag in _OpenCV.allowed:
    _OpenCV.add_constructor(_tag, _construct_mapping)


def read_opencv(path, text, names) -> dict:
    """Of what OpenCV's FileStorage wrote as YAML, or ROS, the values of these names; a matrix is a mapping with `data`.

    names : patterns, without regard to case. The others may be long, points of many boards for example, and are passed
    over. Of several documents, messages of a topic for example, the first is read.
    """
    wanted = re.compile(rf"[\"']?({'|'.join(names)})[\"']? *:", re.I)
    found = _load(path, "".join(filter(wanted.match, _blocks(text))), _OpenCV)
    return found if isinstance(found, dict) else {}


def names_of(text) -> list[str]:
    """The names at the left margin of the first document.

    >>> names_of("%YAML:1.0\\n---\\nM1: !!opencv-matrix\\n   rows: 3\\nD1: [0]\\n---\\nx: 1\\n")
    ['M1', 'D1']
    """
    found = [re.match(r"[\"']?([\w.]+)[\"']? *:(?!\S)", block) for block in _blocks(text)]
    return [name[1] for name in found if name]


def _blocks(text):
    """The first document's lines from one name at the left margin to the next."""
    text = text.replace("\r\n", "\n")
    first = re.search(r"^[\w\"']", text, re.M)
    if not first:
        return []
    end = re.compile(r"^---[ \t]*$", re.M).search(text, first.start())
    document = text[first.start() : end.start() if end else len(text)]
    return re.split(r"^(?=[\w\"'])", document, flags=re.M)


def _load(path, text, loader):
    try:
        return yaml.load(text, loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if hint := mark and _hint(text, mark):
            raise BadInput(f"{path}: {hint}") from None
        raise BadInput(
            f"{path}: line {mark.line + 1}: {error.problem}" if mark else f"{path}: {error.problem}"
        ) from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise BadInput(f"{path}: not readable YAML: {str(error) or 'nested too deep'}") from None
