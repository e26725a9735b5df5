"""Kills a correction with learning in the background, and checks that nothing is lost or half-replaced.

python -m tools.correction.kill_learning [--kills N]

As the window does, a process works on frames and has another one learn beside it, for real, a reader
from the frames accepted so far; when that has ended well, it takes over the new labels, and now and then
takes them back. At random moments both are killed with -9, or the learning alone, or the work alone, whose
learning then lives on. Each time every frame that nobody worked on must have its labels of one and the same
step, every stroke that was said to be done must be there, and no file may be broken. At the end all steps and
strokes are taken back: then all images are as at first, to the byte; the notes say what was done.
"""

import argparse
import os
import re
import signal
import tempfile
import time
import traceback
from collections import Counter
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel, take_back
from annotate.correction.replay import after, step_of
from annotate.labelset.claim import ClaimedError
from annotate.labelset.label_set import LabelSet, validate
from eval.fine_tuning import by_depth
from eval.fine_tuning import fine_tune as learn
from eval.fine_tuning import run as practice
from eval.training.segmentation import train
from eval.training.segmentation.network import FULL_AGAIN, export_reader, load_reader
from tests.test_eval_learning import DONE, IDS, SIDE, truth, written

WORKED, FREE = DONE[:2], IDS[len(DONE) :]
REFUSED = 2
"""Status of a learning while another one, of a work that was killed, still goes on."""
MOMENTS, SHARES = (b".", b"t", b"r"), (0.6, 0.25, 0.15)
"""What a kill waits for, and how often: a stroke, the beginning of a taking over, or its end."""
STROKE_S = 0.1
"""Seconds between two strokes, so that the learning gets its share of the processor."""
VICTIMS = ("both", "both", "learning", "work")


def create(folder: Path) -> None:
    """A set that calls everybody a torso, five of its frames accepted."""
    written(folder / "labels")
    with Correction.open(folder / "labels", "ann") as correction:
        for n, frame_id in enumerate(DONE):
            editor = correction.edit(frame_id)
            editor.replace("paint", truth(n))
            editor.judge("accept")
    practice.MORE, practice.SIDE, train.SAVED_S = 0.5, 32, 0.0
    # What is learnt in a few steps is taken over whether it is better or not.
    learn.Learnt.better = True
    # Loads what takes seconds once here, not in every child.
    export_reader(load_reader(FULL_AGAIN), folder / "start.onnx")


@contextmanager
def silent(what: str, total: int):
    yield lambda n: None


def learning(folder: Path, seed: int) -> int:
    """Start to learn in a process of its own; its number. What it learns differs from time to time."""
    if child := os.fork():
        return child
    # A program of its own would not hold what the work has open: its claim above all.
    os.closerange(3, 1 << 10)
    practice.MOST_STEPS = 1 + seed % 3
    try:
        learner = by_depth.DepthLearner(LabelSet.open(folder / "labels"), None)
        learn.learn(folder / "labels", folder / "model", learner, silent)
    except ClaimedError:
        os._exit(REFUSED)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def work(folder: Path, said: int, seed: int) -> None:
    """Paint, learn, take over and take back for ever; tells of each, and of the learnings' numbers."""
    rng, child = np.random.default_rng(seed), 0
    with Correction.open(folder / "labels", "ann") as correction:
        while True:
            if not child:
                child = learning(folder, int(rng.integers(1000)))
                os.write(said, f"[{child}]".encode())
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                child = 0
                killed_or_refused = os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == REFUSED
                if status and not killed_or_refused:
                    os.write(said, b"!")
                if not status:
                    os.write(said, b"t")
                if not status and (folder / "model" / learn.LABELS).exists():
                    relabel(correction, LabelSet.open(folder / "model" / learn.LABELS))
                    os.write(said, b"r")
            if rng.integers(40) == 0 and take_back(correction):
                os.write(said, b"b")
            editor = correction.edit(WORKED[int(rng.integers(2))])
            pixel = SIDE * 12 + int(rng.integers(SIDE * 20))
            if editor.paint(pixel + np.arange(4), int(rng.integers(1, 12))):
                os.write(said, b".")
            time.sleep(STROKE_S)


