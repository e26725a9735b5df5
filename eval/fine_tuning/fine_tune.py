"""Learning from corrections: a network is fitted to them, and labels the frames that nobody has worked on."""

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import TOLERANCE_PX
from annotate.frame_labels import FrameLabels
from annotate.labelset.atomic_folder import appearing
from annotate.labelset.claim import Claim, login
from annotate.labelset.label_set import MANIFEST, LabelSet
from eval.fine_tuning.by_depth import DepthLearner
from eval.fine_tuning.by_suit import SuitLearner, suit_step
from eval.fine_tuning.folder import RECORD, RUN, check_own
from eval.fine_tuning.training_split import Taught, divided, lessons
from eval.training.segmentation.fit import Progress
from sensors.files.atomic import write_bytes

WEIGHTS, LABELS = "weights.onnx", "labels"
"""What a learning leaves in its folder: the adapted network, and the set with its labels."""


class Learner(Protocol):
    """What labelled a set, and adapts to its corrections."""

    def learn(self, taught: Sequence[Taught], more: bool, run: Path, progress: Progress) -> None:
        """Adapt to these frames; more: after some of them. run: folder from which a killed run goes on."""
        ...

    def save(self, path: Path) -> None:
        """Write the adapted weights (.onnx)."""
        ...

    def parts(self, held: Sequence[Taught], weights: Path) -> list[UInt8]:
        """Parts (h, w) that saved weights give these frames, in the place of their first labels."""
        ...

    def step(self, weights: Path) -> dict[str, Any]:
        """Entry of a label set's manifest about saved weights."""
        ...

    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Labels of the frames that nobody has worked on, by saved weights."""
        ...


@dataclass(frozen=True)
class Learnt:
    """Result of learning. frames: corrected ones; held_out: those measured on before they were learnt too,
    measured_on: their ids.

    before, after: mean agreement within 2 px on these, of their first labels and of those learnt. weights,
    labels: the adapted network, and the set with its labels of the frames nobody has worked on; None where
    it is no better: then what labelled the set stays.
    """

    frames: int
    held_out: int
    before: float
    after: float
    measured_on: tuple[str, ...] = ()
    weights: Path | None = None
    labels: Path | None = None

    @property
    def better(self) -> bool:
        """Whether it is, on frames that it had not learnt."""
        return self.after > self.before


def learner_of(labels: LabelSet, session: Path | None, start: Path | None) -> Learner:
    """The reader that learns of a label set: as its suit was read, or from depth and the first labels.

    session: recording of the labels, of people in a suit only; None = the one beside them. start: weights to
    start from; None = the shipped ones. Raises CloudError where one of them is missing or does not fit.
    """
    return SuitLearner(labels, session, start) if suit_step(labels) else DepthLearner(labels, start)


def learn(path: Path, out: Path, learner: Learner, progress: Progress) -> Learnt:
    """Learn from the accepted frames of the label set at ``path``; nothing in it is changed.

    out: folder for the network and its labels; a killed run goes on there. Raises CloudError where there is
    too little to learn from, ExistsError where ``out`` is something else, ClaimedError while another process
    learns there.
    """
    taught = lessons(path)
    check_own(out)
    (out / RUN).mkdir(parents=True, exist_ok=True)
    with Claim.take(out, login()):
        school, held = divided(taught)
        learner.learn(school, False, out / RUN, progress)
        ids = tuple(one.first.frame_id for one in held)
        done = Learnt(len(taught), len(held), *_measured(learner, held, out / RUN / WEIGHTS), ids)
        if done.better:
            learner.learn(taught, True, out / RUN, progress)
            learner.save(out / WEIGHTS)
            _label(path, learner, out, progress)
            done = replace(done, weights=out / WEIGHTS, labels=out / LABELS)
        names = {"weights": WEIGHTS, "labels": LABELS} if done.better else {}
        write_bytes(out / RECORD, (json.dumps(asdict(done) | names, indent=1) + "\n").encode())
        shutil.rmtree(out / RUN, ignore_errors=True)
    return done


def _measured(learner: Learner, held: Sequence[Taught], trial: Path) -> tuple[float, float]:
    """Mean agreement of the first labels and of the learner's with frames it has not learnt."""
    learner.save(trial)
    scores = []
    for one, parts in zip(held, learner.parts(held, trial), strict=True):
        truth = Agreement(one.corrected.parts, one.first.depth_mm > 0, TOLERANCE_PX)
        scores.append((truth.of(one.first.parts), truth.of(parts)))
    before, after = np.mean(scores, axis=0).tolist()
    return before, after


def _label(path: Path, learner: Learner, out: Path, progress: Progress) -> None:
    """Label the frames of the set at ``path`` that nobody has worked on, as a set of their own."""
    with (
        Correction.open(path, read_only=True) as correction,
        appearing(out / LABELS, MANIFEST, path, overwrite=True) as folder,
        progress("label, frames", len(untouched(correction))) as advance,
    ):
        labels = correction.labels
        info = {"source": labels.source, "steps": learner.step(out / WEIGHTS)}
        learnt = LabelSet.create(folder, labels.intrinsics, info)
        for labelled in learner.labels(correction, out / WEIGHTS):
            learnt.write(labelled)
            advance(1)
