"""What composition of a USD file would read and make, found before it is done.

    found = look("room.usda", "models/room.usda", allow)     # BadInput: files outside, far too many prims

Each layer is opened alone, by Sdf, and its prims are listed. Then prims are counted as composition would make them:
the opinions of a prim stand at several sites, (layer stack, path); its children are those of all its sites.
"""

from __future__ import annotations

import os
import stat
import zipfile
from dataclasses import dataclass, field
from typing import NamedTuple

from lib.core import bounded
from lib.core.stage import BadInput

MOST_PRIMS = 50_000  # that composition makes of a small file
MOST_TIMES = 4  # of the prims that the layers hold: so many from a large one
MOST_SITES = 1000  # of one prim
MOST_LAYERS = 10_000
DEEPEST = 200  # prims in each other
FLAT = "flatten it where its files are: usdcat --flatten -o flat.usdc"
ARCS = ("references", "payload")
CLASSES = ("inheritPaths", "specializes")


class Found(NamedTuple):
    """path : of the root layer, absolute;  size : bytes of all layers;  prims : that composition makes, at most
    specs : prims that the layers hold;  layers : names of all, the root first
    """

    path: str
    size: int
    prims: int
    specs: int
    layers: tuple


class Spec(NamedTuple):
    """What one layer says of one prim. arcs : [(Layer or None for this one, path, is it a class)]"""

    children: list
    arcs: list
    variants: dict
    selected: dict


@dataclass(eq=False)
class Layer:
    """One file. specs : {path: Spec}, and "/" for the layer itself;  beneath : {path: (prims, has no arcs)}"""

    name: str
    sdf: object
    default: str | None
    specs: dict = field(default_factory=dict)
    beneath: dict = field(default_factory=dict)
    sublayers: list = field(default_factory=list)

    def stack(self):
        """This layer and all sublayers, each once."""
        found, todo = {}, [self]
        while todo:
            layer = todo.pop()
            if id(layer) not in found:
                found[id(layer)] = layer
                todo += layer.sublayers
        return list(found.values())


def look(name, path, allow) -> Found:
    """name : of the file, for messages;  allow : takes the bytes of the layers found so far, raises what is allowed"""
    files = _Files(name, path, allow)
    root = files.layer(path)
    if root is None:
        raise BadInput(f"{name}: there is no such file")
    files.fill()
    specs = sum(len(layer.specs) - 1 for layer in files.layers.values())
    most = max(MOST_PRIMS, MOST_TIMES * specs)
    prims = _Counted(name, root, most).all()
    return Found(path, files.size, prims, specs, tuple(files.layers))


