"""Tables measured on the virtual rig."""

import math
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from time import process_time
from typing import NamedTuple

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
from eval.scores.counts import FrameCounts
from eval.scores.intervals import UNKNOWN
from eval.scores.joint_scores import JointErrors
from eval.scores.scores import scores_of
from sensors.recording.rig_templates import TEMPLATES
from sensors.session.reader import Session
from synth.data_files import JUDGE
from synth.rig.simulate import simulate, truth_path
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tools.figures import worst_frames
from tools.figures.figure import (
    Figure,
    Rows,
    Statistic,
    average,
    median,
    of_values,
    over_people,
    ratio,
    without_each,
)
from tools.figures.parallel import each
from tools.figures.reliability import reliability
from tools.measure import pyrometer

SCENES, DIFFICULTIES = ("sofa", "chair", "bed", "floor"), ("normal", "hard")
FRAMES, PEOPLE = 320, 8  # of a recording
REFINED = "network, refined"
FULLY_MEASURED = "sofa"  # scene of the network alone, and of the confidence
DRIFTS, DRIFT_FRAMES = 8, 20  # recordings of two people each
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
    """Ignore the progress of a simulation."""


def figures_of(found: Comparison) -> dict[str, Figure]:
    """Return frames and scores of a comparison, with intervals over its people as in ``evaluate``."""
    sums = found.by_cluster if found.n_subjects > 1 else found.by_cluster[:0]
    rows = {"frames": Figure(len(found.frame_ids))}
    for heading, name in SCORES.items():
        ends = map(float, found.ci95[name]) if len(sums) else (math.nan, math.nan)
        without = without_each(
            sums, lambda counts, name=name: scores_of(FrameCounts(counts, found.scheme))[name]
        )
        rows[heading] = Figure(float(found.scores[name]), *ends, without)
    return rows


class Recording(NamedTuple):
    """A simulated recording of eight people of the judging cast, 40 frames of each."""

    scene: str
    difficulty: str
    seed: int

    @property
    def rig(self) -> VirtualRig:
        """Return its virtual rig."""
        return VirtualRig(FRAMES, PEOPLE, self.difficulty, self.seed, RigOptions(self.scene, cast=JUDGE))

    @property
    def name(self) -> str:
        """Return scene and difficulty as a row of a table has them."""
        return f"{self.scene}, `{self.difficulty}`"


def recordings(seed: int) -> list[Recording]:
    """Return a recording of each scene and difficulty, each with its own seed."""
    pairs = product(SCENES, DIFFICULTIES)
    return [Recording(scene, difficulty, seed + n) for n, (scene, difficulty) in enumerate(pairs)]


def labels(seed: int) -> Rows:
    """Measure labels by the suit and by the refined network, in each scene and difficulty."""
    measured = measured_recordings(seed).items()
    return {f"{one.name}: {name}": row for one, found in measured for name, row in found.rows.items()}


class Labelled(NamedTuple):
    """Rows of a recording, the errors of the network's joints, and the worst frames."""

    rows: dict[str, dict[str, Figure]]
    joints: JointErrors
    worst: worst_frames.Sheets


def sheets(seed: int) -> worst_frames.Sheets:
    """Return the worst frames of all recordings, by the suit's labels, the network's and its joints."""
    return worst_frames.together(found.worst for found in measured_recordings(seed).values())


@lru_cache(maxsize=1)
def measured_recordings(seed: int) -> dict[Recording, Labelled]:
    """Return the measures of each recording; two tables of one run share them."""
    jobs = recordings(seed)
    return dict(zip(jobs, each(labelled, jobs, (job.name for job in jobs)), strict=True))


def labelled(recording: Recording) -> Labelled:
    """Measure a recording's labels; on the sofa also the labels of the network alone, and the confidence."""
    rig = recording.rig
    with simulated(rig) as (folder, session, truth):
        refined = PredictOptions(room_refiner=shipped_refinement_network())
        works = {
            "suit": lambda out, at: label_source(session, SuitLabeller(rig.suit), out, at),
            "network": lambda out, at: predict_source(session, OnnxNetwork(), out, at),
            REFINED: lambda out, at: predict_source(session, OnnxNetwork(), out, at, refined),
        }
        if recording.scene != FULLY_MEASURED:
            del works["network"]
        found = {name: timed(partial(work, folder / name)) for name, work in works.items()}
        compared = {name: compare_sets(made, truth, workers=1) for name, (made, _) in found.items()}
        rows = {
            name: figures_of(compared[name]) | {"CPU seconds a frame": Figure(seconds)}
            for name, (_, seconds) in found.items()
        }
        joints = compared[REFINED].joints
        assert joints is not None
        if recording.scene == FULLY_MEASURED:
            sure = reliability(found["suit"][0], truth, session)
            rows["suit"] |= {"calibration error": Figure(sure.ece), "found first": Figure(sure.found_first)}
        drawn = {
            "rig-suit": worst_frames.of_labels(compared["suit"], found["suit"][0], truth),
            "rig-predict": worst_frames.of_labels(compared[REFINED], found[REFINED][0], truth),
            "rig-joints": worst_frames.of_joints(compared[REFINED], found[REFINED][0], truth),
        }
    return Labelled(rows, joints, drawn)


