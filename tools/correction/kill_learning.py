"""Kills a correction amid steps of learning, and checks that all frames are before a step or all after it.

python -m tools.correction.kill_learning [--kills N]

A child takes over what was learnt, takes it back, and works on frames between; the parent kills it with -9.
Then frames that nobody worked on all have the labels of one step, every stroke said to be done is there, and
no file is broken. At the end all steps and strokes are taken back: frames that nobody worked on are the first
ones, to the byte, the others have the labels that the work began from.
"""

import argparse
import os
import tempfile
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel, take_back
from annotate.frame_labels import FrameLabels
from annotate.labelset.store import LabelSet, validate
from sensors.rig.camera import Intrinsics
from tools.correction.kill_editor import kill_once

SHAPE, WORKED, FREE = (106, 128), ("000000", "000001"), tuple(f"{i:06}" for i in range(2, 8))
PARTS = {"labels": 2, "first": 4, "second": 7}


def create(folder: Path) -> None:
    """A set whose persons are torsos, and what two learnings say of them."""
    height, width = SHAPE
    for name, part in PARTS.items():
        labels = LabelSet.create(folder / name, Intrinsics(width, height, 90, 90, 64, 53), {"source": name})
        parts = np.zeros(SHAPE, np.uint8)
        parts[20:90, 30:90] = part
        sure = np.full(SHAPE, 0.9, np.float32)
        for frame_id in (*WORKED, *FREE):
            labels.write(FrameLabels(frame_id, np.full(SHAPE, 1500, np.uint16), parts, sure))


def work(folder: Path, said: int, seed: int) -> None:
    """Learn, take back and paint for ever; one byte to ``said`` after each stroke."""
    rng = np.random.default_rng(seed)
    learnt = [LabelSet.open(folder / name) for name in ("first", "second")]
    with Correction.open(folder / "labels", "ann") as correction:
        while True:
            what = int(rng.integers(4))
            if what == 0:
                take_back(correction)
            elif what < 3:
                relabel(correction, learnt[what - 1])
            editor = correction.edit(WORKED[int(rng.integers(2))])
            start = SHAPE[1] * 30 + 40 + 5 * int(rng.integers(900))
            if editor.paint(start + np.arange(4), int(rng.integers(1, 12))):
                os.write(said, b".")


def check(folder: Path, said: int) -> str:
    """Reopen; the labels that all free frames have. Raises AssertionError on any loss."""
    with Correction.open(folder / "labels", "ann") as correction:
        found = {int(correction.frame(i).parts[50, 60]) for i in FREE}
        assert len(found) == 1, f"half a step: {found}"
        there = sum(s.changes for i in WORKED for s in correction.journal.strokes(i))
        assert said <= there, f"{said} strokes were done, {there} are there"
        assert validate(correction.labels) == []
    assert not list(folder.glob("labels/**/.*.partial"))
    return next(name for name, part in PARTS.items() if part in found)


def free_images(folder: Path) -> dict[str, bytes]:
    """Images of the frames that nobody works on, by name."""
    files = sorted(folder.glob("labels/frames/*.png"))
    return {file.name: file.read_bytes() for file in files if file.name[:6] in FREE}


def main() -> None:
    """Kill as often as asked, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        create(folder)
        first = free_images(folder)
        rng, said, seen = np.random.default_rng(given.seed), 0, []
        for i in range(given.kills):
            said += kill_once(
                partial(work, folder, seed=given.seed + i), rng.uniform(0.0, 0.4), at_once=i % 5 == 0
            )
            seen.append(check(folder, said))
        with Correction.open(folder / "labels", "ann") as correction:
            while take_back(correction):
                pass
            for frame_id in WORKED:
                while correction.edit(frame_id).undo():
                    pass
                begun = correction.begun(frame_id).parts
                np.testing.assert_array_equal(correction.frame(frame_id).parts, begun)
        assert free_images(folder) == first
    turns = sum(a != b for a, b in pairwise(seen))
    print(f"{given.kills} kills, {turns} with other labels than the one before; {said} strokes, none lost")


if __name__ == "__main__":
    main()
