"""Measures on the virtual rig: labels by the suit, the network, cameras, effort, a pyrometer, inputs."""

import tempfile
from collections.abc import Callable
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
from synth.rig.simulate import simulate, suit_path, truth_path
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tools.figures.figure import Figure, Rows, mean, median, share
from tools.measure import ablation, pyrometer, rigs
from tools.measure.labels import reliability

DIFFICULTIES = ("normal", "hard")
SCORES = {
    "person IoU": "person_iou",
    "mean recall": "mean_recall",
    "boundary F, 2 px": "boundary_f",
    "swaps": "left_right_swap_rate",
}
"""Scores of a comparison by the heading of their column."""


def figures_of(found: Comparison) -> dict[str, Figure]:
    """Frames and scores of a comparison, with intervals over its people."""
    return {"frames": Figure(len(found.frame_ids))} | {
        heading: Figure(float(found.scores[name]), *map(float, found.ci95[name]))
        for heading, name in SCORES.items()
    }


def labels(seed: int) -> Rows:
    """Labels by the suit and by the network, 320 frames of eight people on a sofa a difficulty."""
    rows: dict[str, dict[str, Figure]] = {}
    for number, difficulty in enumerate(DIFFICULTIES):
        rig = VirtualRig(320, 8, difficulty, seed + number)
        with tempfile.TemporaryDirectory() as folder:
            for name, row in labelled(rig, Path(folder)).items():
                rows[f"`{difficulty}`, {name}"] = row
    return rows


def labelled(rig: VirtualRig, folder: Path) -> dict[str, dict[str, Figure]]:
    """Figures of a recording's labels, by the suit and by the network."""
    path = folder / "session.mcap"
    simulate(rig, path, lambda n: None)
    session, truth = Session(path), LabelSet.open(truth_path(path))
    works = {
        "suit": partial(label_source, session, SuitLabeller(rig.suit), folder / "suit"),
        "network": partial(predict_source, session, OnnxNetwork(), folder / "network"),
        "network, refined": partial(
            predict_source,
            session,
            OnnxNetwork(),
            folder / "again",
            options=PredictOptions(refiners=[shipped_refinement_network()]),
        ),
    }
    found = {name: timed(work) for name, work in works.items()}
    sure = reliability(found["suit"][0], truth, session)
    more = {"suit": {"calibration error": Figure(sure.ece), "found first": Figure(sure.found_first)}}
    return {
        name: figures_of(compare_sets(made, truth)) | {"CPU seconds a frame": seconds} | more.get(name, {})
        for name, (made, seconds) in found.items()
    }


def timed(work: Callable[[Callable[[int], None]], Run]) -> tuple[LabelSet, Figure]:
    """Labels of a run, and the CPU seconds of a frame (of all threads), median over blocks of 20 frames."""
    ends: list[float] = []
    run = work(lambda n: ends.append(process_time()))
    return run.labels, median((np.diff(ends[20::20]) / 20).tolist())


def cameras(seed: int) -> Rows:
    """Labels by the suit and by the network before each rig's cameras: the same eight people on a sofa."""
    rows = {}
    for name in TEMPLATES:
        by_suit, by_network = map(
            figures_of, rigs.measured(VirtualRig(16, 8, "normal", seed, RigOptions(rig=name)))
        )
        rows[f"`{name}`"] = {
            "frames": by_suit["frames"],
            "person IoU": by_suit["person IoU"],
            "recall, suit": by_suit["mean recall"],
            "recall, network": by_network["mean recall"],
        }
    return rows


def effort(seed: int) -> Rows:
    """What a simulated annotator needs to correct labels by the suit, 64 frames of eight people."""
    rows = {}
    for number, difficulty in enumerate(DIFFICULTIES):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "session.mcap"
            rig = VirtualRig(64, 8, difficulty, seed + number)
            simulate(rig, path, lambda n: None)
            found = label_source(
                Session(path), SuitLabeller(rig.suit), Path(folder) / "l", lambda n: None
            ).labels
            truth = LabelSet.open(truth_path(path))
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
    """Temperatures of a person at `hard`, where they drift, without and with a pyrometer."""
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
    """The reader of suits without each of its inputs: 24 frames of eight people."""
    rows: dict[str, dict[str, Figure]] = {}
    for number, difficulty in enumerate(DIFFICULTIES):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "session.mcap"
            simulate(VirtualRig(24, 8, difficulty, seed + number), path, lambda n: None)
            assert suit_path(path).is_file()
            for name, found in ablation.measured(path):
                rows[f"`{difficulty}`: {name}"] = figures_of(found.scored) | {
                    "annotator, s": mean(found.seconds.tolist())
                }
    return rows
