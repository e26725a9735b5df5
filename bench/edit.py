"""Strokes of the correction core at 217,088 points, the journal on the disk included.

The naive way keeps a copy of the labels for undo and writes the whole frame at every stroke.
"""

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from annotate.cleanup import filled, without_islands
from annotate.cloud.fuse import Fuser
from annotate.correction import select
from annotate.correction.correction import Correction
from annotate.correction.edit import Editor
from annotate.correction.select import edit_supervoxels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import Gesture
from annotate.parts import PAPER
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import VirtualRig

ROUNDS = 25


def median_s(action, rounds=ROUNDS):
    """Return the median seconds of an action, called with its round; round 0, which compiles, is left out."""
    times = []
    for i in range(rounds + 1):
        start = time.perf_counter()
        action(i)
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:]), max(times[1:])


def lasso(i):
    """Return a lasso of 60 corners, at another place in each round."""
    angle = np.linspace(0, 2 * np.pi, 60)
    return np.stack([500 + 3 * i + 130 * np.cos(angle), 420 + 110 * np.sin(angle)], axis=1)


def part_at(i: int) -> int:
    """Return the id of the part to paint in a round."""
    return PAPER.parts[i % len(PAPER.parts)].id


def actions(editor: Editor, view: select.ScreenPoints, pieces):
    """Return the actions of an annotator by name; each is called with the number of its round."""
    at = int(np.flatnonzero((pieces >= 0) & (editor.parts == 2))[0])
    piece = select.supervoxel(pieces, editor.parts, at)
    everywhere = np.arange(editor.parts.size)
    grown = select.grow(pieces, editor.parts, editor.depth_mm, piece)

    def tidy(i):
        editor.paint(grown[::37], 3 + i % 2)
        editor.replace("remove_islands", without_islands(editor.parts, editor.depth_mm))

    def fill(i):
        part = part_at(i)
        editor.replace("fill_holes", filled(editor.parts, editor.depth_mm, part), part)

    return {
        "lasso and paint": lambda i: editor.paint(
            select.polygon(view, lasso(i)), part_at(i), Gesture("lasso", points=60)
        ),
        "undo": lambda i: editor.undo(),
        "redo": lambda i: editor.redo(),
        "click a supervoxel": lambda i: editor.paint(select.supervoxel(pieces, editor.parts, at), part_at(i)),
        "grow": lambda i: select.grow(pieces, editor.parts, editor.depth_mm, piece),
        "two strokes: specks, islands away": tidy,
        "fill holes": fill,
        "swap left and right": lambda i: editor.swap_left_right(),
        "paint every point": lambda i: editor.paint(everywhere, part_at(i)),
    }


def open_s(path: Path, frame_id: str) -> float:
    """Return the seconds that opening a label set of a killed session takes, with an editor on its frame."""
    start = time.perf_counter()
    with Correction.open(path, "bench") as correction:
        correction.edit(frame_id)
        return time.perf_counter() - start


def bench():
    """Return rows of medians: (name, seconds, seconds of the naive way)."""
    rig = VirtualRig(2, 1, "hard", 77)
    camera = Fuser(rig.calibration).camera
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        labels = LabelSet.create(Path(scratch) / "set", camera, {"source": "bench"})
        for frame, known in rig.with_truth():
            labels.write(truth_labels(frame, known))
        first, second = labels.frame_ids
        naive_s, _ = median_s(lambda i: labels.write(labels.read(second)))
        correction = Correction.open(labels.path, "bench")
        editor = correction.edit(first)
        view = select.ScreenPoints.of_image(editor.depth_mm, 2.0)
        pieces = edit_supervoxels(correction.frame(first), camera)
        for name, action in actions(editor, view, pieces).items():
            seconds, worst = median_s(action)
            rows.append((f"edit: {name} (worst {worst * 1e3:.0f} ms)", seconds, naive_s))
        correction.abandon()
        strokes = len(correction.journal)
        rows.append((f"edit: open after {strokes} unsaved strokes", open_s(labels.path, first), naive_s))
    return rows
