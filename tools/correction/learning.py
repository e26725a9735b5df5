"""Measure learning: ``python -m tools.correction.learning LABELS TRUTH OUT [--session S]``.

A simulated annotator (``annotate.effort``) corrects two copies of a label set to 99 % within 2 px, each frame
beginning with the corrections carried over: OUT/without in the order of time; OUT/with begins with so many
frames (--every) in the order that teaches most and goes on in the order of time, with ``learn`` beside the
work. A learning begins when so many more frames are accepted and the one before has ended; its labels come
when the annotator has worked for as many seconds as it took of one processor. ``report`` with ``--audit
OUT/without --audit OUT/with`` shows the seconds as curves over the frames. With the session, supervoxels and
what is carried over follow colour; labels from a suit need it, and their reader learns.
"""

import argparse
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from annotate.cloud.fuse import Fuser
from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel, untouched
from annotate.correction.review_queue import teaching_order
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.labelset.label_set import LabelSet
from eval.fine_tuning.fine_tune import learn, learner_of
from sensors.session.reader import Session
from tools.correction.effort import copy_of


class Learning:
    """Frames in the order to work in, with learning beside the work."""

    def __init__(self, correction, annotator: Annotator, every: int, model: Path, session) -> None:
        self.correction, self.annotator, self.every, self.model = correction, annotator, every, model
        self.session: Path | None = session
        self._due: tuple[float, LabelSet | None] | None = None
        self._learnt = 0

    def order(self):
        """Frame ids, one by one, the next chosen when it is asked for."""
        done = 0
        while coming := teaching_order(self.correction) if done < self.every else untouched(self.correction):
            yield coming[0]
            done += 1
            if self._due and self.annotator.clock() >= self._due[0]:
                self._take_over(done)
            if not self._due and done - self._learnt >= self.every:
                self._begin(done)

    def _begin(self, done: int) -> None:
        began = time.process_time()
        labels = self.correction.labels
        learnt = learn(labels.path, self.model, learner_of(labels, self.session, None), silent)
        seconds = time.process_time() - began
        held = f"{learnt.before} before, {learnt.after} after on {learnt.held_out} held out"
        print(f"  {done} frames learnt in {seconds:.0f} s of one processor: {held}", flush=True)
        made = LabelSet.open(learnt.labels) if learnt.labels else None
        self._learnt, self._due = done, (self.annotator.clock() + seconds, made)

    def _take_over(self, done: int) -> None:
        assert self._due
        if self._due[1]:
            print(f"  after {done} frames: {relabel(self.correction, self._due[1]).text}", flush=True)
        self._due = None


@contextmanager
def silent(what, total):
    yield lambda n: None


def worked(labels, truth, every, out, session):
    """Work on a copy of a label set in a folder; seconds of every frame, in the order of work."""
    annotator = Annotator()
    with Correction.open(labels.path, WHO, clock=annotator.clock) as correction:
        order = Learning(correction, annotator, every, out, session).order() if every else ()
        seconds = []
        for effort in correct_set(correction, truth, annotator, clouds_of(session), True, order):
            seconds.append(effort.seconds)
            frame_id, right = effort.corrected.frame_id, effort.agreement
            print(f"  {len(seconds)}: frame {frame_id}, {effort.seconds:.2f} s, {right:.4f}", flush=True)
    return seconds


def clouds_of(path):
    """Colours and temperatures of a session's frames; without one, nothing."""
    if path is None:
        return lambda frame_id: None
    session = Session(path)
    fuser = Fuser(session.calibration)
    return lambda frame_id: fuser.fuse_frame(session.frame(int(frame_id)))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("labels", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--session", type=Path)
    parser.add_argument("--frames", type=int, help="only the first so many")
    parser.add_argument("--every", type=int, default=6, help="accepted frames from learning to learning")
    options = parser.parse_args()
    torch.set_num_threads(1)
    labels, truth = LabelSet.open(options.labels), LabelSet.open(options.truth)
    for name, every in (("without", 0), ("with", options.every)):
        copied = copy_of(labels, options.out / name, options.frames)
        seconds = worked(copied, truth, every, options.out / "model", options.session)
        print(f"{name} learning: {len(seconds)} frames, mean {np.mean(seconds):.2f} s", flush=True)


if __name__ == "__main__":
    main()
