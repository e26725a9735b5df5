"""Scores of the suit network without each input: ``python -m tools.measure.ablation SESSION.mcap...``.

Prints a Markdown table for each simulated session: scores without the input and an annotator's seconds a
frame. Brackets hold the paired 95 % interval of the change (Student's t over people).
"""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.correction.correction import Correction
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from annotate.person.warmth import WINDOW_C
from annotate.segmentation.input_channels import CHANNELS, FELT, LIKELIHOODS, OTHER, SEEN, SUBJECT, Rectangle
from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
from annotate.suit.palette import load_suit
from eval.compare.compare import Comparison, compare_sets
from eval.compare.difference import difference
from eval.compare.results import Result
from eval.scores.intervals import clusters_of, quantile
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

SHOWN = {
    "person_iou": ("person IoU", 1, 3),
    "mean_recall": ("mean recall", 1, 3),
    "boundary_f": ("boundary F, 2 px", 1, 3),
    "left_right_swap_rate": ("exchanged, %", 100, 2),
}
# Heading, factor and digits of the scores shown.
SECONDS = "annotator, s"
ALL, WINDOW = "all inputs", "the paper's window (25 to 35 °C)"
MIDDLE, FAR = 127, 255  # neutral bytes of a scaled channel: middle of its range; far from every plane


@dataclass(frozen=True)
class Silence:
    """Channels set to ``byte`` everywhere, and bits of the flags set to 0."""

    channels: tuple[str, ...] = ()
    byte: int = 0
    flags: int = 0

    def over(self, planes: UInt8) -> UInt8:
        """Return channels (24, h, w) without the silenced inputs."""
        silent = planes.copy()
        silent[0] &= np.uint8(255 - self.flags)
        silent[[CHANNELS.index(name) for name in self.channels]] = self.byte
        return silent


INPUTS = {
    "likeness to the suit's colours": Silence(LIKELIHOODS),
    "all colour": Silence(LIKELIHOODS, flags=SEEN),
    "shade and hue": Silence(("shade", "red", "green"), MIDDLE),
    "colours learnt of the room": Silence(("room",), MIDDLE),
    "temperature": Silence(flags=FELT),
    "planes of the room": Silence(("off_plane",), FAR),
    "depth against the person's": Silence(("depth",), MIDDLE),
    "depth against the surroundings": Silence(("local",), MIDDLE),
    "the rough outline": Silence(flags=SUBJECT | OTHER),
    "parts of the frame before": Silence(("before",)),
}
"""Silenced inputs by row of the table."""


class Without(SuitNetwork):
    """Shipped suit network without an input."""

    def __init__(self, silence: Silence) -> None:
        self.__setstate__(shipped_suit_network().__getstate__())
        self._silence = silence

    def probabilities(self, planes: UInt8, step: int, near: Rectangle | None = None) -> Float32:
        """Return probabilities by the remaining channels."""
        return super().probabilities(self._silence.over(planes), step, near)


@dataclass(frozen=True)
class Found:
    """Comparison of a session's labels; seconds: (F,), of an annotator for each frame compared."""

    scored: Comparison
    seconds: Float64


def labelled(path: Path, reader: SuitNetwork, window_c: tuple[float, float] | None = None) -> Found:
    """Label a simulated session by a network and measure the labels."""
    with tempfile.TemporaryDirectory() as folder:
        suit, truth = load_suit(suit_path(path)), LabelSet.open(truth_path(path))
        run = label_source(
            Session(path), SuitLabeller(suit, reader, window_c), Path(folder) / "l", lambda n: None
        )
        for frame_id, why in run.failed:
            print(f"frame {frame_id}: {why}", file=sys.stderr)
        scored, annotator = compare_sets(run.labels, truth), Annotator()
        with Correction.open(run.labels.path, WHO, clock=annotator.clock) as correction:
            done = list(correct_set(correction, truth, annotator, lambda frame_id: None))
        seconds = {one.corrected.frame_id: one.seconds for one in done}
    return Found(scored, np.array([seconds[frame_id] for frame_id in scored.frame_ids]))


def more_s(whole: Found, without: Found) -> tuple[float, float]:
    """Return the 95 % interval of the annotator's additional seconds a frame, over people."""
    both = sorted(set(whole.scored.frame_ids) & set(without.scored.frame_ids))
    of_frame = [dict(zip(one.scored.frame_ids, one.seconds, strict=True)) for one in (whole, without)]
    more = np.array([of_frame[1][frame_id] - of_frame[0][frame_id] for frame_id in both])
    subject = dict(zip(whole.scored.frame_ids, whole.scored.subjects, strict=True))
    owner = clusters_of([subject[frame_id] for frame_id in both])
    by_person = np.bincount(owner, more) / np.bincount(owner)
    people = len(by_person)
    half = float(by_person.std(ddof=1) / np.sqrt(people) * quantile(people - 1)) if people > 1 else np.nan
    return float(by_person.mean()) - half, float(by_person.mean()) + half


def row(name: str, whole: Found, without: Found) -> str:
    """Return a line of the table."""
    lost = difference(Result(ALL, whole.scored), Result(name, without.scored))
    cells = [name]
    for score, (_, factor, digits) in SHOWN.items():
        low, high = factor * lost.ci95[score]
        value = factor * without.scored.scores[score]
        cells.append(f"{value:.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]")
    low, high = more_s(whole, without)
    cells.append(f"{without.seconds.mean():.1f} [{low:+.1f}, {high:+.1f}]")
    return f"| {' | '.join(cells)} |"


def measured(path: Path) -> Iterator[tuple[str, Found]]:
    """Yield name and measurement of each row, with all inputs first."""
    yield ALL, labelled(path, shipped_suit_network())
    for name, silence in INPUTS.items():
        yield name, labelled(path, Without(silence))
    yield WINDOW, labelled(path, shipped_suit_network(), WINDOW_C)


def print_table(path: Path) -> None:
    """Print a session's table."""
    rows = measured(path)
    _, whole = next(rows)
    print(f"{path.stem}: {len(whole.scored.frame_ids)} frames of {whole.scored.n_subjects} people\n")
    print(f"| without | {' | '.join(heading for heading, _, _ in SHOWN.values())} | {SECONDS} |")
    print("|---|" + "---:|" * (len(SHOWN) + 1))
    scores = (f"{f * whole.scored.scores[name]:.{digits}f}" for name, (_, f, digits) in SHOWN.items())
    print(f"| {ALL} | {' | '.join(scores)} | {whole.seconds.mean():.1f} |", flush=True)
    for name, without in rows:
        print(row(name, whole, without), flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print_table(Path(name))
