"""Measure the work left: ``python -m tools.correction.effort LABELS TRUTH [--session S] [--frames N]``.

A simulated annotator corrects a copy of the labels to 99 % agreement with the truth. Printed are seconds and
operations a frame, with and without a tolerance at borders, for one and for four patches a look
(docs/adr/0009). With a session, supervoxels follow colour.
"""

import argparse
import tempfile
from itertools import product
from pathlib import Path

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.correction.correction import Correction
from annotate.effort.annotator import AGREEMENT, WHO, Annotator, correct_set
from annotate.labelset.label_set import LabelSet
from sensors.session.reader import Session


def clouds_of(path):
    """Return a function from frame ids to the clouds of a session; to None without one."""
    if path is None:
        return lambda frame_id: None
    session = Session(path)
    fuser = Fuser(session.calibration)
    return lambda frame_id: fuser.fuse_frame(session.frame(int(frame_id)))


def copy_of(labels, path, frames):
    """Copy the first frames of a label set, as labelled automatically."""
    copied = LabelSet.create(path, labels.intrinsics, labels.info)
    for frame_id in labels.frame_ids[:frames]:
        copied.write(labels.read(frame_id))
    return copied


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("labels", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--session", type=Path)
    parser.add_argument("--frames", type=int, help="only the first so many")
    options = parser.parse_args()
    truth, cloud_of = LabelSet.open(options.truth), clouds_of(options.session)
    for tolerance_px, at_once in product((2, 0), (1, 4)):
        annotator = Annotator(tolerance_px=tolerance_px, at_once=at_once)
        with tempfile.TemporaryDirectory() as folder:
            labels = copy_of(LabelSet.open(options.labels), Path(folder) / "labels", options.frames)
            with Correction.open(labels.path, WHO, clock=annotator.clock) as correction:
                efforts = list(correct_set(correction, truth, annotator, cloud_of))
        seconds = np.array([one.seconds for one in efforts])
        repairs = np.array([one.repairs for one in efforts])
        below = sum(one.agreement < AGREEMENT for one in efforts)
        print(
            f"border {tolerance_px} px, {at_once} patches a look: {len(efforts)} frames, median "
            f"{np.median(seconds):.2f} s, mean {seconds.mean():.2f}, p90 {np.quantile(seconds, 0.9):.1f}; "
            f"operations median {np.median(repairs):g}; one key {np.mean(repairs == 0):.1%}; "
            f"below {AGREEMENT:.0%}: {below}"
        )


if __name__ == "__main__":
    main()
