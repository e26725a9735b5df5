"""Measure learning: ``python -m tools.correction.learning LABELS TRUTH OUT [--session S] [--every N]``.

A simulated annotator corrects two copies of a label set: OUT/without by time, OUT/with with ``learn`` beside
the work, its first frames in the order that teaches most. Learnt labels come after as many seconds of work as
the learning took of one processor. ``report --audit OUT/without --audit OUT/with`` draws the curves.
"""

import argparse
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import torch

from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel, untouched
from annotate.correction.review_queue import teaching_order
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.labelset.label_set import LabelSet
from eval.fine_tuning.fine_tune import fine_tune, fine_tuner_of
from tools.correction.effort import clouds_of, copy_of


def learning_order(correction, annotator, every, model, session):
    """Yield the frame ids to work on, with learning beside the work."""
    labels, done, learnt, due = correction.labels, 0, 0, None
    while coming := teaching_order(correction) if done < every else untouched(correction):
        yield coming[0]
        done += 1
        if due and annotator.clock() >= due[0]:
            if due[1].labels:
                text = relabel(correction, LabelSet.open(due[1].labels)).text
                print(f"  {done} frames: {text}", flush=True)
            due = None
        if not due and done - learnt >= every:
            began, learner = time.process_time(), fine_tuner_of(labels, session, None)
            made = fine_tune(labels.path, model, learner, lambda what, total: nullcontext(lambda n: None))
            learnt, due = done, (annotator.clock() + time.process_time() - began, made)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("labels", "truth", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--session", type=Path)
    parser.add_argument("--frames", type=int, help="only the first so many")
    parser.add_argument("--every", type=int, default=6, help="accepted frames from learning to learning")
    options = parser.parse_args()
    torch.set_num_threads(1)
    truth, cloud_of = LabelSet.open(options.truth), clouds_of(options.session)
    for name in ("without", "with"):
        labels = copy_of(LabelSet.open(options.labels), options.out / name, options.frames)
        annotator = Annotator()
        with Correction.open(labels.path, WHO, clock=annotator.clock) as correction:
            model = options.out / "model", options.session
            order = learning_order(correction, annotator, options.every, *model) if name == "with" else ()
            efforts = correct_set(correction, truth, annotator, cloud_of, order)
            seconds = [effort.seconds for effort in efforts]
        print(f"{name} learning: {len(seconds)} frames, mean {np.mean(seconds):.2f} s", flush=True)


if __name__ == "__main__":
    main()
