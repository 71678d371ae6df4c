"""The XML of a Mitsuba scene as it is meant: included files in their place, parameters written out, names of today.

scene = Scene(path, content)
scene.root                    # one element, all files in it
scene.placed(element)         # (4, 4), its to_world
scene.value(element, "fov")   # text, None where it is not told
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given.cameras import matrix_from_rt
from lib.given.mesh_files import beside

DEEPEST = 15  # files that include each other, as Mitsuba has it; elements in each other may be ten times as deep
MOST_FILES = 1000
MOST_ELEMENTS = 1_000_000
LONGEST = 100_000  # letters of a value, its parameters written out
FARTHEST = 1e12  # of a number
UNIT = 1e-3  # of the length of an axis: how far from 1
PROPERTIES = (
    *("float", "integer", "boolean", "string", "point", "vector", "rgb", "spectrum", "color"),
    *("transform", "animation", "ref"),
)


class Scene:
    """root : element of the scene;  ids : {id: element};  size : bytes of all XML files"""

    def __init__(self, path, content):
        self.path, self.size, self.files, self.count = path, 0, 0, 0
        self.parameters, self.ids = {}, {}
        self.root, self.old = ElementTree.Element("scene"), False
        self._fill(path, content, self.root, 0)

    def refuse(self, problem):
        raise BadInput(f"{self.path}: {problem}") from None

    # ---- reading ----

    def _fill(self, file, content, into, depth):
        """Appends what a file holds; a scene that is included gives what is in it."""
        self.size, self.files = self.size + len(content), self.files + 1
        bounded.check_size(file, self.size, bounded.LARGEST_TEXT)
        if depth > DEEPEST or self.files > MOST_FILES:
            self.refuse(f"include: {file}: files include each other deeper than {DEEPEST}, or more than {MOST_FILES}")
        try:
            root = ElementTree.fromstring(content)
        except ElementTree.ParseError as error:
            raise BadInput(f"{file}: not readable XML: {error}") from None
        if depth == 0:  # before 2.0 axes were made unit
            self.old = root.get("version", "").startswith(("0.", "1."))
        for child in root if root.tag == "scene" else [root]:
            self._take(child, into, depth)

    def _take(self, element, into, depth):
        """Copies an element and what is in it into another, by the rules of the format."""
        todo = [(element, into, 0)]
        while todo:
            element, into, deep = todo.pop()
            self.count += 1
            if self.count > MOST_ELEMENTS or deep > 10 * DEEPEST:
                self.refuse(f"more than {MOST_ELEMENTS:,} elements, or more than {10 * DEEPEST} in each other")
            told = {key: value if element.tag == "default" else self._written(value) for key, value in element.items()}
            if element.tag == "default":
                self.parameters.setdefault(told.get("name", ""), self._written(told.get("value", "")))
            elif element.tag == "include":
                file = beside(self.path, told.get("filename", ""))
                self._fill(file, bounded.content(file, bounded.LARGEST_TEXT), into, depth + 1)
            elif element.tag == "alias":
                if told.get("id") not in self.ids:
                    self.refuse(f"alias: id {told.get('id')!s:.80} is not there")
                self.ids[told.get("as")] = self.ids[told["id"]]
            else:
                if element.tag in PROPERTIES and "name" in told:
                    told["name"] = _today(told["name"])  # of versions before 2.0
                made = ElementTree.SubElement(into, _today(element.tag) if element.tag != "lookAt" else "lookat", told)
                if element.tag != "ref" and "id" in told:
                    self.ids.setdefault(told["id"], made)
                if any(child.tag in ("include", "default") for child in element):  # in their order
                    for child in element:
                        self._take(child, made, depth)
                else:
                    todo += [(child, made, deep + 1) for child in reversed(element)]

    def _written(self, value):
        """A value with its parameters, the longest names first."""
        if "$" in value:
            for name in sorted(self.parameters, key=len, reverse=True):
                value = value.replace(f"${name}", self.parameters[name]) if name else value
                if len(value) > LONGEST:
                    self.refuse(f"parameter {name:.80}: its value is longer than {LONGEST} letters")
            if found := re.search(r"\$(\w*)", value):
                self.refuse(f"parameter ${found[1]:.80} has no <default>: write its value into the file")
        return value

    # ---- asking ----

    def named(self, element, tag):
        """Elements of a kind in an element, or that it refers to by their id."""
        found = element.findall(tag)
        for ref in element.findall("ref"):
            target = self.target(ref)
            found += [target] if target.tag == tag else []
        return found

    def target(self, ref):
        if ref.get("id") not in self.ids:
            self.refuse(f"ref: id {ref.get('id')!s:.80} is not there")
        return self.ids[ref.get("id")]

    def value(self, element, name):
        """The text of a property, None where it is not told."""
        found = [p for p in element if p.get("name") == name and p.tag in PROPERTIES]
        return _text(found[0]) if found else None

    def flag(self, element, name):
        return str(self.value(element, name)).strip().lower() == "true"

    def number(self, element, name, default):
        told = self.value(element, name)
        return default if told is None else self.numbers(name, told, 1)[0]

    def point(self, element, name, default):
        told = self.value(element, name)
        return np.array(default, float) if told is None else self.numbers(name, told, 3)

    def numbers(self, what, text, *counts):
        """Numbers of a text; BadInput: others, or not as many as one of counts."""
        try:
            found = np.array([float(word) for word in text.replace(",", " ").split()])
        except ValueError:
            self.refuse(f"{what}: {text!r:.80} are no numbers")
        if len(found) not in counts or not (np.abs(found) <= FARTHEST).all():
            wanted = " or ".join(map(str, counts))
            self.refuse(f"{what}: {text!r:.80}: {wanted} numbers of at most {FARTHEST:g} are needed")
        return found

    def placed(self, element):
        """(4, 4): the steps of to_world, each after the ones before it."""
        if element.find("animation") is not None:
            self.refuse(f"{element.tag} {element.get('id') or element.get('type')}: animation: write one to_world")
        T = np.eye(4)
        for transform in element.findall("transform"):
            if transform.get("name", "to_world") == "to_world":
                for step in transform:
                    T = self.step(step) @ T
        if not (np.abs(T) <= FARTHEST).all():
            self.refuse(f"transform: {T.ravel()[~(np.abs(T.ravel()) <= FARTHEST)][0]:g} is too large")
        if not np.allclose(T[3], (0, 0, 0, 1)):
            self.refuse(f"transform: matrix: its last row is {T[3].tolist()}, not 0 0 0 1")
        return T

    def step(self, step):
        """One step of a transform."""
        S, what = np.eye(4), f"transform: {step.tag}"
        three = lambda key: self.numbers(f"{what}: {key}", step.get(key, ""), 3)
        axes = lambda default: self.numbers(what, " ".join(step.get(a, str(default)) for a in "xyz"), 3)
        if step.tag == "matrix":
            told = self.numbers(what, step.get("value", ""), 9, 16)
            side = 3 if len(told) == 9 else 4
            S[:side, :side] = told.reshape(side, side)
        elif step.tag == "translate":
            S[:3, 3] = three("value") if step.get("value") else axes(0)
        elif step.tag == "scale":
            told = self.numbers(what, step.get("value"), 1, 3) if step.get("value") else axes(1)
            S[:3, :3] = np.diag(told * np.ones(3))
        elif step.tag == "rotate":
            axis = three("value") if step.get("value") else axes(0)
            (angle,) = np.radians(self.numbers(f"{what}: angle", step.get("angle", ""), 1))
            length = np.linalg.norm(axis)
            if not length > 0 or not self.old and abs(length - 1) > UNIT:
                self.refuse(f"{what}: its axis has the length {length:g}, which shears in Mitsuba: it needs 1")
            S = matrix_from_rt(np.concatenate([angle * axis / length, np.zeros(3)]))
        elif step.tag == "lookat":
            S = self._looking(what, three("origin"), three("target"), three("up") if step.get("up") else None)
        else:
            self.refuse(f"{what} is not known")
        return S

    def _looking(self, what, origin, target, up):
        z = _unit(target - origin)
        if z is not None:
            x = _unit(np.cross(_some_up(z) if up is None else up, z))
        if z is None or x is None:
            self.refuse(f"{what}: origin, target and up do not tell a direction")
        S = np.eye(4)
        S[:3, :4] = np.column_stack([x, np.cross(z, x), z, origin])
        return S


def _text(element):
    """What a property says: its value, or x, y and z."""
    if element.get("value") is not None:
        return element.get("value")
    if any(element.get(axis) is not None for axis in "xyz"):
        return " ".join(element.get(axis, "0") for axis in "xyz")
    return ""


def _today(name):
    """A name as version 2.0 and later spell it.

    >>> _today("toWorld"), _today("fov_axis"), _today("rectangle")
    ('to_world', 'fov_axis', 'rectangle')
    """
    return re.sub(r"(?<=[a-z0-9])([A-Z])", r"_\1", name).lower() if re.search(r"[a-z][A-Z]", name) else name


def _unit(v):
    length = np.linalg.norm(v)
    return v / length if length > 0 else None


def _some_up(n):
    """What Mitsuba takes for up where a lookat tells none: the first axis of its frame around n (Duff et al. 2017)."""
    sign = np.copysign(1.0, n[2])
    a = -1 / (sign + n[2])
    return np.array([1 + sign * n[0] ** 2 * a, sign * n[0] * n[1] * a, -sign * n[0]])
