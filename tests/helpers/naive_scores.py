"""Every score from the pixels of a few frames, by loops."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from annotate.parts import LEFT_RIGHT, N_CLASSES, UNDEFINED
from eval.scores.boundary import DISTANCE_EDGES_PX, TOLERANCES_MM, TOLERANCES_PX, WIDTHS_MM, WIDTHS_PX
from eval.scores.counts import NEAR_PX, FrameCounts, shapes

BODY = range(1, N_CLASSES)
TWIN = {a: b for pair in LEFT_RIGHT for a, b in (pair, pair[::-1])}


@dataclass
class Frame:
    """One frame: part ids (h, w), confidence (h, w) or None, millimetres per pixel or NaN."""

    truth: np.ndarray
    predicted: np.ndarray
    confidence: np.ndarray | None
    mm_per_px: float


def by_name(counts: FrameCounts) -> dict[str, np.ndarray]:
    """The arrays of counts by name."""
    return {name: getattr(counts, name) for name in shapes(counts.scheme.n_classes)}


@dataclass
class Pixel:
    true: int
    guess: int
    away: float  # from the truth's borders
    guess_away: float  # from the prediction's
    level: int | None  # confidence in 1/255
    mm_per_px: float


def share(part: float, whole: float) -> float:
    return part / whole if whole else math.nan


def mean(values: list[float]) -> float:
    known = [v for v in values if not math.isnan(v)]
    return share(sum(known), len(known))


def seen(frame: Frame) -> np.ndarray:
    """The prediction with its undefined pixels as background, undefined where the truth is."""
    labels = frame.predicted.copy()
    for at, part in np.ndenumerate(frame.predicted):
        if part == UNDEFINED:
            labels[at] = 0
        if frame.truth[at] == UNDEFINED:
            labels[at] = UNDEFINED
    return labels


def edge(labels: np.ndarray) -> list[tuple[int, int, int]]:
    """Row, column and part of the border pixels."""
    height, width = labels.shape
    found = []
    for (v, u), part in np.ndenumerate(labels):
        around = [(v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)]
        inside = [labels[y, x] for y, x in around if 0 <= y < height and 0 <= x < width]
        if part not in (0, UNDEFINED) and any(other not in (part, UNDEFINED) for other in inside):
            found.append((v, u, int(part)))
    return found


def nearest(v: int, u: int, points: list[tuple[int, int, int]], part: int | None = None) -> float:
    gaps = [math.hypot(v - y, u - x) for y, x, p in points if part in (None, p)]
    return min(gaps, default=math.inf)


def pixels_of(frame: Frame) -> list[Pixel]:
    guess = seen(frame)
    borders, drawn = edge(frame.truth), edge(guess)
    pixels = []
    for (v, u), true in np.ndenumerate(frame.truth):
        if true != UNDEFINED:
            level = None if frame.confidence is None else round(float(frame.confidence[v, u]) * 255)
            away = nearest(v, u, borders), nearest(v, u, drawn)
            pixels.append(Pixel(int(true), int(guess[v, u]), *away, level, frame.mm_per_px))
    return pixels


def recalls(pixels: list[Pixel], parts: range = range(N_CLASSES)) -> list[float]:
    own = {c: [p for p in pixels if p.true == c] for c in parts}
    return [share(sum(p.guess == c for p in own[c]), len(own[c])) for c in parts]


def ious(pixels: list[Pixel], parts: range = range(N_CLASSES)) -> list[float]:
    return [
        share(sum(p.true == p.guess == c for p in pixels), sum(c in (p.true, p.guess) for p in pixels))
        for c in parts
    ]


def error_rate(pixels: list[Pixel]) -> float:
    person = [p for p in pixels if p.true]
    return share(sum(p.true != p.guess for p in person), len(person))


def f_at(frames: list[Frame], tolerance: float, in_mm: bool) -> float:
    near = drawn = met = true = 0
    for frame in frames:
        reach = tolerance / frame.mm_per_px if in_mm else tolerance
        if math.isnan(reach):
            continue
        ours, theirs = edge(seen(frame)), edge(frame.truth)
        near += sum(nearest(v, u, theirs, part) <= reach for v, u, part in ours)
        met += sum(nearest(v, u, ours, part) <= reach for v, u, part in theirs)
        drawn, true = drawn + len(ours), true + len(theirs)
    if not drawn + true:
        return math.nan
    precise, recalled = near / max(drawn, 1), met / max(true, 1)
    return 2 * precise * recalled / (precise + recalled) if precise + recalled else 0.0


def band_ious(pixels: list[Pixel], width: float, in_mm: bool) -> list[float]:
    scores = [math.nan]
    for c in BODY:
        both = either = 0
        for p in pixels:
            reach = width / p.mm_per_px if in_mm else width
            ours, theirs = p.guess == c and p.guess_away < reach, p.true == c and p.away < reach
            both, either = both + (ours and theirs), either + (ours or theirs)
        scores.append(share(both, either))
    return scores


def by_distance(pixels: list[Pixel]) -> list[float]:
    edges = (0.0, *DISTANCE_EDGES_PX, math.inf)
    bins = [[p for p in pixels if low <= p.away < high] for low, high in pairwise(edges)]
    bins[-1] += [p for p in pixels if p.away == math.inf]
    return [error_rate(chosen) for chosen in bins]


def calibration_error(pixels: list[Pixel]) -> float:
    told = [p for p in pixels if p.guess and p.level is not None]
    total = 0.0
    for b in range(15):
        own = [p for p in told if min(p.level * 15 // 255, 14) == b]
        total += abs(sum(p.true == p.guess for p in own) - sum(p.level for p in own) / 255)
    return share(total, len(told))


def scores(frames: list[Frame]) -> dict[str, object]:
    """Return every score of `eval.scores.scores.scores_of` for the sum of these frames."""
    pixels = [p for frame in frames for p in pixels_of(frame)]
    near = [p for p in pixels if p.away < NEAR_PX]
    inside = [p for p in pixels if p.away >= NEAR_PX]
    person = [p for p in pixels if p.true and p.guess]
    limbs = [p for p in pixels if p.true in TWIN]
    merged = [Pixel(*(min(c, TWIN.get(c, c)) for c in (p.true, p.guess)), 0, 0, None, 0) for p in pixels]
    either = sum(bool(p.true or p.guess) for p in pixels)
    drawn = [sum(p.guess == c for p in pixels) for c in range(N_CLASSES)]
    size = [sum(p.true == c for p in pixels) for c in range(N_CLASSES)]
    hit = [sum(p.true == p.guess == c for p in pixels) for c in range(N_CLASSES)]
    return {
        "mean_recall": mean(recalls(pixels, BODY)),
        "miou": mean(ious(pixels, BODY)),
        "person_iou": share(len(person), either),
        "left_right_swap_rate": share(sum(p.guess == TWIN[p.true] for p in limbs), len(limbs)),
        "mean_recall_inside": mean(recalls(inside, BODY)),
        "mean_recall_near": mean(recalls(near, BODY)),
        "error_rate_inside": error_rate(inside),
        "error_rate_near": error_rate(near),
        "mean_recall_person": mean(recalls(person, BODY)),
        "miou_person": mean(ious(person, BODY)),
        "mean_recall_all": mean(recalls(pixels)),
        "miou_all": mean(ious(pixels)),
        "miou_merged": mean(ious(merged, BODY)),
        "recall": recalls(pixels),
        "precision": [share(hit[c], drawn[c]) for c in range(N_CLASSES)],
        "iou": ious(pixels),
        "dice": [share(2 * hit[c], drawn[c] + size[c]) for c in range(N_CLASSES)],
        "boundary_f": f_at(frames, 2.0, False),
        "boundary_iou": mean(band_ious(pixels, 4.0, False)),
        "boundary_iou_by_part": band_ious(pixels, 4.0, False),
        "boundary_f_px": [f_at(frames, t, False) for t in TOLERANCES_PX],
        "boundary_f_mm": [f_at(frames, t, True) for t in TOLERANCES_MM],
        "boundary_iou_px": [mean(band_ious(pixels, w, False)) for w in WIDTHS_PX],
        "boundary_iou_mm": [mean(band_ious(pixels, w, True)) for w in WIDTHS_MM],
        "error_by_distance": by_distance(pixels),
        "error_by_distance_by_part": [
            by_distance([p for p in pixels if p.true == c]) if c else [math.nan] * 7 for c in range(N_CLASSES)
        ],
        "ece": calibration_error(pixels),
        "ece_near": calibration_error(near),
    }
