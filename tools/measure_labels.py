"""Measure the labelling engine against the truth of simulated sessions, and what each of its steps gives.

python -m tools.measure_labels SESSION.mcap...             the figures of every session
python -m tools.measure_labels --ablation SESSION.mcap...  the same with one step after the other taken out
Both print Markdown tables.
"""

import hashlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.effort.agreement import Agreement
from annotate.label_source import label_source
from annotate.labelset.store import LabelSet
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.person.extract import Survey
from annotate.person.warm_window import WINDOW_C
from annotate.segmentation.confidence import worst_first
from annotate.segmentation.part_tree import softmax
from annotate.segmentation.patches import Patches, read_together
from annotate.segmentation.segment import tile
from annotate.suit.color_model import ColorModel, under
from annotate.suit.palette import load_suit
from eval.compare.compare import compare_sets
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

BINS = 15
AGREED = 0.99
FIRST_SHARE = 0.3


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
        groups = tile(fuser.fuse_frame(frame), named)
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
    run = label_source(session, suit, out, lambda _: ends.append(time.perf_counter()), window_c)
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


def points_alone(cloud: Any, mask: np.ndarray) -> Supervoxels:
    """Every point a group of its own, touching its neighbours in the image."""
    index = np.full(mask.shape, -1)
    index[mask] = np.arange(mask.sum())
    across, down = ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:]))
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in (across, down)])
    edges = edges[(edges >= 0).all(axis=1)]
    return Supervoxels(np.arange(mask.sum(), dtype=np.int32), int(mask.sum()), edges.astype(np.int32))


def by_color_alone(patches: Patches, palette: ColorModel, clues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each patch by its own colour in white light."""
    match = under(palette, np.zeros(2)).match(patches.chroma, 0.5 * patches.blur)
    return softmax(palette.by_part(match) + clues), np.zeros(2)


def patches_alone(patches: Patches, palette: ColorModel, clues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The light found, but no belief about any patch."""
    belief, log_gain = read_together(patches, palette, clues)
    return np.full_like(belief, 1 / 11), log_gain


SHOWN = {"person IoU": 3, "mean recall": 3, "boundary F, 2 px": 3, "swap rate, %": 2}
"""Figures of the ablation, and their digits."""
READING, PERSON = "annotate.segmentation.segment.", "annotate.person.extract."
Instead = dict[str, Callable[..., Any]]
WITHOUT: dict[str, Instead] = {
    "nothing: all steps": {},
    "the second look": {
        "annotate.label_source.look_again": lambda cloud, person, first, before: (first, person)
    },
    "islands given away": {"annotate.label_source.tidied": lambda parts, depth_mm: parts},
    "colours fitted to the light": {
        READING + "read_together": by_color_alone,
        READING + "refit_colors": lambda model, rgb, belief: model,
    },
    "patches read as one body": {READING + "read_together": by_color_alone},
    "patches' second opinion": {READING + "read_together": patches_alone},
    "supervoxels": {READING + "tile": points_alone},
    "the part tree": {READING + "settle": lambda unary, groups, centroids_m, start: softmax(unary)},
    "warmth of bare skin": {READING + "warmth_of": lambda celsius, groups: np.zeros((groups.count, 11))},
    "the sleeve that skin grows out of": {
        READING + "grown_from": lambda belief, odds, patches, groups, centroids_m: 0,
        READING + "without_sides": lambda belief, odds: belief,
    },
    "parts of the frame before": {
        READING + "with_earlier": lambda unary, groups, earlier: unary,
        READING + "hint": lambda earlier: 0,
    },
    "refined borders": {READING + "refine": lambda scores, start, depth_m, mask: start},
    "the suit in finding the person": {PERSON + "worn": lambda known: np.zeros(known.own.shape, np.float32)},
    "halves joined": {PERSON + "whole": lambda cloud, persons: persons},
    "planes of the room": {PERSON + "find_planes": lambda *given: ()},
    "colours of the room": {PERSON + "by_color": lambda lab, odds, *given: np.zeros_like(odds)},
}
"""What is taken out, and what stands in its place, by its full name."""
WINDOW = "the window found by itself (25 to 35 °C)"


class Surveys:
    """What ``label`` sees in a frame ahead of its turn, worked out once: parts are read after it."""

    def __init__(self) -> None:
        self._known: dict[bytes, Survey] = {}

    def __call__(self, cloud: ThermalCloud, *given: Any) -> Survey:
        key = hashlib.blake2b(cloud.depth_mm.tobytes()).digest()
        if key not in self._known:
            self._known[key] = Survey(cloud, *given)
        return self._known[key]


def ablation(paths: list[Path]) -> Iterator[tuple[str, list[dict[str, float]]]]:
    """For each step: its name and the figures of the sessions without it."""
    surveys = Surveys()
    for name, instead in WITHOUT.items():
        with ExitStack() as stack:
            if not any(function.startswith(PERSON) for function in instead):
                stack.enter_context(patch("annotate.label_source.Survey", surveys))
            for function, stand_in in instead.items():
                stack.enter_context(patch(function, stand_in))
            yield name, [_accuracy_of(path, None) for path in paths]
    yield WINDOW, [_accuracy_of(path, WINDOW_C) for path in paths]


def _accuracy_of(path: Path, window_c: tuple[float, float] | None) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        labels, _ = label_timed(Session(path), Path(folder) / "l", window_c)
        return accuracy(labels, LabelSet.open(truth_path(path)))


def print_figures(paths: list[Path]) -> None:
    columns = [measured(path) for path in paths]
    print("| | " + " | ".join(path.stem for path in paths) + " |")
    print("|---|" + "---:|" * len(paths))
    for name in columns[0]:
        print(f"| {name} | " + " | ".join(f"{column[name]:.4f}" for column in columns) + " |")


def print_ablation(paths: list[Path]) -> None:
    for path in paths:
        print(f"{path.stem}: {len(Session(path))} frames")
    print("| without | " + " | ".join(f"{path.stem}: {name}" for path in paths for name in SHOWN) + " |")
    print("|---|" + "---:|" * len(paths) * len(SHOWN))
    for step, columns in ablation(paths):
        cells = " | ".join(
            f"{column[name]:.{digits}f}" for column in columns for name, digits in SHOWN.items()
        )
        print(f"| {step} | {cells} |", flush=True)


if __name__ == "__main__":
    given = [argument for argument in sys.argv[1:] if argument != "--ablation"]
    (print_ablation if "--ablation" in sys.argv else print_figures)([Path(p) for p in given])
