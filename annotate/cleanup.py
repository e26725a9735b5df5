"""Clean-up of part labels: fill holes, remove islands, list the parts beside a selection."""

import cv2
import numpy as np

from annotate.array_types import Float32, Int32, Int64, UInt8, UInt16
from annotate.cloud.grid import JUMP, components
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme

MOST_HOLE_PX = 400  # above it, something else is seen through the hole; untuned
LEAST_PIECE_PX = 120  # below it, a piece of a part is an island: 6 cm at 2 m; untuned
HOLE_DEPTH = 0.03  # largest difference of a hole's mean depth to its rim's, share; untuned


def filled(parts: UInt8, depth_mm: UInt16, part: int) -> UInt8:
    """Return labels uint8 (h, w) with the holes of one part filled.

    A hole is at most ``MOST_HOLE_PX`` connected pixels of other labels at the part's depth, off the image's
    border. Only the part and pixels without depth surround it, mostly the part.
    """
    valid = depth_mm > 0
    mask = valid & (parts == part)
    other = valid & ~mask
    count, labels, stats, _ = cv2.connectedComponentsWithStats(other.astype(np.uint8), connectivity=8)
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    right, bottom = left + stats[:, cv2.CC_STAT_WIDTH], top + stats[:, cv2.CC_STAT_HEIGHT]
    inside = (left > 0) & (top > 0) & (right < parts.shape[1]) & (bottom < parts.shape[0])
    inside &= stats[:, cv2.CC_STAT_AREA] <= MOST_HOLE_PX
    inside[0] = False
    pixels = np.flatnonzero(inside[labels])
    hole = labels.ravel()[pixels]
    depth = depth_mm.ravel().astype(np.float64)
    touching, bare, rim_mm = np.zeros(count), np.zeros(count), np.zeros(count)
    for beside in _beside(pixels, parts.shape, 1):
        is_part = mask.ravel()[beside]
        touching += np.bincount(hole, is_part, count)
        bare += np.bincount(hole, ~valid.ravel()[beside], count)
        rim_mm += np.bincount(hole, np.where(is_part, depth[beside], 0), count)
    hole_mm = np.bincount(hole, depth[pixels], count) / np.maximum(np.bincount(hole, None, count), 1)
    rim_mm /= np.maximum(touching, 1)
    is_hole = inside & (touching > bare) & (np.abs(hole_mm - rim_mm) <= HOLE_DEPTH * rim_mm)
    result = parts.copy()
    result.reshape(-1)[pixels[is_hole[hole]]] = part
    return result


def without_islands(parts: UInt8, depth_mm: UInt16) -> UInt8:
    """Return labels uint8 (h, w) with the small islands of every part relabelled.

    An island is a piece under ``LEAST_PIECE_PX`` pixels, except the largest piece of its part. It takes the
    label that it touches most at its depth; if none, background.
    """
    depth_m = depth_mm.astype(np.float32) / np.float32(1000)
    flat_m = depth_m.ravel()
    labels = np.flatnonzero(np.bincount(parts.ravel(), minlength=256))
    index = np.searchsorted(labels, np.arange(256))
    islands, count = _islands(
        parts, depth_m, [i for i in labels.tolist() if i not in (BACKGROUND, UNDEFINED)]
    )
    result = parts.copy()
    pending = np.flatnonzero(islands)
    while len(pending):
        island = islands.ravel()[pending]
        votes = np.zeros(count * len(labels), np.int64)
        for beside in _beside(pending, parts.shape, 2):
            near = np.abs(flat_m[beside] - flat_m[pending]) <= JUMP * flat_m[pending]
            near &= islands.ravel()[beside] == 0
            ballot = island * len(labels) + index[result.ravel()[beside]]
            votes += np.bincount(ballot[near], None, len(votes))
        by_label = votes.reshape(count, len(labels))
        winner = np.where(by_label.any(axis=1), labels[by_label.argmax(axis=1)], -1)[island]
        settled = winner >= 0
        if not settled.any():
            result.reshape(-1)[pending] = BACKGROUND
            break
        result.reshape(-1)[pending[settled]] = winner[settled]
        islands.reshape(-1)[pending[settled]] = 0
        pending = pending[~settled]
    return result


def neighbours(parts: UInt8, pixels: Int64, scheme: Scheme) -> list[int]:
    """Return the labels to offer for flat indices ``pixels``: touching parts, longest contact first, then
    parts that ``scheme`` calls neighbours, then background.

    The pixels' most frequent label and undefined are left out.
    """
    if not len(pixels):
        return []
    own = int(np.bincount(parts.ravel()[pixels]).argmax())
    outside = np.ones(parts.size, np.bool_)
    outside[pixels] = False
    contact = np.zeros(256, np.int64)
    for beside in _beside(pixels, parts.shape, 2):
        contact += np.bincount(parts.ravel()[beside[outside[beside]]], None, 256)
    contact[[BACKGROUND, UNDEFINED]] = 0
    touched = [int(p) for p in np.argsort(-contact, kind="stable") if contact[p]]
    joined = sorted(p for pair in scheme.neighbours if own in pair for p in pair)
    order = dict.fromkeys([*touched, *joined, BACKGROUND])
    return [p for p in order if p not in (own, UNDEFINED)]


def _islands(parts: UInt8, depth_m: Float32, among: list[int]) -> tuple[Int32, int]:
    """Return the ids of small islands, int32 (h, w) from 1, 0 elsewhere, and the highest id plus 1. among:
    part ids to search.
    """
    islands, count = np.zeros(parts.shape, np.int32), 1
    for part in among:
        mask = (parts == part) & (depth_m > 0)
        left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
        window = np.s_[top : top + height, left : left + width]
        pieces, n = components(mask[window], depth_m[window])
        sizes = np.bincount(pieces.ravel(), minlength=n + 1)
        small = sizes < LEAST_PIECE_PX
        small[[0, 1 + int(sizes[1:].argmax()) if n else 0]] = False
        numbers = np.where(small, np.cumsum(small) + count - 1, 0)
        islands[window] += numbers[pieces].astype(np.int32)
        count += int(small.sum())
    return islands, count


def _beside(pixels: Int64, shape: tuple[int, ...], reach: int) -> list[Int64]:
    """Return the neighbours of flat indices ``pixels`` (n,) as flat indices, one array (n,) for each offset
    up to ``reach``; clipped at the border.
    """
    v, u = np.divmod(pixels, shape[1])
    steps = range(-reach, reach + 1)
    return [
        np.clip(v + dv, 0, shape[0] - 1) * shape[1] + np.clip(u + du, 0, shape[1] - 1)
        for dv in steps
        for du in steps
        if (dv, du) != (0, 0)
    ]
