"""specular.npz: how light goes past the mirrors and glossy surfaces that `fit` found; `render` need not trace it again.

It holds the finish, the chains, the transport to the patches, and the virtual index buffer: what each pixel of a mirror
shows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from lib.core import arrays, artefact
from lib.core.arrays import Array, Real, Starts, Whole
from lib.core.stage import BadInput
from lib.light.chains import Chains, Finish
from lib.light.lamps import Emitter
from lib.light.mirror_view import MirrorView
from lib.light.specular import Transport


@dataclass(frozen=True)
class Traced:
    """pixel : (m,) flat index of the pixels that show a mirror at once;  view : what they show in the end
    lobes : (L, 4) of the lamps"""

    transport: Transport
    pixel: np.ndarray
    view: MirrorView
    lobes: np.ndarray

    def fits(self, finish, n_patches, lobes):
        """Whether this was traced for these surfaces and lamps: a file beside another materials.json does not count."""
        same_lamps = self.lobes.shape == lobes.shape and np.allclose(self.lobes, lobes)
        return self.transport.finish.equals(finish) and len(self.transport.D_mirrored) == n_patches and same_lamps


FINISH, LAMP = ("kind", "alpha", "tangent"), ("corners", "normal", "cdf", "lobe", "mirrors")


def write(path, traced: Traced):
    """Whole or absent."""
    t = traced.transport
    found = {f"finish_{name}": np.asarray(getattr(t.finish, name)) for name in FINISH}
    for k, F in t.F.items():
        found |= {
            f"F_{k}_data": F.data,
            f"F_{k}_indices": F.indices,
            f"F_{k}_indptr": F.indptr,
            f"F_{k}_shape": F.shape,
        }
    found |= {f"D_{k}": D for k, D in t.D.items()}
    for k, lamp in enumerate(t.mirrored):
        found |= {f"lamp_{k}_{name}": np.asarray(getattr(lamp, name)) for name in LAMP}
    found |= {f"view_{f.name}": getattr(traced.view, f.name) for f in fields(MirrorView)}
    artefact.write_npz(
        path,
        **found,
        groups=np.array(t.finish.groups, int),
        form=t.finish.form,
        chains=t.chains.counts,
        F_chains=np.array(list(t.F), int),
        D_chains=np.array(list(t.D), int),
        lamps=np.array([lamp.lamp for lamp in t.mirrored], int),
        way=t.way,
        D_mirrored=t.D_mirrored,
        complete=t.complete,
        rays=t.rays,
        lost=t.lost,
        pixel=traced.pixel,
        lobes=traced.lobes,
    )


ALWAYS = {
    "groups": Whole("M"),
    "finish_kind": Whole("M", low=None),
    "finish_alpha": Real("M", 2, low=0),
    "finish_tangent": Real("M", 3),
    "form": Whole(),
    "chains": Whole("C", "M"),
    "F_chains": Whole("A", below="C"),
    "D_chains": Whole("B", below="C"),
    "D_mirrored": Real("N", "K"),
    "lamps": Whole("K", below="L"),
    "way": Whole("K", below="C"),
    "complete": Whole(low=None),
    "rays": Whole(),
    "lost": Real(low=0),
    "lobes": Real("L", 4),
    "pixel": Whole("P"),
}
VIEW = {
    "facet": Whole("P", low=-1),
    "side": Whole("P", low=-1),
    "p": Real("P", 3),
    "chain": Whole("P", low=-1, below="C"),
    "direction": Real("P", 3),
}


def _checked(path, a):
    """Arrays that stand there only where there is such a chain or such a lamp.

    BadInput: one is missing, or of another kind, shape or range than its use asks for.
    """
    sizes = arrays.check(path, a, ALWAYS)
    arrays.check(path, a, VIEW, sizes, "view_")
    parts = {f"F_{k}_": SPARSE for k in a["F_chains"]}
    parts |= {f"lamp_{k}_": OF_LAMP for k in range(sizes["K"])}
    parts |= {f"D_{k}": {"": Real("N", "L")} for k in a["D_chains"]}
    missing = [prefix + name for prefix, table in parts.items() for name in table if prefix + name not in a]
    if missing:
        raise BadInput(*(f"{path}: {name}: the array is missing" for name in missing))
    for prefix, table in parts.items():
        arrays.check(path, a, table, {"N": sizes["N"], "L": sizes["L"]}, prefix)
        if table is SPARSE and a[f"{prefix}shape"].tolist() != [sizes["N"]] * 2:
            raise BadInput(f"{path}: {prefix}shape: value: {a[f'{prefix}shape'].tolist()} is not {[sizes['N']] * 2}")


SPARSE = {
    "shape": Whole(2),
    "indptr": Starts("N+1", into="E"),
    "indices": Whole("E", below="N"),
    "data": Real("E"),
}
OF_LAMP = {
    "corners": Real("T", 3, 3),
    "normal": Real("T", 3),
    "cdf": Real("T", low=0),
    "lobe": Real(4),
    "mirrors": Array("iuf", "whole numbers", ("D",), 0),  # an empty one has no kind of its own
}


def read(path) -> Traced:
    """BadInput: an array is missing, or cannot be what it is for."""
    from scipy.sparse import csr_array

    a = artefact.read_npz(path, *ALWAYS, *(f"view_{name}" for name in VIEW))
    _checked(path, a)
    finish = Finish(tuple(map(int, a["groups"])), *(a[f"finish_{name}"] for name in FINISH), form=int(a["form"]))
    F = {
        int(k): csr_array((a[f"F_{k}_data"], a[f"F_{k}_indices"], a[f"F_{k}_indptr"]), shape=tuple(a[f"F_{k}_shape"]))
        for k in a["F_chains"]
    }
    mirrored = [
        Emitter(
            int(lamp),
            *(a[f"lamp_{k}_{name}"] for name in LAMP[:3]),
            mirrors=tuple(map(int, a[f"lamp_{k}_mirrors"])),
            lobe=a[f"lamp_{k}_lobe"],
        )
        for k, lamp in enumerate(a["lamps"])
    ]
    transport = Transport(
        finish,
        Chains(len(finish), a["chains"]),
        F,
        {int(k): a[f"D_{k}"] for k in a["D_chains"]},
        mirrored,
        a["way"],
        a["D_mirrored"],
        int(a["complete"]),
        int(a["rays"]),
        float(a["lost"]),
    )
    return Traced(transport, a["pixel"], MirrorView(*(a[f"view_{f.name}"] for f in fields(MirrorView))), a["lobes"])


def mirror_picture(traced: Traced, group_of_facet, shape):
    """(H, W) int32 for mirror.png: group + 1 that each pixel of a mirror shows, 0 where there is nothing."""
    picture = np.zeros(shape, np.int32)
    shown = np.where(traced.view.facet >= 0, np.asarray(group_of_facet)[traced.view.facet] + 1, 0)
    picture.reshape(-1)[traced.pixel] = shown
    return picture
