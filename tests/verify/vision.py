"""Vision, section 2: flat and noisy pictures, the baseline, planes that no pair can know, models that do not fit."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from lib.given import model as models
from lib.given.cameras import Camera
from lib.vision import matching, segmentation
from lib.vision.facets import planes as facets
from lib.vision.recognition import recognise as recognition
from tests.helpers import facet_trials as trials
from tests.helpers import pairs, rooms
from tests.helpers.pairs import parallel
from tests.verify.walks import Found, at_most, near, refused, walk


def noise(shape, sigma, seed=0):
    return 0.5 + sigma * np.random.default_rng(seed).standard_normal(shape)


def regions(picture, weight, wanted, truth=None):
    """Number of regions, and their energy (eq. 2.1) where it is known."""
    labels = segmentation.segment(picture, weight)
    found = near(int(labels.max()), wanted, 0.0)
    if truth is None or not found.holds:
        return found
    return near(segmentation.energy(picture, labels, weight), truth, 1e-9 * max(truth, 1.0), note=f"{wanted} regions")


# ---- segmentation ----

LAMBDAS = [0.0, 1e-9, 1e-3, 0.05, 1.0, 1e3, 1e300]


@walk("segmentation", "a flat picture", law="one region of energy 0", axis="lambda", at=LAMBDAS, short=[0, 3, 6])
def flat(weight):
    return regions(np.full((60, 80, 3), 0.37), weight, 1, 0.0)


@walk(
    "segmentation",
    "pure noise at its own lambda",
    law="one region; its strength is found to 3 %",
    axis="sigma",
    at=[0.002, 0.02, 0.2],
)
def pure_noise(sigma):
    picture = noise((160, 200, 3), sigma)
    if segmentation.segment(picture, segmentation.auto_lambda(picture)).max() != 1:
        return Found(None, 1.0, 1.0, 0.0, None, "more than one region")
    return near(segmentation.noise(picture), sigma, 0.03, relative=True)


@walk(
    "segmentation",
    "lambda 0 and infinite",
    law="each pixel a region; one region of the variance's energy",
    at=["0", "infinite"],
)
def extremes(name):
    picture = noise((60, 80, 1), 0.3)
    if name == "0":
        return regions(picture, 0.0, picture.size, 0.0)
    return regions(picture, 1e300, 1, float(((picture - picture.mean()) ** 2).sum()))


@walk("segmentation", "10,000 regions", law="all of them, below what any merge costs", axis="lambda", at=[0.0, 1e-10])
def many(weight):
    shades = np.random.default_rng(6).permutation(10000).reshape(100, 100) / 10000.0
    return regions(np.kron(shades, np.ones((2, 2)))[..., None], weight, 10000)


# ---- matching ----


@walk(
    "matching",
    "pairs that tell nothing",
    law="nothing is claimed, or refused",
    at=["one region", "nothing labelled", "forward motion", "one centre"],
)
def nothing_told(name):
    left, right = parallel(64, 48, 50.0, 0.1)
    grey, one = np.full((48, 64, 1), 0.5), np.ones((48, 64), np.int32)
    if name == "one centre":
        return refused(lambda: matching.stereo(left, left), "same centre")
    labels = 0 * one if name == "nothing labelled" else one
    if name == "forward motion":
        T = np.eye(4)
        T[2, 3] = -0.2
        left, right = Camera(left.K, 64, 48, np.eye(4)), Camera(left.K, 64, 48, T)
        labels = one.copy()
        labels[15:33, 22:42] = 2
        grey = labels[..., None] / 3.0
    return at_most(len(matching.match(matching.stereo(left, right), labels, labels, grey, grey).left), 0.0)


@walk("matching", "10,000 regions", law="none matched wrongly, half of them matched", at=["7 px apart"])
def many_matched(_):
    rng = np.random.default_rng(0)
    left, right = parallel(1207, 1000, 900.0, 0.1)
    tile = (np.arange(1000)[:, None] // 10) * 100 + np.arange(1200)[None] // 12
    colour = rng.uniform(0, 1, (10000, 3))
    labels = [np.zeros((1000, 1207), np.int32), np.zeros((1000, 1207), np.int32)]
    labels[0][:, 7:], labels[1][:, :1200] = tile + 1, tile + 1
    values = [np.where(x[..., None] > 0, colour[np.maximum(x - 1, 0)], 0.0) for x in labels]
    found = matching.match(matching.stereo(left, right), *labels, *values)
    wrong = int((found.left != found.right).sum())
    return at_most(wrong + (len(found.left) < 5000), 0.0, note=f"{len(found.left)} matched")


# ---- facets ----


@walk(
    "facets",
    "the baseline towards 0",
    law="of 15 pairs the 95 % ellipsoids hold 86 % or more, and ever fewer are claimed",
    axis="baseline, m",
    at=[0.4, 0.2, 0.1, 0.05, 0.025, 0.01],
)
def baseline(metres):
    inside = []
    for seed in range(15):
        Q = pairs.quads(seed, baseline=metres)
        both = np.intersect1d(*[np.unique(x) for x in Q.labels])
        noisy = Q.noisy(0.01, np.random.default_rng(seed))
        found, _, _ = facets.reconstruct(matching.stereo(Q.left, Q.right), Q.labels, noisy, both, both)
        for x in found:
            if x.left_label < 7:
                e = x.m - Q.m[x.left_label]
                inside.append(e @ np.linalg.solve(x.covariance, e) < 7.815)
    if not inside:
        return Found(None, None, 0.0, 0.0, None, "none claimed")
    return Found(
        float(np.mean(inside)), 0.95, float(max(0.86 - np.mean(inside), 0)), 0.0, None, f"{len(inside)} claimed"
    )


@walk(
    "facets",
    "planes that no pair can know",
    law="refused, with a reason",
    at=["through a camera's centre", "infinitely far", "wrong pairs", "no pair"],
)
def no_plane(name):
    Q = pairs.quads(0)
    labels, left, right = [x.copy() for x in Q.labels], np.array([1]), np.array([1])
    stereo, values = matching.stereo(Q.left, Q.right), Q.values
    if name == "through a camera's centre":
        y, x = np.nonzero(labels[1] == 1)
        labels[1][labels[1] == 1] = 7
        labels[1][y.min() : y.max() + 1, x.mean().astype(int)] = 1
    elif name == "infinitely far":
        cameras, (h, w) = parallel(160, 120, 120.0, 0.1), (120, 160)
        one = np.ones((h, w), np.int32)
        one[40:80, 50:110] = 2
        stereo, labels = matching.stereo(*cameras), [one, one.copy()]
        values = [x[..., None] / 3.0 for x in labels]
        left = right = np.array([2])
    elif name == "wrong pairs":
        left, right = np.array([1, 2]), np.array([3, 6])
    else:
        left = right = np.array([], int)
    found, refused_, _ = facets.reconstruct(stereo, labels, values, left, right)
    reasons = all(r.why for r in refused_) and len(refused_) == len(left)
    return at_most(len(found) + (not reasons), 0.0)


# ---- recognition ----


@cache
def trial(seed, scale=1.0, mirrored=False, symmetric=False):
    """(facets as seen, model as told, camera) of a random room; the model may be another than what was seen."""
    with tempfile.TemporaryDirectory() as folder:
        random, things, model, camera = trials.room_trial(
            seed, Path(folder), *((1,) if symmetric else ()), symmetric=symmetric
        )
        seen, _ = trials.facets_seen(random, model, camera)
        if mirrored:
            things = {n: [(g, (np.array(p) * [1, -1, 1])[::-1]) for g, p in polygons] for n, polygons in things.items()}
        if mirrored or scale != 1:
            model = models.load(rooms.write(Path(folder) / "other.obj", things, scale=scale))
    return seen, model, camera


def pose_error(found, camera):
    """Of the best pose: within 1.5 degrees and 15 cm."""
    turn, move = trials.pose_error(found.poses[0].T, camera)
    return Found(float(turn), 0.0, max(turn / 1.5, move / 0.15), 1.0, None, f"{found.status}; {1000 * move:.0f} mm")


@walk(
    "recognition",
    "a room among rooms",
    law="unique, within 1.5 degrees and 15 cm",
    axis="seed",
    at=[0, 2, 4, 5],
    short=[0, 2],
)
def recognised(seed):
    seen, model, camera = trial(seed)
    found = recognition.recognise(seen, model, camera)
    return pose_error(found, camera) if found.status == "unique" else at_most(1.0, 0.0, note=found.status)


@walk(
    "recognition",
    "models that are not what is seen",
    law="not proved",
    at=["mirrored", "10 times larger", "10 times smaller"],
)
def other_model(name):
    seen, model, camera = trial(
        3, **({"mirrored": True} if name == "mirrored" else {"scale": 10.0 if "larger" in name else 0.1})
    )
    found = recognition.recognise(seen, model, camera)
    return at_most(found.status not in ("unproved", "not recognised"), 0.0, note=found.status)


@walk(
    "recognition",
    "a symmetric room",
    law="ambiguous, and the truth is among the poses",
    at=["bare box 0", "bare box 1"],
    short=[0],
)
def symmetric(name):
    seen, model, camera = trial(int(name[-1]), symmetric=True)
    found = recognition.recognise(seen, model, camera)
    right = any(turn < 1.5 and move < 0.15 for turn, move in (trials.pose_error(p.T, camera) for p in found.poses))
    return at_most(found.status != "ambiguous" or not right, 0.0, note=f"{found.status}, {len(found.poses)} poses")