class _Files:
    """The layers by their names, opened as others name them: in the model's folder, or in the package."""

    def __init__(self, name, path, allow):
        self.name, self.allow = name, allow
        self.folder = os.path.dirname(path)
        self.layers, self.todo, self.size, self.packages = {}, [], 0, {}

    def refuse(self, problem):
        raise BadInput(f"{self.name}: {problem}")

    def layer(self, path):
        """The Layer at an absolute path, or at package[path inside]; None where there is no such file."""
        from pxr import Sdf

        if path in self.layers:
            return self.layers[path]
        file = path.partition("[")[0] if path.endswith("]") else path
        if not os.path.exists(file):
            return None  # a composition error where it is needed; an unused variant may name it
        self.check(path, file)
        sdf = Sdf.Layer.FindOrOpen(path)
        if sdf is None:
            return None
        default = f"/{sdf.defaultPrim.lstrip('/')}" if sdf.defaultPrim else None
        self.layers[path] = layer = Layer(path, sdf, default)
        self.todo.append(layer)
        if len(self.layers) > MOST_LAYERS:
            self.refuse(f"more than {MOST_LAYERS} layers: {FLAT}")
        return layer

    def check(self, path, file):
        status = os.stat(file)
        if not stat.S_ISREG(status.st_mode):
            self.refuse(f"{self.short(path)}: is no file")
        if file not in self.packages:
            self.packages[file] = self.package(file, status.st_size) if file.lower().endswith(".usdz") else []
            self.size += status.st_size
            bounded.check_size(self.name, self.size, bounded.LARGEST_FILE)
            self.allow(self.size)
        elif path == file:
            return
        if os.path.splitext(path.rstrip("]"))[1].lower() not in (".usd", ".usda", ".usdc", ".usdz"):
            self.refuse(f"{self.short(path)}: name it .usd: USD's package goes by the ending")

    def package(self, file, size):
        """Names of the files in a usdz."""
        try:
            with zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
        except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
            self.refuse(f"not readable as usdz, which is a ZIP archive: {error}")
        for entry in entries:
            if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > size:
                self.refuse(f"{entry.filename:.80}: is compressed; a usdz is not: usdzip makes one")
            if bounded.lies_outside(entry.filename):
                self.refuse(f"{entry.filename:.80} lies outside the package")
        if not entries:
            self.refuse("the package is empty")
        return [entry.filename for entry in entries]

    def short(self, path):
        """A path as seen from the model's folder."""
        return os.path.relpath(path, self.folder)

    def named(self, layer, asset):
        """The path that a layer means by an asset path. BadInput: it lies outside."""
        if "`" in asset:
            self.refuse(f"@{asset:.80}@ is an expression: {FLAT}")
        asset = asset.partition(":SDF_FORMAT_ARGS:")[0]
        if "[" in asset or layer.name.endswith("]") and asset.lower().endswith(".usdz"):
            self.refuse(f"@{asset:.80}@ is a package in a package or names its inside: {FLAT}")
        inside = layer.name[:-1].partition("[")[::2] if layer.name.endswith("]") else None
        if inside is None and layer.name.lower().endswith(".usdz"):
            inside = layer.name, self.packages[layer.name][0]
        if inside:
            path = os.path.normpath(os.path.join(os.path.dirname(inside[1]), asset))
            if bounded.lies_outside(path) or "://" in asset:
                self.refuse(f"@{asset:.80}@ lies outside the package: {FLAT}")
            return f"{inside[0]}[{path}]" if path in self.packages[inside[0]] else f"{layer.name}.missing/{path}"
        path = os.path.normpath(os.path.join(os.path.dirname(layer.name), asset))
        if "://" in asset or asset.startswith("anon:") or os.path.commonpath([path, self.folder]) != self.folder:
            self.refuse(f"@{asset:.80}@ lies outside the model's folder: {FLAT}")
        return path

    def fill(self):
        """Lists what is in each layer, and in the layers that they name."""
        while self.todo:
            layer = self.todo.pop()
            children = [prim.name for prim in layer.sdf.rootPrims]
            for asset in layer.sdf.subLayerPaths:
                sub = self.layer(self.named(layer, asset))
                layer.sublayers += [sub] if sub else []
            layer.specs["/"] = Spec(children, [], {}, {})
            order, todo = [("/", None)], [(prim, "/", 1) for prim in layer.sdf.rootPrims]
            while todo:
                prim, above, depth = todo.pop()
                path = str(prim.path)
                if depth > DEEPEST:
                    self.refuse(f"<{path:.80}...>: prims are nested deeper than {DEEPEST}")
                order.append((path, above))
                spec, variants = self.spec(layer, prim)
                layer.specs[path] = spec
                todo += [(child, path, depth + 1) for child in (*prim.nameChildren, *variants)]
            self.sum(layer, order)

    def sum(self, layer, order):
        """How many prims are at and below each, and whether nothing is composed there."""
        count, plain = dict.fromkeys(layer.specs, 1), dict.fromkeys(layer.specs, True)
        for path, above in reversed(order):
            spec = layer.specs[path]
            plain[path] &= not spec.arcs and not spec.variants
            layer.beneath[path] = count[path], plain[path]
            if above is not None:
                count[above] += count[path]
                plain[above] &= plain[path]

    def spec(self, layer, prim):
        """(Spec, prims of its variants)"""
        keys, arcs, variants, prims = set(prim.ListInfoKeys()), [], {}, []
        if "clips" in keys:
            self.refuse(f"<{prim.path}>: value clips are not read: {FLAT}")
        for key in keys.intersection(ARCS):
            for arc in _items(prim.GetInfo(key)):
                other = self.layer(self.named(layer, arc.assetPath)) if arc.assetPath else None
                if other or not arc.assetPath:
                    arcs.append((other, str(arc.primPath) if arc.primPath else None, False))
        for key in keys.intersection(CLASSES):
            arcs += [(None, str(path), True) for path in _items(prim.GetInfo(key))]
        if "variantSetNames" in keys:
            for name, variant_set in prim.variantSets.items():
                some = list(variant_set.variants.values()) if variant_set else [None]
                if any(variant is None or variant.primSpec is None for variant in some):
                    self.refuse(f"<{prim.path}>: its variant set {name:.80} is damaged: write the file anew")
                variants[name] = [variant.name for variant in some]
                prims += [variant.primSpec for variant in some]
        selected = dict(prim.variantSelections) if "variantSelection" in keys else {}
        return Spec([child.name for child in prim.nameChildren], arcs, variants, selected), prims


