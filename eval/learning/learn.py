"""Learning from corrections: a network fitted to them, and its labels of frames nobody has worked on."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import nn

from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.crop import person_of
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import TOLERANCE_PX
from annotate.frame_labels import FrameLabels
from annotate.label_source import notes_of
from annotate.labelset.appearing import appearing
from annotate.labelset.claim import Claim, login
from annotate.labelset.store import MANIFEST, LabelSet
from annotate.parts import BACKGROUND
from annotate.reader.segmentation import Segmentation
from eval.learning.folder import RECORD, RUN, check_own
from eval.learning.lesson import Taught, crops_of, divided, lessons
from eval.network.checkpoint import load_weights, save_weights
from eval.network.networks import NetworkConfig, export_onnx
from eval.network.onnx_network import OnnxNetwork
from eval.network.steady import steady
from eval.training.augment import Augmentation
from eval.training.loader import ProcessGroup
from eval.training.plan import ModernRecipe, Plan
from eval.training.train import Watch, train
from sensors.errors import ExistsError
from sensors.files.atomic import write_bytes

WEIGHTS, LABELS = "weights.onnx", "labels"
STEPS, ALL_STEPS = 120, 60
"""Steps on the frames that are not held out, and then on all of them: two minutes of one core. Chosen by
eye."""
BATCH = 4
"""Crops of a step. Chosen by eye."""
RECIPE = ModernRecipe(batch=BATCH, peak_rate=1e-3, averaged=0.9, coarse=0.0, statistics=False)
"""A third of a training's rate, and normalisation as it came: a few frames of one person are no statistics.
Chosen by eye."""
HOW = Augmentation(occluders=False, cuts=False, borders=False, extras=False)
"""What may happen to a frame: what hides the person and what is taken along is this room's own."""
CHECKPOINT_S = 20.0
"""Seconds of work that a kill loses at most. Chosen by eye."""


@dataclass(frozen=True)
class Learnt:
    """Result of learning. frames: corrected ones; held_out: those measured on before they were learnt too.

    before, after: mean agreement within 2 px on these, of their first labels and of the network's; None where
    none was held out. labels: the set with labels of the frames nobody has worked on.
    """

    frames: int
    held_out: int
    before: float | None
    after: float | None
    weights: Path
    labels: Path

    @property
    def better(self) -> bool:
        """Whether there is no sign that it got worse."""
        return self.before is None or self.after is None or self.after > self.before


def learn(path: Path, out: Path, start: Path, advance: Callable[[int], None]) -> Learnt:
    """Learn from the accepted frames of the label set at ``path``; nothing in it is changed.

    out: folder for the network and its labels; a killed run goes on there. start: weights (.safetensors) to
    start from. advance: called with the number of images seen. Raises CloudError where there is too little to
    learn from, ExistsError where ``out`` is something else, ClaimedError while another process learns there.
    """
    taught = lessons(path)
    check_own(out)
    out.mkdir(parents=True, exist_ok=True)
    with Claim.take(out, login()):
        network, config = load_weights(start)
        school, held = divided(taught)
        network = _fitted(network.float(), config, school, STEPS, out / RUN / "some", advance)
        before, after = _measured(network, held, out)
        network = _fitted(network, config, taught, ALL_STEPS, out / RUN / "all", advance)
        weights = out / WEIGHTS
        save_weights(weights.with_suffix(".safetensors"), network, config)
        export_onnx(network, weights)
        _label(path, OnnxNetwork(weights), out / LABELS)
        done = Learnt(len(taught), len(held), before, after, weights, out / LABELS)
        record = {**asdict(done), "weights": WEIGHTS, "labels": LABELS}
        write_bytes(out / RECORD, (json.dumps(record, indent=1) + "\n").encode())
        shutil.rmtree(out / RUN, ignore_errors=True)
    return done


def images() -> int:
    """Images that a whole run sees, for its progress."""
    return BATCH * (STEPS + ALL_STEPS)


def _fitted(
    network: nn.Module,
    config: NetworkConfig,
    taught: Sequence[Taught],
    steps: int,
    run: Path,
    advance: Callable[[int], None],
) -> nn.Module:
    """A network after so many steps; goes on with what ``run`` holds of the same training."""
    crops, plan = crops_of(taught, steps * BATCH), Plan(config, RECIPE, HOW, epochs=1)
    alone, watch = ProcessGroup(0, 1, torch.device("cpu")), Watch(advance, checkpoint_s=CHECKPOINT_S)
    fit = partial(train, crops, None, run, plan, alone, watch, network)
    try:
        return fit()[0]
    except ExistsError:
        # Of other corrections than there are now.
        shutil.rmtree(run)
        return fit()[0]


def _measured(network: nn.Module, held: Sequence[Taught], out: Path) -> tuple[float | None, float | None]:
    """Mean agreement of the first labels and of the network's with frames it has not learnt."""
    if not held:
        return None, None
    trial = out / RUN / "trial.onnx"
    export_onnx(network, trial)
    judge, scores = OnnxNetwork(trial), []
    for one in held:
        truth = Agreement(one.corrected.parts, one.first.depth_mm > 0, TOLERANCE_PX)
        scores.append((truth.of(one.first.parts), truth.of(segmented(judge, one.first).parts)))
    before, after = np.mean(scores, axis=0).tolist()
    return before, after


def segmented(network: OnnxNetwork, first: FrameLabels) -> Segmentation:
    """A frame by the network: first, its first labels, say where the person was extracted."""
    mask = person_of(first.parts)
    found, body = network.segment(first.depth_mm, mask), network.without_things(first.depth_mm, mask)
    parts = np.where(body, found.parts, np.uint8(BACKGROUND))
    return replace(found, parts=parts, confidence=np.where(body, found.confidence, np.float32(0)))


def _label(path: Path, network: OnnxNetwork, out: Path) -> None:
    """Label the frames of the set at ``path`` that nobody has worked on, as a set of their own."""
    before: FrameLabels | None = None
    with (
        Correction.open(path, read_only=True) as correction,
        appearing(out, MANIFEST, path, overwrite=True) as folder,
    ):
        labels = correction.labels
        info = {"source": labels.source, "steps": {"predict": {"weights": network.sha256}}}
        learnt = LabelSet.create(folder, labels.intrinsics, info)
        for frame_id in untouched(correction):
            first = labels.read(frame_id, original=labels.has_original(frame_id))
            found = steady(segmented(network, first), before)
            notes = notes_of(found)
            before = replace(first, parts=found.parts, confidence=found.confidence, notes=notes, persons=None)
            learnt.write(before)
