"""Coverage of the 95 % intervals on simulated sets: ``python -m tools.measure.coverage [SETS]``."""

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.parts import N_CLASSES
from eval.scores import confusion, intervals

PIXELS = 1000
GAIN, GAIN_SD = 0.02, 0.02  # recall of model A above model B: mean and scatter over people
Draw = Callable[[np.random.Generator, int], tuple[float, Float64]]
"""Function of a generator and a set's number to the true value and the interval."""


@dataclass(frozen=True)
class Design:
    """Frames of people with scattered hit rates.

    frames: of each person; uneven: 1 to 2 * frames - 1. level: a and b of the beta distribution of a person's
    hit rate; None: 0.8 for all. scatter: a + b of the beta distribution of a frame's rate around the person's
    rate; None: equal frames.
    """

    subjects: int
    frames: int
    level: tuple[float, float] | None
    scatter: float | None = None
    uneven: bool = False

    @property
    def mean(self) -> float:
        """Return the true hit rate."""
        a, b = self.level or (8.0, 2.0)
        return a / (a + b)

    def sums(self, rng: np.random.Generator) -> Int64:
        """Draw a set: hits and pixels by cluster (C, 2)."""
        n = self.subjects
        sizes = rng.integers(1, 2 * self.frames, n) if self.uneven else np.full(n, self.frames)
        level = np.full(n, self.mean) if self.level is None else rng.beta(*self.level, n)
        rates = np.repeat(np.clip(level, 1e-6, 1 - 1e-6), sizes)
        if self.scatter is not None:
            rates = rng.beta(self.scatter * rates, self.scatter * (1 - rates))
        hits, owner = rng.binomial(PIXELS, rates), np.repeat(np.arange(n), sizes)
        counts = np.stack([hits, np.full(len(hits), PIXELS)], axis=-1)
        return intervals.cluster_sums(counts, intervals.clusters_of([str(i) for i in owner]))


DESIGNS = {
    "2 people": Design(2, 18, (40, 10)),
    "4 people": Design(4, 18, (40, 10)),
    "8 people": Design(8, 18, (40, 10)),
    "40 people": Design(40, 5, (40, 10)),
    "100 people": Design(100, 2, (40, 10)),
    "8 people, most of them easy": Design(8, 18, (60, 2)),
    "8 people, very unlike": Design(8, 18, (9, 1)),
    "8 people, unlike frames": Design(8, 18, (40, 10), scatter=10.0),
    "8 people, 1 to 35 frames of each": Design(8, 18, (40, 10), scatter=10.0, uneven=True),
    "8 people alike, unlike frames": Design(8, 4, None, scatter=10.0),
    "8 people, a rare error": Design(8, 18, (0.5, 15)),
    "one person": Design(1, 60, None, scatter=10.0),
}


def covered(draw: Draw, sets: int, seed: int) -> float:
    """Return the share of simulated sets whose interval holds the truth."""
    rng, held = np.random.default_rng(seed), 0
    for number in range(sets):
        truth, (low, high) = draw(rng, number)
        held += bool(low <= truth <= high)
    return held / sets


def rate(sums: Int64) -> Float64:
    """Return the hit rate of sums (..., 2)."""
    return np.asarray(sums[..., 0] / sums[..., 1])


def coverage(design: Design, sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of a rate's interval."""

    def draw(rng: np.random.Generator, number: int) -> tuple[float, Float64]:
        sums = design.sums(rng)
        drawn = rate(intervals.resampled_sums(sums, resamples, number))
        return design.mean, intervals.interval(rate(sums.sum(0)), drawn, len(sums))

    return covered(draw, sets, seed)


def miou_coverage(subjects: int, sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of the mean IoU's interval, with an error rate by person and part."""
    pixels = np.array([40_000, *np.linspace(300, 3000, N_CLASSES - 1)])
    a, b = np.linspace(2, 6, N_CLASSES), np.full(N_CLASSES, 20.0)

    def matrix_of(errors: Float64, scale: int = 1) -> Int64:
        right = np.eye(N_CLASSES) * (1 - errors)[..., None]
        return np.rint(scale * pixels[:, None] * (right + errors[..., None] / N_CLASSES)).astype(np.int64)

    truth = float(confusion.miou(matrix_of(a / (a + b), 1000)))

    def draw(rng: np.random.Generator, number: int) -> tuple[float, Float64]:
        sums = matrix_of(rng.beta(a, b, (subjects, N_CLASSES)))
        drawn = intervals.resampled_sums(sums.reshape(subjects, -1), resamples, number)
        resampled = confusion.miou(drawn.reshape(-1, N_CLASSES, N_CLASSES))
        return truth, intervals.interval(confusion.miou(sums.sum(0)), resampled, subjects)

    return covered(draw, sets, seed)


def paired_coverage(subjects: int, sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of the interval of A minus B on the same frames."""

    def draw(rng: np.random.Generator, number: int) -> tuple[float, Float64]:
        level, gain = rng.beta(40, 10, subjects), rng.normal(GAIN, GAIN_SD, subjects)
        hits = [rng.binomial(18 * PIXELS, np.clip(rates, 0, 1)) for rates in (level, level - gain)]
        sums = np.stack([*hits, np.full(subjects, 18 * PIXELS)], axis=-1)
        drawn = intervals.resampled_sums(sums, resamples, number)
        apart, found = ((s[..., 0] - s[..., 1]) / s[..., 2] for s in (drawn, sums.sum(0)))
        return GAIN, intervals.paired_interval(found, apart, subjects)

    return covered(draw, sets, seed)


def unpaired_coverage(subjects: tuple[int, int], sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of the interval of a difference of two samples; the true one is 0.1."""
    designs = Design(subjects[0], 10, (45, 5)), Design(subjects[1], 10, (40, 10))

    def draw(rng: np.random.Generator, number: int) -> tuple[float, Float64]:
        a, b = (design.sums(rng) for design in designs)
        drawn = [rate(intervals.resampled_sums(sums, resamples, number)) for sums in (a, b)]
        return 0.1, intervals.unpaired_interval(rate(a.sum(0)) - rate(b.sum(0)), drawn, subjects)

    return covered(draw, sets, seed)


if __name__ == "__main__":
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    for name, design in DESIGNS.items():
        print(f"{name}: {coverage(design, sets, intervals.RESAMPLES, 1):.3f}", flush=True)