def _items(operation):
    """Everything that a list operation may bring in."""
    lists = ("explicitItems", "prependedItems", "appendedItems", "addedItems")
    return [item for name in lists for item in getattr(operation, name)]


class _Counted:
    """Counts prims as composition would make them; a site is (Layer at the root of a layer stack, path)."""

    def __init__(self, name, root, most):
        self.name, self.root, self.most = name, root, most
        self.stacks, self.counts, self.located = {}, {}, {}

    def all(self):
        return self.count(self.closed([(self.root, "/")]), 0) - 1  # the root of all is no prim

    def specs(self, site):
        """[(layer, Spec)] of all layers of its stack that say something."""
        root, path = site
        if id(root) not in self.stacks:
            self.stacks[id(root)] = root.stack()
        return [(layer, layer.specs[path]) for layer in self.stacks[id(root)] if path in layer.specs]

    def closed(self, sites):
        """The sites and all that their arcs and chosen variants bring in; those alone of which something is said."""
        found, selected, waiting, todo = {}, {}, [], list(sites)
        while todo:
            site = todo.pop()
            key = (id(site[0]), site[1])
            if key in found:
                continue
            specs = self.specs(site)
            if not specs:
                continue
            found[key] = site
            if len(found) > MOST_SITES:
                raise BadInput(f"{self.name}: <{site[1]:.80}> is composed of more than {MOST_SITES} prims: {FLAT}")
            for _, spec in specs:
                for other, path, is_class in spec.arcs:
                    todo += self.locate(other or site[0], path)
                    if is_class and site[0] is not self.root:
                        todo += self.locate(self.root, path)
                for name, choice in spec.selected.items():
                    selected.setdefault(name, set()).add(choice)
                waiting += [(site, name, choice) for name, choices in spec.variants.items() for choice in choices]
            chosen = [w for w in waiting if w[2] in selected.get(w[1], ())]
            todo += [(at[0], f"{at[1]}{{{name}={choice}}}") for at, name, choice in chosen]
        return list(found.values())

    def locate(self, root, path):
        """The sites of a path, those above it composed."""
        path = path or self.default(root)
        if path is None:
            return []
        key = (id(root), path)
        if key not in self.located:
            self.located[key] = [(root, path)]  # while it is looked for: a circle ends here
            sites = [(root, "/")]
            for name in path.split("/")[1:]:
                sites = self.closed([_child(site, name) for site in sites])
            self.located[key] = [(root, path), *sites]
        return self.located[key]

    def default(self, root):
        return root.default

    def count(self, sites, depth):
        """Prims at and below a prim with these sites."""
        if len(sites) == 1:
            specs = self.specs(sites[0])
            if len(specs) == 1 and specs[0][0].beneath[sites[0][1]][1]:
                return specs[0][0].beneath[sites[0][1]][0]
        key = frozenset((id(root), path) for root, path in sites)
        if key not in self.counts:
            self.counts[key] = 1  # while it is counted: a circle ends here
            if depth > DEEPEST:
                raise BadInput(f"{self.name}: references are nested deeper than {DEEPEST}: {FLAT}")
            total = 1
            for name in dict.fromkeys(n for site in sites for _, spec in self.specs(site) for n in spec.children):
                total += self.count(self.closed([_child(site, name) for site in sites]), depth + 1)
            self.counts[key] = total
            if len(self.counts) > self.most:
                self.refuse(total)
        if depth == 0 and self.counts[key] > self.most:
            self.refuse(self.counts[key])
        return self.counts[key]

    def refuse(self, count):
        raise BadInput(
            f"{self.name}: composes to {count:,} prims or more, and at most {self.most:,} are read: "
            "load fewer references or instances"
        )


def _child(site, name):
    root, path = site
    return root, f"{path}{'' if path.endswith(('}', '/')) else '/'}{name}"
