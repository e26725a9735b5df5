"""Measures of the shipped network: on synthetic images, and on real people."""

import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.parts import PAPER
from eval.compare.compare import Comparison, compare_sets
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import predict_frames
from eval.scores.confusion import left_right_swap_rate, mean_recall
from synth.data_files import JUDGE
from synth.images.generate import Order, generate
from synth.images.presets import preset_named
from synth.images.workers import Workers
from tools.figures import worst_frames
from tools.figures.figure import Figure, Rows, over_people, ratio
from tools.figures.parallel import each
from tools.measure import real_people
from tools.measure.network_groups import CHANGES, Tally, measured

SETS = {"sitting-test": 400, "recumbent": 400, "upright": 400, "people": 720, "standing": 720}
"""Images by preset."""
LEAST = 50  # images of a group that gets a row, and of a posture that posture is measured among


def by_preset(seed: int) -> Rows:
    """Measure the shipped network by preset; each preset has its own seed."""
    sets = {name: found.tallies["all"] for name, found in judged(seed).items()}
    return {f"`{name}`": scores(tally, several_postures(tally)) for name, tally in sets.items()}


def by_kind(seed: int) -> Rows:
    """Measure the shipped network by kind of image."""
    rows: dict[str, dict[str, Figure]] = {}
    for name, (tallies, *_) in judged(seed).items():
        has_postures = several_postures(tallies["all"])
        if preset_named(name).described:
            groups = sorted(tallies.keys() - CHANGES.keys() - {"all"})
            groups += [change for change in CHANGES if name == "standing"]
            large = (group for group in groups if len(tallies[group].subjects) >= LEAST)
            rows |= {f"`{name}`, {group}": scores(tallies[group], has_postures) for group in large}
    return rows


class Judged(NamedTuple):
    """Counts of a preset's images by group, their comparison with the truth, and the worst images."""

    tallies: dict[str, Tally]
    compared: Comparison
    worst: worst_frames.Sheets


def sheets(seed: int) -> worst_frames.Sheets:
    """Return the worst images of each preset, and those with the worst joints."""
    return worst_frames.together(found.worst for found in judged(seed).values())


@lru_cache(maxsize=1)
def judged(seed: int) -> dict[str, Judged]:
    """Return the measures of the shipped network by preset; two tables of one run share them."""
    jobs = [(name, count, seed + number) for number, (name, count) in enumerate(SETS.items())]
    return dict(zip(SETS, each(_judged, jobs, SETS), strict=True))


def _judged(job: tuple[str, int, int]) -> Judged:
    """Generate images of a preset of the judging cast, and measure them."""
    name, count, seed = job
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as thread:
        out, workers = Path(folder) / "d", Workers(thread, 1)
        made = generate(Order(preset_named(name, JUDGE), count, seed), out, workers, lambda n: None)
        network = OnnxNetwork().in_scheme(PAPER)
        labels = predict_frames(made.dataset, network, Path(folder) / "p", lambda n: None).labels
        compared = compare_sets(labels, made.dataset, workers=1)
        drawn = {
            name: worst_frames.of_labels(compared, labels, made.dataset),
            "images-joints": worst_frames.of_joints(compared, labels, made.dataset),
        }
        return Judged(dict(measured(network, out)), compared, drawn)


def several_postures(tally: Tally) -> bool:
    """Return whether a set has at least ``LEAST`` images of each of two postures."""
    counted = Counter(name for name in tally.true_postures if name)
    return sum(count >= LEAST for count in counted.values()) > 1


def scores(tally: Tally, has_postures: bool) -> dict[str, Figure]:
    """Return figures of a group of images. has_postures: True if a wrong posture was possible."""
    matrices, people = np.array(tally.matrices), tally.subjects
    flags = {"facing to 20 degrees": tally.facing} | ({"posture": tally.posture} if has_postures else {})
    known = {name: np.array(pairs) for name, pairs in flags.items() if np.any([k for _, k in pairs])}
    return {
        "images": Figure(len(people)),
        "mean recall": over_people(matrices, people, mean_recall),
        "swaps": over_people(matrices, people, partial(left_right_swap_rate, scheme=PAPER)),
        **{name: over_people(pairs, people, ratio) for name, pairs in known.items()},
    }


ACTIONS = {
    "a1": "an arm swiped to the left",
    "a9": "drawing a circle",
    "a22": "jogging on the spot",
    "a23": "walking on the spot",
    "a24": "standing up from a seat",
    "a27": "a squat",
}
"""Actions of UTD-MHAD by the first letters of a take's name."""


TAKES, FRAMES = "all takes", "single frames of 27 actions"


def real(seed: int) -> Rows:
    """Measure the shipped network on real people, by take and together; the seed is not used."""
    takes, frames = {}, {}
    for folder, found in people().items():
        action, *who = folder.name.split("_")
        (takes if who else frames)[f"{ACTIONS[action]} (`{folder.name}`)" if who else FRAMES] = found
    first, *others = takes.values()
    together = {TAKES: sum(others, first)}
    return {name: _row(found) for name, found in (frames | together | takes).items()}


@lru_cache(maxsize=1)
def people() -> dict[Path, real_people.People]:
    """Return the measures of the shipped network by folder of real people; two tables share them."""
    network = OnnxNetwork()
    return {folder: real_people.measure_people(folder, network) for folder in real_people.folders()}


def sheets_of_people(seed: int) -> worst_frames.Sheets:
    """Return the worst frames of real people; the seed is not used."""
    return worst_frames.together({"real-people": found.tiles} for found in people().values())


def _row(found: real_people.People) -> dict[str, Figure]:
    near = np.stack([found.off_deg <= real_people.NEAR_DEG, np.ones(len(found.off_deg))], axis=-1)
    joints = {
        "joints right": real_people.mean_hit_rate,
        "on the other side": real_people.swap_rate,
        "by more than 3 px": real_people.far_swap_rate,
    }
    return {
        "images": Figure(len(near)),
        **{name: over_people(found.joints, found.subjects, score) for name, score in joints.items()},
        "facing to 30 degrees": over_people(near.astype(np.int64), found.subjects, ratio),
    }
