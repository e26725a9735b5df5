"""Measure the work left: ``python -m tools.correction.effort LABELS TRUTH [--session S] [--frames N]``.

A simulated annotator corrects a copy of the label set to 99 % agreement with the truth; printed are the
seconds and operations a frame, the share accepted with one key and what is left wrong, with a strict border
and one of 2 px, each frame alone and with the window carrying corrections over from the frames before
("always carry": its strokes need no key), each with a look for every patch, the headline, and a look for up
to four of one part (docs/adr/0009). With the session, supervoxels and what is carried over follow colour;
else the labels.
"""

import argparse
import tempfile
import time
from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.correction.correction import Correction
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import AGREEMENT, WHO, Annotator, correct_set
from annotate.labelset.label_set import LabelSet
from annotate.parts import PARTS
from sensors.session.reader import Session


def measure(labels, truth, cloud_of, annotator, propagating, trace=False):
    """Print one way of working over a label set."""
    efforts, before, left, operations, spent = [], [], Counter(), Counter(), Counter()
    started = time.process_time()
    with Correction.open(labels.path, WHO, clock=annotator.clock) as correction:
        for effort in correct_set(correction, truth, annotator, cloud_of, propagating):
            frame_id = effort.corrected.frame_id
            true = truth.read(frame_id).parts
            agreement = Agreement(true, effort.corrected.depth_mm > 0, annotator.tolerance_px)
            efforts.append(effort)
            before.append(agreement.of(labels.read(frame_id, original=True).parts))
            wrong = agreement.wrong(effort.corrected.parts)
            left.update(zip(effort.corrected.parts[wrong].tolist(), true[wrong].tolist(), strict=True))
            for stroke in effort.strokes:
                operations[stroke.operation, stroke.how.kind] += 1
                spent[stroke.operation, stroke.how.kind] += stroke.active_seconds
            if trace:
                done = [f"{s.operation}/{s.how.kind} {s.active_seconds:.1f}" for s in effort.strokes]
                print(
                    f"  {frame_id} {before[-1]:.4f} -> {effort.agreement:.4f} {effort.seconds:.1f} s", *done
                )
    print_summary(efforts, before, left)
    print_operations(operations, spent)
    print(f"  simulated in {(time.process_time() - started) / len(efforts):.2f} s a frame")


def print_summary(efforts, before, left):
    seconds = np.array([e.seconds for e in efforts])
    repairs = np.array([e.repairs for e in efforts])
    missed = [e for e in efforts if e.agreement < AGREEMENT]
    print(
        f"  {len(efforts)} frames: median {np.median(seconds):.2f} s, mean {seconds.mean():.2f}, "
        f"p90 {np.quantile(seconds, 0.9):.1f}, most {seconds.max():.1f}; operations median "
        f"{np.median(repairs):g}, p90 {np.quantile(repairs, 0.9):g}; one key {np.mean(repairs == 0):.1%}"
    )
    print(
        f"  agreement before: median {np.median(before):.4f}, 10 % under {np.quantile(before, 0.1):.4f}; "
        f"left wrong: mean {1 - np.mean([e.agreement for e in efforts]):.2%}; "
        f"given up under {AGREEMENT:.0%}: {len(missed)}"
        + (f", at {np.median([e.agreement for e in missed]):.4f}" if missed else "")
    )
    of_all = sum(left.values()) or 1
    said = (f"{n / of_all:.0%} {name(was)} for {name(true)}" for (was, true), n in left.most_common(5))
    print("  left wrong:", ", ".join(said) or "nothing")


def print_operations(operations, spent):
    """How often each was done and the seconds it took, the looking before it included."""
    said = (f"{operations[key]} {key[0]}/{key[1]} {s:.0f} s" for key, s in spent.most_common())
    print("  operations:", ", ".join(said))


def name(part):
    return PARTS[part].name if part < len(PARTS) else "undefined"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("labels", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--session", type=Path)
    parser.add_argument("--frames", type=int, help="only the first so many")
    parser.add_argument("--tolerance", type=int, nargs="+", default=(2, 0), help="pixels at borders")
    parser.add_argument("--trace", action="store_true", help="every frame and what was done")
    options = parser.parse_args()
    truth, cloud_of = LabelSet.open(options.truth), lambda frame_id: None
    if options.session:
        session = Session(options.session)
        fuser = Fuser(session.calibration)
        cloud_of = lambda frame_id: fuser.fuse_frame(session.frame(int(frame_id)))  # noqa: E731
    for tolerance_px, propagating, at_once in product(options.tolerance, (False, True), (1, 4)):
        mode = "corrections carried over" if propagating else "each frame alone"
        print(f"border {tolerance_px} px, {mode}, up to {at_once} patches a look:")
        annotator = Annotator(tolerance_px=tolerance_px, at_once=at_once)
        with tempfile.TemporaryDirectory() as folder:
            labels = copy_of(LabelSet.open(options.labels), Path(folder) / "labels", options.frames)
            measure(labels, truth, cloud_of, annotator, propagating, options.trace)


def copy_of(labels, path, frames):
    """The first frames of a label set as a set of their own, as labelled automatically."""
    copied = LabelSet.create(path, labels.intrinsics, labels.info)
    for frame_id in labels.frame_ids[:frames]:
        copied.write(labels.read(frame_id))
    return copied


if __name__ == "__main__":
    main()