def timed(work: Callable[[Callable[[int], None]], Run]) -> tuple[LabelSet, float]:
    """Return a run's labels and its CPU seconds a frame (all threads; median of blocks of 20)."""
    ends: list[float] = []
    run = work(lambda n: ends.append(process_time()))
    return run.labels, float(np.median(np.diff(ends[20::20])) / 20)


def cameras(seed: int) -> Rows:
    """Measure labels by suit and network on every rig's cameras, the same eight people on a sofa."""
    found = each(_camera, [(name, seed) for name in TEMPLATES], TEMPLATES)
    return {f"`{name}`": row for name, row in zip(TEMPLATES, found, strict=True)}


def _camera(job: tuple[str, int]) -> dict[str, Figure]:
    name, seed = job
    rig = VirtualRig(16, PEOPLE, "normal", seed, RigOptions(rig=name, cast=JUDGE))
    with simulated(rig) as (folder, session, truth):
        suit = label_source(session, SuitLabeller(rig.suit), folder / "suit", ignore).labels
        network = predict_source(session, OnnxNetwork(), folder / "network", ignore).labels
        sets = (suit, network)
        by_suit, by_network = (figures_of(compare_sets(labels, truth, workers=1)) for labels in sets)
    return {
        "frames": by_suit["frames"],
        "person IoU": by_suit["person IoU"],
        "recall, suit": by_suit["mean recall"],
        "recall, network": by_network["mean recall"],
    }


def effort(seed: int) -> Rows:
    """Measure a simulated annotator's corrections of labels by the suit, 64 frames of eight people."""
    jobs = [(difficulty, seed + number) for number, difficulty in enumerate(DIFFICULTIES)]
    rows = each(_effort, jobs, DIFFICULTIES)
    return {f"`{difficulty}`": row for difficulty, row in zip(DIFFICULTIES, rows, strict=True)}


def _effort(job: tuple[str, int]) -> dict[str, Figure]:
    difficulty, seed = job
    rig = VirtualRig(64, PEOPLE, difficulty, seed, RigOptions(cast=JUDGE))
    with simulated(rig) as (folder, session, truth):
        found = label_source(session, SuitLabeller(rig.suit), folder / "labels", ignore).labels
        annotator = Annotator()
        with Correction.open(found.path, WHO, clock=annotator.clock) as correction:
            done = list(correct_set(correction, truth, annotator, lambda i: None))
        people = [truth.read(one.corrected.frame_id).subject or UNKNOWN for one in done]
    seconds = [one.seconds for one in done]

    def share(flags: Iterable[bool]) -> Figure:
        return over_people(np.array([(flag, 1) for flag in flags], np.int64), people, ratio)

    return {
        "frames": Figure(len(done)),
        "median, s": of_values(seconds, people, median),
        "mean, s": of_values(seconds, people, average),
        "one key": share(one.repairs == 0 for one in done),
        "right in the end": share(one.agreement >= AGREEMENT for one in done),
    }


def drift(seed: int) -> Rows:
    """Measure temperatures of people at `hard`, where thermal cameras drift, without and with a pyrometer.

    The intervals are over recordings, because people of one recording share its drift.
    """
    jobs = [(seed + number, DRIFT_FRAMES) for number in range(DRIFTS)]
    found = each(_drift, jobs, (f"recording {number + 1}" for number in range(DRIFTS)))
    off, ious = ([(str(number), row) for number, one in enumerate(found) for row in one[k]] for k in range(2))

    def figure(rows: list[tuple[str, list[float]]], k: int, statistic: Statistic) -> Figure:
        return of_values([row[k] for _, row in rows], [number for number, _ in rows], statistic)

    return {
        name: {
            "frames": Figure(len(off)),
            "off, K": figure(off, k, median),
            "person IoU, temperatures found": figure(ious, k, average),
            "person IoU, fixed": figure(ious, 2 + k, average),
        }
        for k, name in enumerate(("without", "with"))
    }


def _drift(job: tuple[int, int]) -> tuple[list[list[float]], list[list[float]]]:
    return pyrometer.measure(*job)