def killed(folder: Path, seed: int, victim: str) -> bytes:
    """What a work said until it, its learning, or both were killed: soon after a stroke, or amid or after
    taking over what was learnt."""
    rng, told = np.random.default_rng(seed), b""
    heard, said = os.pipe()
    child = os.fork()
    if not child:
        os.close(heard)
        work(folder, said, seed)
    os.close(said)
    wanted = rng.choice(MOMENTS, p=SHARES)
    while wanted not in told:
        told += os.read(heard, 1 << 10)
    time.sleep(rng.uniform(0.0, 0.1))
    if victim != "work":
        kill_learning(told)
    if victim == "learning":
        time.sleep(rng.uniform(0.0, 0.3))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), f"the work ended by itself, with status {status}"
    with os.fdopen(heard, "rb") as file:
        return told + file.read()


def kill_learning(told: bytes) -> None:
    """Kill the last learning that was told of, if it still goes on."""
    if numbers := re.findall(rb"\[(\d+)\]", told):
        with suppress(ProcessLookupError):
            os.kill(int(numbers[-1]), signal.SIGKILL)


def check(folder: Path, said: int) -> str:
    """Reopen; the step that all free frames are of. Raises AssertionError on any loss."""
    with Correction.open(folder / "labels", "ann") as correction:
        entries = {i: correction.journal.strokes(i) for i in FREE}
        steps = {step_of(strokes) for strokes in entries.values()}
        assert len(steps) == 1, f"half a step: {steps}"
        for frame_id, strokes in entries.items():
            original = correction.labels.read(frame_id, original=correction.labels.has_original(frame_id))
            np.testing.assert_array_equal(correction.frame(frame_id).parts, after(original, strokes).parts)
        there = sum(
            s.operation == "paint" and bool(s.changes) for i in WORKED for s in correction.journal.strokes(i)
        )
        assert said <= there, f"{said} strokes were done, {there} are there"
        assert validate(correction.labels) == []
    assert not list(folder.glob("labels/**/.*.partial"))
    return steps.pop() or ""


def main() -> None:
    """Kill as often as asked, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        create(folder)
        images = [f for f in (folder / "labels/frames").glob("*.png") if f.name[:6] in FREE]
        first = {f.name: f.read_bytes() for f in images}
        rng, done, seen, victims = np.random.default_rng(given.seed), Counter[str](), [], Counter[str]()
        for i in range(given.kills):
            victim = VICTIMS[int(rng.integers(len(VICTIMS)))]
            told = killed(folder, given.seed + i, victim)
            done.update(
                {
                    name: told.count(byte)
                    for name, byte in (("strokes", b"."), ("taken", b"r"), ("back", b"b"))
                }
            )
            victims[victim] += 1
            assert b"!" not in told, "a learning failed"
            seen.append(check(folder, done["strokes"]))
            print(f"\r{i + 1} kills", end="", flush=True)
        kill_learning(told)
        with Correction.open(folder / "labels", "ann") as correction:
            while take_back(correction):
                pass
            for frame_id in DONE:
                while correction.edit(frame_id).undo():
                    pass
                begun = correction.begun(frame_id).parts
                np.testing.assert_array_equal(correction.frame(frame_id).parts, begun)
        assert {n: (folder / "labels/frames" / n).read_bytes() for n in first} == first
    turns = sum(a != b for a, b in pairwise(seen))
    print(
        f"\r{given.kills} kills ({dict(victims)}), {turns} with labels of another step than the one before;"
    )
    print(f"{done['strokes']} strokes, none lost; learnt {done['taken']} times, {done['back']} taken back")


if __name__ == "__main__":
    main()
