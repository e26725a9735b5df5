"""Tables measured on the virtual rig."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from annotate.correction.correction import Correction
from annotate.effort.annotator import AGREEMENT, WHO, Annotator, correct_set
from annotate.label_recording import Run, SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from eval.compare.compare import Comparison, compare_sets
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions
from eval.network.predict_source import predict_source
from eval.network.refine import shipped_refinement_network
from sensors.recording.rig_templates import TEMPLATES
from sensors.session.reader import Session
from synth.rig.simulate import simulate, truth_path
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tools.figures.figure import Figure, Rows, mean, median, share
from tools.measure import ablation, pyrometer
from tools.measure.labels import reliability

DIFFICULTIES = ("normal", "hard")
SCORES = {
    "person IoU": "person_iou",
    "mean recall": "mean_recall",
    "boundary F, 2 px": "boundary_f",
    "swaps": "left_right_swap_rate",
}


@contextmanager
def simulated(rig: VirtualRig) -> Iterator[tuple[Path, Session, LabelSet]]:
    """Simulate a recording; yield its folder, the session and the truth."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.mcap"
        simulate(rig, path, ignore)
        yield Path(folder), Session(path), LabelSet.open(truth_path(path))


def ignore(count: int) -> None:
    """Ignore progress."""


def figures_of(found: Comparison) -> dict[str, Figure]:
    """Return frames and scores of a comparison, with intervals over its people."""
    return {"frames": Figure(len(found.frame_ids))} | {
        heading: Figure(float(found.scores[name]), *map(float, found.ci95[name]))
        for heading, name in SCORES.items()
    }


def labels(seed: int) -> Rows:
    """Measure labels by the suit and by the network, 320 frames of eight people on a sofa a difficulty."""
    rows: dict[str, dict[str, Figure]] = {}
    for number, difficulty in enumerate(DIFFICULTIES):
        rig = VirtualRig(320, 8, difficulty, seed + number)
        rows |= {f"`{difficulty}`, {name}": row for name, row in labelled(rig).items()}
    return rows


def labelled(rig: VirtualRig) -> dict[str, dict[str, Figure]]:
    """Measure a recording's labels, by the suit and by the network."""
    with simulated(rig) as (folder, session, truth):
        refined = PredictOptions(refiners=[shipped_refinement_network()])
        works = {
            "suit": lambda out, at: label_source(session, SuitLabeller(rig.suit), out, at),
            "network": lambda out, at: predict_source(session, OnnxNetwork(), out, at),
            "network, refined": lambda out, at: predict_source(session, OnnxNetwork(), out, at, refined),
        }
        found = {name: timed(partial(work, folder / name)) for name, work in works.items()}
        sure = reliability(found["suit"][0], truth, session)
        rows: dict[str, dict[str, Figure]] = {name: {} for name in found}
        rows["suit"] |= {"calibration error": Figure(sure.ece), "found first": Figure(sure.found_first)}
        for name, (made, seconds) in found.items():
            rows[name] |= figures_of(compare_sets(made, truth)) | {"CPU seconds a frame": seconds}
    return rows


def timed(work: Callable[[Callable[[int], None]], Run]) -> tuple[LabelSet, Figure]:
    """Return a run's labels and its CPU seconds a frame (all threads; median of blocks of 20)."""
    ends: list[float] = []
    run = work(lambda n: ends.append(process_time()))
    return run.labels, median((np.diff(ends[20::20]) / 20).tolist())


def cameras(seed: int) -> Rows:
    """Measure labels by suit and network on every rig's cameras, the same eight people on a sofa."""
    rows = {}
    for name in TEMPLATES:
        rig = VirtualRig(16, 8, "normal", seed, RigOptions(rig=name))
        with simulated(rig) as (folder, session, truth):
            suit = label_source(session, SuitLabeller(rig.suit), folder / "suit", ignore).labels
            network = predict_source(session, OnnxNetwork(), folder / "network", ignore).labels
            by_suit, by_network = (figures_of(compare_sets(labels, truth)) for labels in (suit, network))
        rows[f"`{name}`"] = {
            "frames": by_suit["frames"],
            "person IoU": by_suit["person IoU"],
            "recall, suit": by_suit["mean recall"],
            "recall, network": by_network["mean recall"],
        }
    return rows


def effort(seed: int) -> Rows:
    """Measure a simulated annotator's corrections of labels by the suit, 64 frames of eight people."""
    rows = {}
    for number, difficulty in enumerate(DIFFICULTIES):
        rig = VirtualRig(64, 8, difficulty, seed + number)
        with simulated(rig) as (folder, session, truth):
            found = label_source(session, SuitLabeller(rig.suit), folder / "labels", ignore).labels
            annotator = Annotator()
            with Correction.open(found.path, WHO, clock=annotator.clock) as correction:
                done = list(correct_set(correction, truth, annotator, lambda i: None))
        seconds = [one.seconds for one in done]
        rows[f"`{difficulty}`, each frame alone"] = {
            "frames": Figure(len(done)),
            "median, s": median(seconds),
            "mean, s": mean(seconds),
            "one key": share(sum(one.repairs == 0 for one in done), len(done)),
            "right in the end": share(sum(one.agreement >= AGREEMENT for one in done), len(done)),
        }
    return rows


def drift(seed: int) -> Rows:
    """Measure temperatures of people at `hard`, where thermal cameras drift, without and with a pyrometer."""
    off, ious = [], []
    for recording in range(4):
        one = pyrometer.measure(seed + recording, 30)
        off += one[0]
        ious += one[1]
    return {
        name: {
            "frames": Figure(len(off)),
            "off, K": median([row[k] for row in off]),
            "person IoU, temperatures found": mean([row[k] for row in ious]),
            "person IoU, fixed": mean([row[2 + k] for row in ious]),
        }
        for k, name in enumerate(("without", "with"))
    }


def inputs(seed: int) -> Rows:
    """Measure the suit network without each of its inputs: 24 frames of eight people."""
    rows: dict[str, dict[str, Figure]] = {}
    for number, difficulty in enumerate(DIFFICULTIES):
        with simulated(VirtualRig(24, 8, difficulty, seed + number)) as (folder, _, _):
            for name, found in ablation.measured(folder / "session.mcap"):
                seconds = mean(found.seconds.tolist())
                rows[f"`{difficulty}`: {name}"] = figures_of(found.scored) | {"annotator, s": seconds}
    return rows
