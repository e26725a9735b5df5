"""Measure learning: ``python -m tools.correction.learning LABELS TRUTH CURVE.json``.

A simulated annotator (``annotate.effort``) corrects copies of a label set to 99 % within 2 px, each frame
beginning with the corrections carried over: once in order of time, and once in the order that teaches most,
with ``learn`` beside the work. A learning begins when so many frames are accepted; its labels come when the
annotator has worked for as many seconds as it took of one processor. CURVE.json gets the seconds of every
frame of both, for ``report``.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from annotate.correction.correction import Correction
from annotate.correction.queue import teaching_order
from annotate.correction.relabel import relabel
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.labelset.store import LabelSet
from eval.learning.learn import learn
from eval.network.onnx_network import SHIPPED_WEIGHTS
from tools.correction.effort import copy_of


class Learning:
    """Frames in the order that teaches most, with learning beside the work. steps: what each came to."""

    def __init__(self, correction: Correction, annotator: Annotator, after: list[int], out: Path) -> None:
        self.correction, self.annotator, self.after, self.out = correction, annotator, after, out
        self.steps: list[dict[str, float | None]] = []
        self._due: tuple[float, LabelSet, dict[str, float | None]] | None = None

    def order(self):
        """Frame ids, one by one, the next chosen when it is asked for."""
        done = 0
        while coming := teaching_order(self.correction):
            yield coming[0]
            done += 1
            if done in self.after:
                self._begin(done)
            if self._due and self.annotator.clock() >= self._due[0]:
                self._take_over(done)

    def _begin(self, done: int) -> None:
        self.correction.flush()
        began = time.process_time()
        start = SHIPPED_WEIGHTS.with_suffix(".safetensors")
        learnt = learn(self.correction.labels.path, self.out, start, lambda _: None)
        seconds = time.process_time() - began
        step = {"learnt": done, "seconds": round(seconds, 1), "before": learnt.before, "after": learnt.after}
        print(f"  {step}", flush=True)
        self._due = (self.annotator.clock() + seconds, LabelSet.open(learnt.labels), step)

    def _take_over(self, done: int) -> None:
        assert self._due is not None
        _, labels, step = self._due
        changed = relabel(self.correction, labels)
        self.steps.append({**step, "taken_over": done, "changed": round(changed.changed, 4)})
        self._due = None


def worked(labels, truth, frames, folder, after):
    """Seconds and agreement of every frame, in the order of work, and the steps of learning."""
    annotator = Annotator()
    chosen = copy_of(labels, folder / "labels", frames)
    with Correction.open(chosen.path, WHO, clock=annotator.clock) as correction:
        learning = Learning(correction, annotator, after, folder / "model")
        order = learning.order() if after else ()
        rows = []
        for effort in correct_set(correction, truth, annotator, lambda _: None, True, order):
            rows.append((effort.corrected.frame_id, round(effort.seconds, 2), round(effort.agreement, 4)))
            print(f"  {len(rows)}: {rows[-1]}", flush=True)
    return rows, learning.steps


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("labels", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("curve", type=Path)
    parser.add_argument("--frames", type=int, help="only the first so many")
    parser.add_argument("--after", type=int, nargs="+", default=[4, 12, 30], help="accepted frames")
    options = parser.parse_args()
    torch.set_num_threads(1)
    labels, truth = LabelSet.open(options.labels), LabelSet.open(options.truth)
    curve = {"labels": options.labels.name, "kind": "learning"}
    for name, after in (("without", []), ("with", options.after)):
        with tempfile.TemporaryDirectory() as folder:
            rows, steps = worked(labels, truth, options.frames, Path(folder), after)
        seconds = [row[1] for row in rows]
        print(f"{name} learning: {len(rows)} frames, mean {np.mean(seconds):.2f} s", flush=True)
        curve[name] = {"frames": [row[0] for row in rows], "seconds": seconds, "steps": steps}
        curve[name]["agreement"] = [row[2] for row in rows]
        options.curve.write_text(json.dumps(curve, indent=1) + "\n")


if __name__ == "__main__":
    main()
