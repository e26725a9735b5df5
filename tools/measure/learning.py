"""Gain and harm of ``learn`` on simulated sets: ``python -m tools.measure.learning FOLDER``.

A set has frames of one to three scenes with another person in each, labelled by a suit or by depth alone.
The first frames of "Most useful first" get their true labels as corrections. Each line has the change that
``learn`` reports, and the true change on all other frames, also where ``learn`` refuses the network. Finished
sets are kept in FOLDER/results.jsonl; the same command continues.
"""

import argparse
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from annotate.correction.correction import Correction
from annotate.correction.teaching_order import teaching_order
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import TOLERANCE_PX
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from annotate.suit.palette import load_suit
from eval.fine_tuning.cross_validation import Gain
from eval.fine_tuning.fine_tune import fine_tune, fine_tuner_of
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions
from eval.network.predict_source import predict_source
from eval.network.refine import shipped_refinement_network
from sensors.rig.frame import RigFrame
from sensors.session.reader import Session
from synth.data_files import CASTS, Cast
from synth.rig.simulate import simulate, suit_path, truth_path
from synth.rig.truth import Truth
from synth.rig.virtual_rig import RigOptions, VirtualRig

PERIOD_NS = 500_000_000  # between two frames of the joined recording
RESULTS = "results.jsonl"


@dataclass(frozen=True)
class Mixture:
    """Recording to learn from: ``frames`` frames of one person in each of the scenes."""

    scenes: tuple[str, ...]
    frames: int
    difficulty: str
    seed: int
    cast: Cast

    @property
    def name(self) -> str:
        """Return the file name of the recording, without its ending."""
        return f"{self.cast}-{'-'.join(self.scenes)}-{self.difficulty}-{self.seed}"


class MixedRig:
    """Virtual rigs one after another, with one suit and one calibration, as one recording."""

    def __init__(self, mixture: Mixture) -> None:
        first = VirtualRig(1, 1, mixture.difficulty, mixture.seed, RigOptions(cast=mixture.cast))
        self.rigs = [
            VirtualRig(
                mixture.frames,
                1,
                mixture.difficulty,
                mixture.seed + n,
                RigOptions(scene, cast=mixture.cast, suit=first.suit, draft=True),
            )
            for n, scene in enumerate(mixture.scenes)
        ]
        one = self.rigs[0]
        self.calibration, self.suit, self.scheme = one.calibration, one.suit, one.scheme
        self.difficulty, self.rig, self.cast, self.seed = one.difficulty, one.rig, one.cast, mixture.seed
        self.name, self.scene, self.subjects = mixture.name, "+".join(mixture.scenes), len(self.rigs)

    def with_truth(self) -> Iterator[tuple[RigFrame, Truth]]:
        """Yield every frame with its truth, numbered through all scenes."""
        number = 0
        for rig in self.rigs:
            for frame, truth in rig.with_truth():
                yield replace(frame, index=number, stamp_ns=number * PERIOD_NS), truth
                number += 1


def quiet(what: str, total: int) -> AbstractContextManager[Any]:
    """Show no progress."""
    return nullcontext(lambda count: None)


def labelled(mixture: Mixture, suit: bool, folder: Path) -> tuple[Path, Path]:
    """Return recording and label set of a mixture; make what an earlier run has not made."""
    session = folder / f"{mixture.name}.mcap"
    out = session.with_suffix(".suit" if suit else ".depth")
    if not session.exists():
        simulate(MixedRig(mixture), session, lambda count: None, overwrite=True)  # type: ignore[arg-type]
    source = Session(session)
    if suit:
        label_source(source, SuitLabeller(load_suit(suit_path(session))), out, lambda count: None)
    else:
        options = PredictOptions(room_refiner=shipped_refinement_network())
        predict_source(source, OnnxNetwork(), out, lambda count: None, options)
    return session, out


def taught(labels: Path, truth: LabelSet, count: int, out: Path) -> Path:
    """Copy a label set and accept the true labels of the ``count`` frames that teach most."""
    if out.exists():
        shutil.rmtree(out)
    shutil.copytree(labels, out)
    with Correction.open(out, "annotator") as correction:
        for frame_id in teaching_order(correction)[:count]:
            editor = correction.edit(frame_id)
            editor.replace("paint", truth.read(frame_id).parts)
            editor.judge("accept")
    return out


def agreements(labels: LabelSet, truth: LabelSet, frame_ids: Sequence[str]) -> list[float]:
    """Return the agreement of frames with the truth."""
    found = []
    for frame_id in frame_ids:
        known = truth.read(frame_id)
        scorer = Agreement(known.parts, known.depth_mm > 0, TOLERANCE_PX)
        found.append(scorer.of(labels.read(frame_id).parts))
    return found


def measured(mixture: Mixture, suit: bool, count: int, folder: Path) -> dict[str, Any]:
    """Return what ``learn`` reports for ``count`` taught frames of a mixture, and the truth on the rest."""
    session, labels = labelled(mixture, suit, folder)
    truth = LabelSet.open(truth_path(session))
    work, out = (labels.with_name(f"{labels.name}-{count}{end}") for end in ("", "-tuned"))
    taught(labels, truth, count, work)
    shutil.rmtree(out, ignore_errors=True)
    known = LabelSet.open(work)
    with patch.object(Gain, "is_certain", True):  # a refused network is measured too
        done = fine_tune(work, out, fine_tuner_of(known, session if suit else None, None), quiet)
    assert done.labels is not None
    learnt = LabelSet.open(done.labels)
    change = np.subtract(*(agreements(labels, truth, learnt.frame_ids) for labels in (learnt, known)))
    return {**asdict(done.gain), "accepted": done.gain.is_certain, "true_change": float(change.mean())}


def planned(seed: int, cast: Cast, frames: int) -> Iterator[tuple[Mixture, bool, int]]:
    """Yield mixture, suit, and number of taught frames of every set: mixed sets and single scenes in turn."""
    mixes = [
        ("sofa", "bed"),
        ("chair", "floor"),
        ("sofa", "chair", "bed"),
        ("bed", "floor"),
        ("chair", "sofa"),
    ]
    for n, scenes in enumerate(mixes):
        for many, parts in ((True, scenes), (False, scenes[:1])):
            mixture = Mixture(parts, frames if many else 2 * frames, "hard", seed + 10 * n, cast)
            for suit in (False, True):
                for count in (4, 8):
                    yield mixture, suit, count


def main() -> None:
    """Measure the sets that are missing in the results, and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=31000)
    parser.add_argument("--cast", choices=CASTS, default="training")
    parser.add_argument("--frames", type=int, default=12, help="frames of each scene of a mixed set")
    given = parser.parse_args()
    os.nice(10)
    given.folder.mkdir(parents=True, exist_ok=True)
    results = given.folder / RESULTS
    lines = results.read_text().splitlines() if results.exists() else []
    known = {json.loads(line)["set"] for line in lines}
    for mixture, suit, count in planned(given.seed, given.cast, given.frames):
        name = f"{mixture.name} {'suit' if suit else 'depth'} {count}"
        if name in known:
            continue
        found = {"set": name, **measured(mixture, suit, count, given.folder)}
        with results.open("a") as file:
            file.write(json.dumps(found) + "\n")
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
