"""Compiled kernels over a frame's pixels.

Images are C-contiguous and of one shape (h, w): label maps uint8, distances float32. classes: length of a
scheme's arrays by part id.
"""

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int64, UInt8, UInt16
from annotate.scheme.scheme import BACKGROUND, UNDEFINED

CODES = 256  # values of a byte


@njit(cache=True, nogil=True)
def pairs(truth: UInt8, predicted: UInt8, code: UInt16, codes: int) -> Int64:
    """Count pixels by the codes of both labels: int64 (codes, codes). code (256,): of each label."""
    counts = np.zeros((codes, codes), np.int64)
    # Runs of equal pixels are counted once: most pixels repeat the pixel before.
    last, drawn, run = np.uint8(BACKGROUND), np.uint8(BACKGROUND), 0
    for a, b in zip(truth.flat, predicted.flat):  # noqa: B905 (numba lacks strict)
        if a != last or b != drawn:
            counts[code[last], code[drawn]] += run
            last, drawn, run = a, b, 0
        run += 1
    counts[code[last], code[drawn]] += run
    return counts


@njit(cache=True, nogil=True)
def _on_part(part: np.uint8) -> bool:
    return bool(part != BACKGROUND and part != UNDEFINED)


@njit(cache=True, nogil=True)
def borders(labels: UInt8) -> UInt8:
    """Return part ids on border pixels, 0 elsewhere: (h, w); see ``eval.scores.boundary``."""
    height, width = labels.shape
    found = np.zeros((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            own = labels[v, u]
            if not _on_part(own):
                continue
            for i, j in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                if not (0 <= i < height and 0 <= j < width):
                    continue
                other = labels[i, j]
                if other != own and other != UNDEFINED:
                    found[v, u] = own
    return found


@njit(cache=True, nogil=True)
def distances(labels: UInt8, border: UInt8, reach: float, around: float) -> Float32:
    """Return the distance of every pixel to the nearest border pixel: float32 (h, w), Euclidean, pixels.

    border: part ids as ``borders`` returns them. Distances above a limit are infinite: the limit is ``reach``
    for pixels of parts, ``around`` for all others.
    """
    height, width = labels.shape
    # Distances along the columns first, then along each row up to the best distance.
    below = np.full((height, width), np.int64(max(reach, around)) + 1)
    for v in range(height):
        for u in range(width):
            if border[v, u]:
                below[v, u] = 0
            elif v:
                below[v, u] = below[v - 1, u] + 1
    for v in range(height - 2, -1, -1):
        for u in range(width):
            below[v, u] = min(below[v, u], below[v + 1, u] + 1)
    away = np.full((height, width), np.inf, np.float32)
    for v in range(height):
        for u in range(width):
            most = reach if _on_part(labels[v, u]) else around
            best = below[v, u] * below[v, u]
            for step in range(1, min(int(most), max(u, width - 1 - u)) + 1):
                if step * step >= best:
                    break
                for other in (max(u - step, 0), min(u + step, width - 1)):
                    best = min(best, below[v, other] * below[v, other] + step * step)
            if best <= most * most:
                away[v, u] = np.sqrt(np.float32(best))
    return away


@njit(cache=True, nogil=True)
def bands(
    truth: UInt8, predicted: UInt8, distances: tuple[Float32, Float32], widths: Float32, classes: int
) -> Int64:
    """Count pixels of both, of the truth's and of the prediction's band: int64 (W, classes, 3).

    distances: to the borders of truth and prediction; widths (W,).
    """
    counts = np.zeros((len(widths), classes, 3), np.int64)
    of_truth, of_prediction = distances
    for a, b, away, off in zip(truth.flat, predicted.flat, of_truth.flat, of_prediction.flat):  # noqa: B905
        true, drawn = _on_part(a), _on_part(b)
        if not (true or drawn):
            continue
        for i in range(len(widths)):
            inside, within = true and away < widths[i], drawn and off < widths[i]
            if inside:
                counts[i, a, 1] += 1
            if within:
                counts[i, b, 2] += 1
            if inside and within and a == b:
                counts[i, a, 0] += 1
    return counts


@njit(cache=True, nogil=True)
def errors(truth: UInt8, predicted: UInt8, away: Float32, edges: Float32, classes: int) -> Int64:
    """Count wrong and all pixels of parts by true part and distance: int64 (classes, E + 1, 2).

    away: to the borders of the truth. edges (E,): exclusive upper ends of the bins.
    """
    counts = np.zeros((classes, len(edges) + 1, 2), np.int64)
    for a, b, distance in zip(truth.flat, predicted.flat, away.flat):  # noqa: B905
        if _on_part(a):
            where = 0
            while where < len(edges) and distance >= edges[where]:
                where += 1
            counts[a, where, 1] += 1
            counts[a, where, 0] += a != b
    return counts


@njit(cache=True, nogil=True)
def confidences(truth: UInt8, predicted: UInt8, confidence: Float32, near: Bool, classes: int) -> Int64:
    """Count pixels by true part, right (0 or 1), near (0 or 1) and confidence: (classes, 2, 2, 256).

    Confidence in steps of 1/255, rounded; only pixels with a predicted part and a defined truth.
    """
    counts = np.zeros((classes, 2, 2, CODES), np.int64)
    for a, b, sure, close in zip(truth.flat, predicted.flat, confidence.flat, near.flat):  # noqa: B905
        if a != UNDEFINED and _on_part(b):
            level = int(np.rint(min(max(sure, np.float32(0)), np.float32(1)) * np.float32(255)))
            counts[a, np.int64(a == b), np.int64(close), level] += 1
    return counts


@njit(cache=True, nogil=True)
def apart(border: UInt8, other: UInt8, reach: float) -> Float64:
    """Return the distance of each border pixel, by rows, to the nearest of its part in the other map.

    float64 (n,), Euclidean, pixels; infinite if above ``reach``. border, other: part ids as ``borders``
    returns them.
    """
    height, width = border.shape
    found, n = np.full(np.count_nonzero(border), np.inf), 0
    for v in range(height):
        for u in range(width):
            part = border[v, u]
            if part == BACKGROUND:
                continue
            best, ring = reach * reach, 0
            # A pixel of a ring is at least as far as the ring's number.
            while ring * ring <= best:
                for i in range(max(v - ring, 0), min(v + ring, height - 1) + 1):
                    step = 1 if abs(i - v) == ring else max(2 * ring, 1)
                    for j in range(u - ring, u + ring + 1, step):
                        if 0 <= j < width and other[i, j] == part:
                            squared = (i - v) ** 2 + (j - u) ** 2
                            if squared <= best:
                                best = float(squared)
                                found[n] = np.sqrt(best)
                ring += 1
            n += 1
    return found
