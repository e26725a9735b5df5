"""Coverage of the 95 % intervals on simulated sets: ``python -m tools.measure.coverage [SETS]``.

Prints for each design the share of the sets whose interval holds the true mean, and the shares with the truth
below and above.
"""

import sys
from dataclasses import dataclass

import numpy as np

from annotate.parts import N_CLASSES
from eval.scores import confusion, intervals

PIXELS = 1000
GAIN, GAIN_SD = 0.02, 0.02  # recall of model A above model B: mean and scatter over people


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
        a, b = self.level or (8.0, 2.0)
        return a / (a + b)

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
        """Draw a set: hits and pixels by frame (F, 2), and subjects."""
        n = self.subjects
        sizes = rng.integers(1, 2 * self.frames, n) if self.uneven else np.full(n, self.frames)
        level = np.full(n, self.mean) if self.level is None else rng.beta(*self.level, n)
        rates = np.repeat(np.clip(level, 1e-6, 1 - 1e-6), sizes)
        if self.scatter is not None:
            rates = rng.beta(self.scatter * rates, self.scatter * (1 - rates))
        hits = rng.binomial(PIXELS, rates)
        owner = np.repeat(np.arange(n), sizes)
        return np.stack([hits, np.full(len(hits), PIXELS)], axis=-1), [str(i) for i in owner]


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


def rate(sums: np.ndarray) -> np.ndarray:
    return sums[..., 0] / sums[..., 1]


def by_cluster(counts: np.ndarray, subjects: list[str]) -> np.ndarray:
    return intervals.cluster_sums(counts, intervals.clusters_of(subjects))


def trial(design: Design, sets: int, resamples: int, seed: int) -> tuple[float, float]:
    """Return the shares of the sets with the truth below and above the interval."""
    rng = np.random.default_rng(seed)
    below = above = 0
    for i in range(sets):
        sums = by_cluster(*design.draw(rng))
        drawn = intervals.resampled_sums(sums, resamples, i)
        low, high = intervals.interval(rate(sums.sum(0)), rate(drawn), len(sums))
        below, above = below + (design.mean < low), above + (design.mean > high)
    return below / sets, above / sets


def coverage(design: Design, sets: int, resamples: int, seed: int) -> float:
    """Return the share of simulated sets whose interval holds the truth."""
    return 1 - sum(trial(design, sets, resamples, seed))


def miou_coverage(subjects: int, sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of the mean IoU's interval, with an error rate by person and part."""
    rng = np.random.default_rng(seed)
    pixels = np.array([40_000, *np.linspace(300, 3000, N_CLASSES - 1)])

    def matrix_of(errors: np.ndarray) -> np.ndarray:
        right = np.eye(N_CLASSES) * (1 - errors)[..., None]
        return pixels[:, None] * (right + errors[..., None] / N_CLASSES)

    a, b = np.linspace(2, 6, N_CLASSES), np.full(N_CLASSES, 20.0)
    truth = confusion.miou(np.rint(1000 * matrix_of(a / (a + b))).astype(np.int64))
    covered = 0
    for i in range(sets):
        sums = np.rint(matrix_of(rng.beta(a, b, (subjects, N_CLASSES)))).astype(np.int64)
        drawn = intervals.resampled_sums(sums.reshape(subjects, -1), resamples, i)
        resampled = confusion.miou(drawn.reshape(-1, N_CLASSES, N_CLASSES))
        low, high = intervals.interval(confusion.miou(sums.sum(0)), resampled, subjects)
        covered += bool(low <= truth <= high)
    return covered / sets


def paired_coverage(subjects: int, sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of the interval of A minus B on the same frames."""
    rng = np.random.default_rng(seed)
    covered = 0
    for i in range(sets):
        level = rng.beta(40, 10, subjects)
        gain = rng.normal(GAIN, GAIN_SD, subjects)
        hits = [rng.binomial(18 * PIXELS, np.clip(rates, 0, 1)) for rates in (level, level - gain)]
        sums = np.stack([*hits, np.full(subjects, 18 * PIXELS)], axis=-1)
        drawn = intervals.resampled_sums(sums, resamples, i)
        apart, found = ((s[..., 0] - s[..., 1]) / s[..., 2] for s in (drawn, sums.sum(0)))
        low, high = intervals.paired_interval(found, apart, subjects)
        covered += low <= GAIN <= high
    return covered / sets


def unpaired_coverage(subjects: tuple[int, int], sets: int, resamples: int, seed: int) -> float:
    """Return the coverage of the interval of a difference of two samples; the true one is 0.1."""
    rng = np.random.default_rng(seed)
    designs = Design(subjects[0], 10, (45, 5)), Design(subjects[1], 10, (40, 10))
    covered = 0
    for i in range(sets):
        a, b = (by_cluster(*design.draw(rng)) for design in designs)
        drawn = [rate(intervals.resampled_sums(sums, resamples, i)) for sums in (a, b)]
        low, high = intervals.unpaired_interval(rate(a.sum(0)) - rate(b.sum(0)), drawn, subjects)
        covered += low <= 0.1 <= high
    return covered / sets


def main(sets: int) -> None:
    resamples = intervals.RESAMPLES
    print(f"{sets} sets of each design, {resamples} resamples, seed 1\n")
    print("| design | covered | truth below | truth above |\n|---|---|---|---|")
    for name, design in DESIGNS.items():
        below, above = trial(design, sets, resamples, 1)
        print(f"| {name} | {1 - below - above:.3f} | {below:.3f} | {above:.3f} |", flush=True)
    for people in (4, 8, 40):
        print(f"mean IoU, {people} people: {miou_coverage(people, sets, resamples, 1):.3f}", flush=True)
        print(f"A minus B, same frames: {paired_coverage(people, sets, resamples, 1):.3f}", flush=True)
    for sizes in ((8, 8), (100, 8), (40, 40)):
        found = unpaired_coverage(sizes, sets, resamples, 1)
        print(f"different frames, {sizes[0]} people against {sizes[1]}: {found:.3f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 400)
