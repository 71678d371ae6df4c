"""Outlines of facets on their planes, in the left camera's frame and unit; facets.ply; what the report says of them."""

import numpy as np

from lib.vision.facets.borders_kernels import SURE


def outline(labels, label, camera, m, q, sigma):
    """(P, 3) the outer outline of a region on the plane m . x = 1; None where part of it lies behind the camera.

    m : (3,) in the camera's frame
    q, sigma : the region's border points (n, 2) px, and px how well each is located

    Each straight side of the outline is the line through its points, and its corners are where the lines meet. A side
    without points is the pixels' outer edge.
    """
    import cv2

    y, x = np.nonzero(labels == label)
    y0, x0 = y.min() - 1, x.min() - 1
    mask = np.zeros((y.max() - y0 + 2, x.max() - x0 + 2), np.uint8)
    mask[y - y0, x - x0] = 1
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    ring = cv2.approxPolyDP(max(contours, key=len), 1.5, True)[:, 0].astype(float) + [x0, y0]
    if len(ring) < 3:
        return None
    corner = _corners(ring, q[sigma < SURE])
    v = camera.directions(np.clip(corner, -0.5, np.array(labels.shape[::-1]) - 0.5))
    height = v @ m
    if not (height > 1e-6 * np.linalg.norm(m)).all():
        return None
    return v / height[:, None]


def _corners(ring, q):
    """(P, 2) px: where the sides of a ring of pixels (P, 2) meet, each the line through those points of q near it."""
    along = np.roll(ring, -1, 0) - ring
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / length
    turn = np.sign((ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1)).sum())
    outward = turn * np.column_stack([along[:, 1], -along[:, 0]])
    base, direction = ring + 0.5 * outward, along.copy()
    for k in range(len(ring)):
        t, off = (q - ring[k]) @ along[k], (q - ring[k]) @ outward[k]
        near = q[(t > 1.5) & (t < length[k] - 1.5) & (np.abs(off - 0.5) < 1.5)]
        if len(near) >= 4 and np.ptp((near - ring[k]) @ along[k]) > 3:
            base[k] = near.mean(axis=0)
            v = np.linalg.svd(near - base[k], full_matrices=False)[2][0]
            if abs(v @ along[k]) > 0.97:
                direction[k] = v * np.sign(v @ along[k])
    before, back = np.roll(base, 1, 0), np.roll(direction, 1, 0)
    cross = back[:, 0] * direction[:, 1] - back[:, 1] * direction[:, 0]
    corner = ring + 0.5 * (outward + np.roll(outward, 1, 0))
    sharp = np.abs(cross) > 0.2
    d = base - before
    s = (d[:, 0] * direction[:, 1] - d[:, 1] * direction[:, 0]) / np.where(sharp, cross, 1)
    meet = before + s[:, None] * back
    sharp &= np.linalg.norm(meet - ring, axis=1) < 3
    corner[sharp] = meet[sharp]
    return corner


# -- what is shown of them


def write_ply(path, found, colours):
    """The polygons, triangulated and coloured: ASCII, for MeshLab. colours : (M, 3) in [0, 1]."""
    import mapbox_earcut

    points, faces = [], []
    for x, colour in zip(found, colours, strict=True):
        n = x.plane[0]
        u = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        u /= np.linalg.norm(u)
        flat = np.column_stack([x.polygon @ u, x.polygon @ np.cross(n, u)])
        t = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(int)
        faces += (t + len(points)).tolist()
        rgb = np.round(255 * np.clip(np.broadcast_to(colour, 3), 0, 1)).astype(int)
        points += [" ".join([f"{c:.9g}" for c in p] + [str(c) for c in rgb]) for p in x.polygon]
    with open(path, "w", encoding="ascii") as file:
        file.write(
            f"ply\nformat ascii 1.0\ncomment left camera: x right, y down, z forward\nelement vertex {len(points)}\n"
            "property double x\nproperty double y\nproperty double z\n"
            "property uchar red\nproperty uchar green\nproperty uchar blue\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        file.write("".join(p + "\n" for p in points) + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces))


def reasons(refused):
    """Counts by reason."""
    counts = {}
    for x in refused:
        counts[x.why] = counts.get(x.why, 0) + 1
    return counts


def median_rms(found):
    return float(np.median([x.rms_px for x in found]))


def median_sigma(found):
    """Of the relative standard deviations of the distances of the planes."""
    return float(np.median([np.sqrt(x.m @ x.covariance @ x.m) / (x.m @ x.m) for x in found]))


def colours(labels, values, found):
    """(M, 3) mean colour of each facet's left region."""
    count = np.maximum(np.bincount(labels.ravel()), 1)
    mean = (
        np.stack([np.bincount(labels.ravel(), values[..., c].ravel()) for c in range(values.shape[2])], axis=1)
        / count[:, None]
    )
    return [mean[x.left_label] if mean.shape[1] == 3 else np.repeat(mean[x.left_label], 3) for x in found]
