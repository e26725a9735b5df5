"""Kills a correction at random moments and checks that nothing is lost.

python -m tools.correction.kill_editor [FOLDER]

A child works through random strokes and says after each that it is done; the parent kills it with -9 and
looks: every stroke said to be done is there, every frame is as an uninterrupted run would have it, no
file is broken. Then a new child goes on.
"""

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from annotate.cleanup import without_islands
from annotate.correction.correction import Correction
from annotate.correction.edit import ARMS, Editor
from annotate.correction.replay import replayed
from annotate.frame_labels import FrameLabels
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet, validate
from annotate.labelset.stroke import Gesture
from sensors.rig.camera import Intrinsics

FRAMES, STEPS_A_VISIT = 3, 27


def create(folder: Path, height: int, width: int) -> LabelSet:
    """A label set of stripes, some of it without depth."""
    camera = Intrinsics(width, height, 365, 365, width / 2, height / 2)
    labels = LabelSet.create(folder, camera, {"source": "kill"})
    rng = np.random.default_rng(0)
    for i in range(FRAMES):
        depth = rng.integers(1990, 2010, (height, width), np.uint16)
        depth[rng.random(depth.shape) < 0.1] = 0
        parts = (np.arange(width) // 7 % 12 * (depth > 0)).astype(np.uint8)
        labels.write(FrameLabels(f"{i:06}", depth, parts))
    return labels


def frame_of(step: int) -> str:
    """The frame that the ``step``-th entry of the journal is about."""
    return f"{step // STEPS_A_VISIT % FRAMES:06}"


def do(editor: Editor, step: int) -> None:
    """The ``step``-th entry: always the same on the same labels."""
    rng = np.random.default_rng(step)
    v, u = np.ogrid[: editor.parts.shape[0], : editor.parts.shape[1]]
    near, far = rng.integers(0, editor.parts.shape, (2, 2)), rng.integers(4, 20)
    disc = (v - near[0, 0]) ** 2 + (u - near[0, 1]) ** 2 < far**2
    others = [
        editor.undo,
        editor.redo,
        lambda: editor.replace("remove_islands", without_islands(editor.parts, editor.depth_mm)),
        lambda: editor.swap_left_right(ARMS),
        lambda: editor.to_neighbour(disc),
        lambda: editor.judge("accept"),
    ]
    if step % 3 or others[step // 3 % len(others)]() is None:
        part = int(rng.integers(0, 12))
        if editor.paint(disc, part, Gesture("brush", points=9)) is None:
            editor.judge("accept")


def work(folder: Path, said: int) -> None:
    """Go on where the journal ends, for ever; one byte to ``said`` after each step."""
    with Correction.open(folder, "ann") as correction:
        while True:
            step = len(correction.journal)
            do(correction.edit(frame_of(step)), step)
            os.write(said, b".")


def kill_once(work: Callable[[int], None], delay_s: float, at_once: bool) -> int:
    """Let a child work, from its start or its first stroke on for so long, and kill it; strokes it said.

    work: gets the end of a pipe into which it writes a byte after each stroke.
    """
    heard, said = os.pipe()
    child = os.fork()
    if not child:
        work(said)
    os.close(said)
    first = b"" if at_once else os.read(heard, 1)
    time.sleep(delay_s)
    os.kill(child, signal.SIGKILL)
    _, ended = os.waitpid(child, 0)
    assert os.WIFSIGNALED(ended), f"the child ended by itself, with status {ended}"
    with os.fdopen(heard, "rb") as file:
        return len(first + file.read())


def check(folder: Path, done: int, shadows: dict[str, "Shadow"], thorough: bool) -> int:
    """Reopen; raises AssertionError on any loss. Returns how many strokes there are.

    thorough: replay the whole journal from the original labels too.
    """
    reached = sum(len(editor.steps) for editor in shadows.values())
    with Correction.open(folder, "ann") as correction:
        there = len(correction.journal)
        assert done <= there <= done + 1, f"{done} strokes were done, {there} are there"
        for step in range(reached, there):
            do(shadows[frame_of(step)], step)
            shadows[frame_of(step)].steps.append(step)
        assert validate(correction.labels) == []
        for frame_id, shadow in shadows.items():
            np.testing.assert_array_equal(correction.frame(frame_id).parts, shadow.parts)
    if thorough:
        labels, journal = LabelSet.open(folder), Journal.of(folder)
        for frame_id in labels.frame_ids:
            parts = replayed(labels, journal, frame_id).parts
            np.testing.assert_array_equal(parts, shadows[frame_id].parts)
    assert not list(folder.glob("**/.*.partial"))
    return there


class Shadow(Editor):
    """What an uninterrupted run comes to."""

    def __init__(self, frame: FrameLabels) -> None:
        super().__init__(frame, "ann")
        self.steps: list[int] = []


def main() -> None:
    """Kill as often as asked, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, nargs=2, default=(424, 512), metavar=("HEIGHT", "WIDTH"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch) / "set"
        shadows = {frame.frame_id: Shadow(frame) for frame in create(folder, *given.size)}
        # Compiled once here, not in every child.
        without_islands(*(np.ones((4, 4), kind) for kind in (np.uint8, np.uint16)))
        rng, done, began = np.random.default_rng(given.seed), 0, 0
        for i in range(given.kills):
            before = done
            done += kill_once(partial(work, folder), rng.uniform(0.0, 0.2), at_once=i % 5 == 0)
            done = check(folder, done, shadows, thorough=i % 10 == 0 or i == given.kills - 1)
            began += done > before
    print(f"{given.kills} kills, {began} of them amid strokes; {done} strokes, none lost", file=sys.stderr)


if __name__ == "__main__":
    main()
