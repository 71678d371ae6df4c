"""YAML read strictly: plain types, no key twice, one line for each problem."""

import re
from pathlib import Path

import yaml

from lib.core.stage import BadInput


class _Loader(yaml.SafeLoader):
    """Safe YAML, except that a key given twice is an error and plain scalars mean what YAML 1.2 says:
    `no` and `on` are words, 1e-3 is a number, 1:30 and 010 are not sixty-based or octal."""


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
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), _first)
_Loader.add_constructor("tag:yaml.org,2002:int", lambda loader, node: int(loader.construct_scalar(node), 10))
_Loader.add_constructor("tag:yaml.org,2002:map", _construct_mapping)


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
    """The one document in path.  BadInput in one line: not there, not UTF-8, not YAML, a key twice."""
    try:
        text = Path(path).read_text(encoding="utf-8")
        return yaml.load(text, _Loader)
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8: {error.reason} at byte {error.start}") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if hint := mark and _hint(text, mark):
            raise BadInput(f"{path}: {hint}") from None
        raise BadInput(
            f"{path}: line {mark.line + 1}: {error.problem}" if mark else f"{path}: {error.problem}"
        ) from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise BadInput(f"{path}: not readable YAML: {str(error) or 'nested too deep'}") from None
