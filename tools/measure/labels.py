"""Measure labels by the suit against the truth of simulated sessions; prints a Markdown table.

python -m tools.measure.labels SESSION.mcap...
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.supervoxels import Supervoxels, supervoxels
from annotate.effort.agreement import Agreement
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.suit.palette import load_suit
from eval.compare.compare import compare_sets
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

BINS = 15
AGREED = 0.99
FIRST_SHARE, SEED_M = 0.3, 0.05
"""Share of the supervoxels looked at first; metres between their seeds, as a forearm is 7 cm thick."""


@dataclass(frozen=True)
class Reliability:
    """Confidence and rightness of labelled pixels (n,), and the share of a set's wrong pixels that lie in
    the supervoxels looked at first."""

    confidence: np.ndarray
    right: np.ndarray
    found_first: float

    @property
    def ece(self) -> float:
        """Expected calibration error (Guo et al. 2017), pixel by pixel, equal bins."""
        bins = np.minimum((self.confidence * BINS).astype(int), BINS - 1)
        gaps = np.bincount(bins, self.confidence - self.right, BINS)
        return float(np.abs(gaps).sum() / len(bins))


def worst_first(confidence: np.ndarray, groups: Supervoxels) -> np.ndarray:
    """Supervoxels (G,), most expected wrong pixels first; confidence: (n,), of the points."""
    return np.argsort(-(1 - groups.mean(confidence)) * groups.sizes, kind="stable")


def reliability(labels: LabelSet, truth: LabelSet, session: Session) -> Reliability:
    """How far the confidence of a session's labels is to be believed."""
    fuser = Fuser(session.calibration)
    rows, found, wrong_all = [], 0, 0
    for frame in session:
        guess, known = labels.read(f"{frame.index:06d}"), truth.read(f"{frame.index:06d}").parts
        named = (guess.parts != BACKGROUND) & (guess.parts != UNDEFINED)
        if not named.any():
            continue
        right, counted = (guess.parts == known)[named], (known != UNDEFINED)[named]
        rows.append((guess.confidence[named][counted], right[counted]))
        cloud = fuser.fuse_frame(frame)
        groups = supervoxels(cloud.points_m[named], cloud.color_rgb[named], seed_m=SEED_M)
        wrong = np.bincount(groups.ids, counted & ~right, groups.count)
        order = worst_first(guess.confidence[named], groups)
        found += wrong[order[: int(np.ceil(FIRST_SHARE * groups.count))]].sum()
        wrong_all += wrong.sum()
    confidence, right = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Reliability(confidence, right, found / max(wrong_all, 1))


def label_timed(session: Session, out: Path, window_c: tuple[float, float] | None) -> tuple[LabelSet, float]:
    """The session's labels, and the median of seconds a frame (the first compiles or loads kernels)."""
    ends = [time.perf_counter()]
    suit = load_suit(suit_path(session.path))
    run = label_source(session, SuitLabeller(suit), out, lambda _: ends.append(time.perf_counter()), window_c)
    for frame_id, why in run.failed:
        print(f"frame {frame_id}: {why}", file=sys.stderr)
    return run.labels, float(np.median(np.diff(ends)))


def measured(path: Path) -> dict[str, float]:
    """Every figure of the bars for one simulated session."""
    session, truth = Session(path), LabelSet.open(truth_path(path))
    with tempfile.TemporaryDirectory() as folder:
        labels, seconds = label_timed(session, Path(folder) / "l", None)
        sure = reliability(labels, truth, session)
        pairs = [(t, labels.read(t.frame_id).parts) for t in truth]
        figures = accuracy(labels, truth)
    strict, tolerant = (
        np.array([Agreement(t.parts, t.depth_mm > 0, px).of(p) for t, p in pairs]) for px in (0, 2)
    )
    return {
        **figures,
        "calibration error": sure.ece,
        "wrong pixels in first 30 %": sure.found_first,
        "agreement, strict": float(strict.mean()),
        "frames >= 0.99, strict": float((strict >= AGREED).mean()),
        "agreement, 2 px": float(tolerant.mean()),
        "frames >= 0.99, 2 px": float((tolerant >= AGREED).mean()),
        "seconds a frame": seconds,
    }


def accuracy(labels: LabelSet, truth: LabelSet) -> dict[str, float]:
    """How right a session's labels are."""
    scores = compare_sets(labels, truth).scores
    return {
        "person IoU": float(scores["person_iou"]),
        "mean recall": float(scores["mean_recall"]),
        "mIoU": float(scores["miou"]),
        "boundary F, 2 px": float(scores["boundary_f"]),
        "swap rate, %": 100 * float(scores["left_right_swap_rate"]),
    }


def print_figures(paths: list[Path]) -> None:
    columns = [measured(path) for path in paths]
    print("| | " + " | ".join(path.stem for path in paths) + " |")
    print("|---|" + "---:|" * len(paths))
    for name in columns[0]:
        print(f"| {name} | " + " | ".join(f"{column[name]:.4f}" for column in columns) + " |")


if __name__ == "__main__":
    print_figures([Path(name) for name in sys.argv[1:]])
