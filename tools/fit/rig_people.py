"""Write label sets of the virtual rig's people, to train on: ``python -m tools.fit.rig_people FOLDER N``.

FOLDER/NUMBER, for N recordings of those that train the suit network, has the true regions of every person
that is found, within the outline found: with some of the bed, or without a hand. ``annotate-cloud train
FOLDER/* DATASET... --out RUN`` trains on them. The same command resumes an interrupted run.
"""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.person.extract import PersonDetection
from annotate.scheme.scheme import BACKGROUND
from annotate.scheme.scheme_file import load_scheme
from eval.training.segmentation.scenes import training_rig
from eval.training.shared_bodies import BODIES
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import VirtualRig

RESTING = {"sofa": "sitting", "chair": "sitting", "bed": "lying"}
"""Postures of the scenes in which all persons have the same."""


def store_people(rig: VirtualRig, out: Path) -> int:
    """Write a rig's frames with a person to the new label set ``out``; return their number."""
    fuser, regions = Fuser(rig.calibration), load_scheme("atlas")
    labels = LabelSet.create(out, fuser.camera, {"source": rig.name} | scheme_note(regions))
    for frame, known in rig.with_truth():
        truth = truth_labels(frame, known, rig.calibration.depth, regions)
        person = PersonDetection(CoarseCloud.of(fuser.fuse_frame(frame)), suit=rig.suit).person()
        parts = np.where(person.mask, truth.parts, np.uint8(BACKGROUND))
        if parts.any():
            notes = truth.notes | {"posture": RESTING.get(rig.scene), BODIES: list(known.bodies)}
            labels.write(replace(truth, parts=parts, persons=None, notes=notes))
    return len(labels)


def main() -> None:
    """Write the missing label sets."""
    folder, count = Path(sys.argv[1]), int(sys.argv[2])
    for number in range(count):
        out, unfinished = folder / f"{number:04d}", folder / f"{number:04d}.unfinished"
        if not out.exists():
            shutil.rmtree(unfinished, ignore_errors=True)
            print(out, store_people(training_rig(number), unfinished), flush=True)
            unfinished.rename(out)


if __name__ == "__main__":
    main()
