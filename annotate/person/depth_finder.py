"""People in depth alone: a small network gives every pixel's log odds and a vote for its person's middle.

Pixels whose votes meet are one person, so that people who touch are told apart. The image is brought to one
focal length first, whatever the camera. How the network was trained: `annotate/person/finder.md`.
"""

import threading
from functools import cache
from importlib.resources import files

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Index, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.persons import MOST_PERSONS, Person
from annotate.person.pieces import MIN_PERSON_M2, MOST_PERSON_M2

FOCAL_PX = 110.0
"""Focal length in pixels of the images that the network is trained on: a person at 2.5 m is 75 pixels tall.
Chosen by eye."""
MULTIPLE = 32
"""The network halves an image five times: its sides are padded to multiples of this."""
LOCAL_PX, LOCAL_GAIN, MOST_LOCAL = 31, 8.0, 4.0
"""Side in pixels of the window whose mean log depth is zero in the input's third channel; factor and bound of
that channel. Chosen by eye; the network is trained on them."""
VOTE_M, MIDDLES_M = 0.1, 0.25
"""Metres by which votes for one middle scatter; least distance of the middles of two persons. Measured on
training scenes: of 134 persons 8 fall apart and 9 are joined; 0.35 m: 6 and 12, 0.45 m: 4 and 13."""
STRAY_M = 0.7
"""Metres from a person's votes within which scattered votes are still theirs. Chosen by eye."""
MOST_VOTES = 800
"""Votes that decide on the middles, for speed. Chosen by eye."""
CUT_OUT_ODDS = 4.0
"""Added log odds where the whole image shows no more surface than a person has: the background has been cut
away, and what was kept is the person. Chosen by eye."""
SURE_ODDS = 1.0
"""Mean log odds of a person's pixels below which it is a thing. Chosen by eye."""
SAME_SURFACE = 0.03
"""Depth difference, as a share of the depth, at which a pixel of the small image counts 1/e for one of the
whole image. Chosen by eye."""
_AT_WORK = threading.Lock()


def people_in(cloud: ThermalCloud) -> list[Person]:
    """All people of a cloud by its depth alone, in no order."""
    v, u = (
        _grid(side, focal)
        for side, focal in zip(cloud.depth_mm.shape, (cloud.camera.fy, cloud.camera.fx), strict=True)
    )
    small_m = np.nan_to_num(cloud.points_m[np.ix_(np.rint(v).astype(np.intp), np.rint(u).astype(np.intp))])
    odds, votes_m = _found(small_m)
    surface_m2 = small_m[..., 2] ** 2 * np.float32(
        _spacing(v) * _spacing(u) / (cloud.camera.fx * cloud.camera.fy)
    )
    if surface_m2.sum() <= MOST_PERSON_M2:
        odds += CUT_OUT_ODDS
    likely = (odds > 0) & (surface_m2 > 0)
    whose = np.zeros(odds.shape, np.uint8)
    whose[likely] = _by_votes(votes_m[likely], surface_m2[likely], odds[likely])
    odds[likely & (whose == 0)] = -1
    depth_m = np.nan_to_num(cloud.points_m[..., 2])
    owner = _enlarged(depth_m, np.ascontiguousarray(small_m[..., 2]), odds, whose, v, u)
    people = (owner == number for number in range(1, int(whose.max(initial=0)) + 1))
    return [_person(cloud, mask) for mask in people if mask.any()]


def _person(cloud: ThermalCloud, mask: Bool) -> Person:
    """The person of a mask (h, w)."""
    points = cloud.points_m[mask].astype(np.float64)
    area_m2 = float(np.sum(points[:, 2] ** 2)) / (cloud.camera.fx * cloud.camera.fy)
    return Person(mask, area_m2, points.mean(axis=0))


def _grid(side: int, focal_px: float) -> Float64:
    """Pixels (n,) of an image's side whose distance makes ``FOCAL_PX`` of its focal length, at least one."""
    step = max(focal_px / FOCAL_PX, 1.0)
    count = max(1, round(side / step))
    return np.asarray(((np.arange(count) + 0.5) * step - 0.5).clip(0, side - 1), np.float64)


def _spacing(grid: Float64) -> float:
    return float(grid[1] - grid[0]) if len(grid) > 1 else 1.0


def network_input(depth_m: Float32) -> Float32:
    """Input (3, h, w) of the network for depth (h, w) in metres, 0 = no reading: valid, log depth, local."""
    valid = (depth_m > 0).astype(np.float32)
    log = np.where(depth_m > 0, np.log(np.maximum(depth_m, 0.1)), 0).astype(np.float32)
    total, count = (
        cv2.blur(image, (LOCAL_PX, LOCAL_PX), borderType=cv2.BORDER_CONSTANT) for image in (log, valid)
    )
    local = np.clip((log - total / np.maximum(count, 1e-3)) * LOCAL_GAIN, -MOST_LOCAL, MOST_LOCAL)
    return np.stack([valid, log, local * valid]).astype(np.float32)


@cache
def _network() -> cv2.dnn.Net:
    model = files("annotate").joinpath("person/finder.onnx").read_bytes()
    return cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))


