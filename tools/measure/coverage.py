"""How often the 95 % intervals hold a known mean: simulated sets of several designs.

Run: python -m tools.measure.coverage [sets]. It prints, for each design, the share of the sets whose
interval holds the truth, the share where the truth lay below and above it, and, for comparison, the share
of the percentile interval over subjects then frames that this project had first.
"""

import sys
from dataclasses import dataclass

import numpy as np

from annotate.parts import N_CLASSES
from eval.scores import confusion, intervals

PIXELS = 1000


@dataclass(frozen=True)
class Design:
    """Frames of people whose hit rates scatter.

    subjects, frames: how many, and of each. level: a and b of the beta distribution of a person's hit rate;
    None where people are alike, at 0.8. scatter: a + b of the beta distribution of a frame's rate around
    its person's; None where frames are alike. uneven: 1 to 2 * frames - 1 frames of each.
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
        """One set: hits and pixels by frame (F, 2), and subjects."""
        sizes = (
            rng.integers(1, 2 * self.frames, self.subjects)
            if self.uneven
            else np.full(self.subjects, self.frames)
        )
        level = (
            np.full(self.subjects, self.mean) if self.level is None else rng.beta(*self.level, self.subjects)
        )
        rate = np.repeat(np.clip(level, 1e-6, 1 - 1e-6), sizes)
        if self.scatter is not None:
            rate = rng.beta(self.scatter * rate, self.scatter * (1 - rate))
        hits = rng.binomial(PIXELS, rate)
        owner = np.repeat(np.arange(self.subjects), sizes)
        return np.stack([hits, np.full(len(hits), PIXELS)], axis=-1), [str(i) for i in owner]


DESIGNS = {
    "2 people": Design(2, 18, (40, 10)),
    "3 people": Design(3, 18, (40, 10)),
    "4 people": Design(4, 18, (40, 10)),
    "5 people": Design(5, 18, (40, 10)),
    "8 people": Design(8, 18, (40, 10)),
    "15 people": Design(15, 10, (40, 10)),
    "40 people": Design(40, 5, (40, 10)),
    "100 people": Design(100, 2, (40, 10)),
    "8 people, most of them easy": Design(8, 18, (60, 2)),
    "8 people, very unlike": Design(8, 18, (9, 1)),
    "8 people, frames of each apart": Design(8, 18, (40, 10), scatter=10.0),
    "8 people, 1 to 35 frames of each": Design(8, 18, (40, 10), scatter=10.0, uneven=True),
    "8 people alike, frames apart": Design(8, 4, None, scatter=10.0),
    "8 people, a rare error": Design(8, 18, (0.5, 15)),
    "100 people alike, frames apart": Design(100, 3, None, scatter=10.0),
    "one person": Design(1, 60, None, scatter=10.0),
}


def rate(sums: np.ndarray) -> np.ndarray:
    return sums[..., 0] / sums[..., 1]


def ends(counts: np.ndarray, subjects: list[str], resamples: int, seed: int) -> np.ndarray:
    """The project's interval of one set: lower and upper."""
    sums = intervals.cluster_sums(counts, intervals.clusters_of(subjects))
    drawn = intervals.resampled_sums(sums, resamples, seed)
    return intervals.interval(rate(sums.sum(0)), rate(drawn), len(sums))


def percentile_ends(counts: np.ndarray, subjects: list[str], resamples: int, seed: int) -> np.ndarray:
    """Subjects drawn, then frames of each again; the resamples' 2.5th and 97.5th percentile."""
    rng = np.random.default_rng(seed)
    names, owner = np.unique(np.array(subjects), return_inverse=True)
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=resamples)
    sums = np.zeros((resamples, 2))
    for subject in range(len(names)):
        own = counts[owner == subject]
        sums += rng.multinomial(drawn[:, subject] * len(own), np.full(len(own), 1 / len(own))) @ own
    return np.quantile(rate(sums), [0.025, 0.975])


def trial(design: Design, sets: int, resamples: int, seed: int, interval=ends) -> tuple[float, float]:
    """Shares of the sets whose truth lies below and above the interval."""
    rng = np.random.default_rng(seed)
    below = above = 0
    for i in range(sets):
        low, high = interval(*design.draw(rng), resamples, i)
        below, above = below + (design.mean < low), above + (design.mean > high)
    return below / sets, above / sets


def coverage(design: Design, sets: int, resamples: int, seed: int) -> float:
    """Share of simulated sets whose interval holds the truth."""
    return 1 - sum(trial(design, sets, resamples, seed))


def miou_coverage(subjects: int, sets: int, resamples: int, seed: int) -> float:
    """Share of the sets whose interval of the mean IoU, a ratio of sums over parts, holds the true one.

    Each person has an error rate of their own in each part; what is wrong spreads over all classes alike.
    """
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


GAIN, GAIN_SD = 0.02, 0.02
"""Mean and scatter among people of what model A recalls more than model B."""


def paired_coverage(subjects: int, sets: int, resamples: int, seed: int) -> float:
    """Share of the sets whose interval of A minus B, on the same frames, holds `GAIN`."""
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
    """Share of the sets whose interval of the difference of two samples holds the true one, 0.1."""
    rng = np.random.default_rng(seed)
    designs = Design(subjects[0], 10, (45, 5)), Design(subjects[1], 10, (40, 10))
    covered = 0
    for i in range(sets):
        sums = [
            intervals.cluster_sums(c, intervals.clusters_of(who)) for c, who in (d.draw(rng) for d in designs)
        ]
        drawn = (
            rate(intervals.resampled_sums(sums[0], resamples, i)),
            rate(intervals.resampled_sums(sums[1], resamples, i)),
        )
        found = rate(sums[0].sum(0)) - rate(sums[1].sum(0))
        low, high = intervals.unpaired_interval(found, drawn, subjects)
        covered += low <= 0.1 <= high
    return covered / sets


def main(sets: int) -> None:
    print(f"{sets} sets of each design, {intervals.RESAMPLES} resamples, seed 1\n")
    print("| design | covered | truth below | truth above | percentile, subjects then frames |")
    print("|---|---|---|---|---|")
    for name, design in DESIGNS.items():
        below, above = trial(design, sets, intervals.RESAMPLES, 1)
        before = 1 - sum(trial(design, sets, intervals.RESAMPLES, 1, percentile_ends))
        print(f"| {name} | {1 - below - above:.3f} | {below:.3f} | {above:.3f} | {before:.3f} |", flush=True)
    for people in (4, 8, 40):
        found = miou_coverage(people, sets, intervals.RESAMPLES, 1)
        print(f"mean IoU, {people} people: {found:.3f}", flush=True)
    for people in (4, 8, 40):
        found = paired_coverage(people, sets, intervals.RESAMPLES, 1)
        print(f"model against model, {people} people: {found:.3f}", flush=True)
    for sizes in ((8, 8), (100, 8), (40, 40)):
        found = unpaired_coverage(sizes, sets, intervals.RESAMPLES, 1)
        print(f"different frames, {sizes[0]} people against {sizes[1]}: {found:.3f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 400)
