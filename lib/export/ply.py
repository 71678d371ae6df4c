"""Meshes as binary PLY: corners are not shared, so that normals stay those of the facets."""

from __future__ import annotations

import numpy as np


def write(path, piece):
    """One lib.export.scene.Piece, m, world; (s, t) as Piece.uv has them."""
    p, uv = piece.corners.reshape(-1, 3), piece.uv.reshape(-1, 2)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(p)}"]
    head += [f"property float {name}" for name in ("x", "y", "z", "s", "t")]
    head += [f"element face {len(p) // 3}", "property list uchar int vertex_indices", "end_header"]
    faces = np.zeros(len(p) // 3, [("n", "u1"), ("corners", "<i4", 3)])
    faces["n"], faces["corners"] = 3, np.arange(len(p)).reshape(-1, 3)
    with open(path, "wb") as file:
        file.write(("\n".join(head) + "\n").encode())
        file.write(np.column_stack([p, uv]).astype("<f4").tobytes())
        file.write(faces.tobytes())