def _found(points_m: Float32) -> tuple[Float32, Float32]:
    """Log odds (h, w) and votes (h, w, 3) in the camera's frame, of points (h, w, 3) in metres, 0 = none."""
    height, width = points_m.shape[:2]
    image = np.pad(points_m[..., 2], ((0, -height % MULTIPLE), (0, -width % MULTIPLE)))
    with _AT_WORK:
        network = _network()
        network.setInput(network_input(image)[None])
        odds, right, down, away = network.forward()[0, :, :height, :width]
    # The network's votes lie beside the point at its depth, and behind or before that on the ray.
    z = np.maximum(points_m[..., 2], 0.1)
    ray = (z + away) / z
    x, y = points_m[..., 0] + right, points_m[..., 1] + down
    return odds.copy(), np.stack([x * ray, y * ray, z + away], axis=-1)


def _by_votes(votes_m: Float32, surface_m2: Float32, odds: Float32) -> UInt8:
    """Person (n,) of pixels, 1 and on, 0 = nobody, by votes (n, 3), surfaces (n,) and log odds (n,).

    A middle is a vote where votes are denser than anywhere within ``MIDDLES_M``; each other vote goes with
    the nearest denser one. Source: Rodriguez & Laio 2014, clustering by density peaks.
    """
    if not len(votes_m):
        return np.zeros(0, np.uint8)
    step = 1 + len(votes_m) // MOST_VOTES
    some, weight = votes_m[::step], surface_m2[::step] * step
    away_m = np.linalg.norm(some[:, None] - some, axis=-1)
    density = (np.exp(-0.5 * (away_m / VOTE_M) ** 2) * weight).sum(axis=1)
    rank = np.empty(len(some), np.intp)
    rank[np.argsort(-density, kind="stable")] = np.arange(len(some))
    denser_m = np.where(rank < rank[:, None], away_m, np.inf)
    leader = np.where(denser_m.min(axis=1) > MIDDLES_M, np.arange(len(some)), denser_m.argmin(axis=1))
    while (leader[leader] != leader).any():
        leader = leader[leader]
    _, person = np.unique(leader, return_inverse=True)
    area = np.bincount(person, weight)
    sure = np.bincount(person, weight * odds[::step]) >= SURE_ODDS * area
    kept = np.flatnonzero(sure & (area >= MIN_PERSON_M2))[:MOST_PERSONS]
    if not len(kept):
        return np.zeros(len(votes_m), np.uint8)
    # Votes that are no person by themselves are the nearest person's if one is near.
    among = np.flatnonzero(np.isin(person, kept))
    number = np.searchsorted(kept, person[among]) + 1
    nearest, near_m = _nearest(votes_m, some[among])
    return np.where(near_m < STRAY_M, number[nearest], 0).astype(np.uint8)


@njit(cache=True, nogil=True)
def _nearest(points: Float32, among: Float32) -> tuple[Index, Float32]:
    """Index (n,) of the nearest of points (m, 3) to each of points (n, 3), and the distances."""
    index, distance = np.zeros(len(points), np.intp), np.zeros(len(points), np.float32)
    for i in range(len(points)):
        least = np.inf
        for j in range(len(among)):
            gap = 0.0
            for axis in range(3):
                gap += (points[i, axis] - among[j, axis]) ** 2
            if gap < least:
                least, index[i] = gap, j
        distance[i] = np.sqrt(least)
    return index, distance


@njit(cache=True, nogil=True)
def _enlarged(
    depth_m: Float32, small_m: Float32, odds: Float32, whose: UInt8, rows: Float64, columns: Float64
) -> UInt8:
    """Person (h, w) of the pixels of a depth image by those of a small one, neighbours on one surface first.

    depth_m: (h, w), 0 = no reading. small_m, odds, whose: its depth, log odds and person at the pixels (rows,
    columns) of the whole image.
    """
    owner = np.zeros(depth_m.shape, np.uint8)
    row_step = (rows[-1] - rows[0]) / max(len(rows) - 1, 1) or 1.0
    column_step = (columns[-1] - columns[0]) / max(len(columns) - 1, 1) or 1.0
    for v in range(depth_m.shape[0]):
        y = (v - rows[0]) / row_step
        for u in range(depth_m.shape[1]):
            z, x = depth_m[v, u], (u - columns[0]) / column_step
            if z <= 0:
                continue
            total, most = 0.0, 0.0
            for down in range(2):
                for right in range(2):
                    r, c = int(np.floor(y)) + down, int(np.floor(x)) + right
                    share = (1.001 - abs(y - r)) * (1.001 - abs(x - c))
                    r, c = min(max(r, 0), len(rows) - 1), min(max(c, 0), len(columns) - 1)
                    if small_m[r, c] > 0:
                        weight = share * np.exp(-abs(small_m[r, c] - z) / (SAME_SURFACE * z))
                        total += weight * odds[r, c]
                        if whose[r, c] > 0 and weight > most:
                            most, owner[v, u] = weight, whose[r, c]
            if total <= 0:
                owner[v, u] = 0
    return owner
