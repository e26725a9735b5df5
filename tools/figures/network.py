"""Measures of the shipped network: on synthetic images, and on real people."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.scores import intervals
from eval.scores.confusion import left_right_swap_rate, mean_recall
from synth.images.generate import Order, generate
from synth.images.presets import PRESETS
from synth.images.workers import processes
from tools.figures.figure import Figure, Rows, share
from tools.measure import real_people
from tools.measure.network_groups import CHANGES, Tally, measured

SETS = {"sitting-test": 512, "recumbent": 512, "upright": 512, "people": 800, "standing": 1000}
LEAST = 50  # images of a group that gets a row


def synthetic(seed: int) -> Rows:
    """Measure the shipped network by preset and kind of image; each preset has its own seed."""
    rows: dict[str, dict[str, Figure]] = {}
    for number, (name, count) in enumerate(SETS.items()):
        preset = PRESETS[name]
        with tempfile.TemporaryDirectory() as folder, processes(1) as workers:
            out = Path(folder) / "d"
            generate(Order(preset, count, seed + number), out, workers, lambda n: None)
            tallies = measured(OnnxNetwork(SHIPPED_WEIGHTS), out)
        rows[f"`{name}`"] = scores(tallies["all"], preset.each)
        if preset.described:
            groups = sorted(tallies.keys() - CHANGES.keys() - {"all"})
            groups += [change for change in CHANGES if name == "standing"]
            large = (group for group in groups if len(tallies[group].ids) >= LEAST)
            rows |= {f"`{name}`, {group}": scores(tallies[group], preset.each) for group in large}
    return rows


def scores(tally: Tally, each: int) -> dict[str, Figure]:
    """Return figures of a group of images, intervals over people; each: consecutive images of one."""
    people = np.unique([int(frame_id) // each for frame_id in tally.ids], return_inverse=True)[1]
    matrices = np.array(tally.matrices)
    flags = {"facing to 20 degrees": tally.facing, "posture": tally.posture}
    return {
        "images": Figure(len(tally.ids)),
        "mean recall": _over(people, matrices, mean_recall),
        "swaps": _over(people, matrices, left_right_swap_rate),
        **{name: _over(people, np.array(pairs), _ratio) for name, pairs in flags.items()},
    }


def _ratio(pairs: np.ndarray) -> np.ndarray:
    return pairs[..., 0] / np.where(pairs[..., 1] > 0, pairs[..., 1], np.nan)


def _over(people: np.ndarray, counts: np.ndarray, score: Callable[[np.ndarray], np.ndarray]) -> Figure:
    """Return a score of the sum of counts (F, ...), with its interval over people."""
    value, ends = intervals.frames_interval(counts.astype(np.int64), people, score)
    return Figure(float(value), *map(float, ends))


ACTIONS = {
    "a1": "an arm swiped to the left",
    "a9": "drawing a circle",
    "a22": "jogging on the spot",
    "a23": "walking on the spot",
    "a24": "standing up from a seat",
    "a27": "a squat",
}
"""Actions of UTD-MHAD by the first letters of a take's name."""


def real(seed: int) -> Rows:
    """Measure the shipped network on real people, by take; the seed is not used."""
    network = OnnxNetwork(SHIPPED_WEIGHTS)
    rows = {}
    for folder in real_people.folders():
        action, *who = folder.name.split("_")
        name = f"{ACTIONS[action]} (`{folder.name}`)" if who else "single frames of 27 actions"
        rows[name] = _row(real_people.measure_people(folder, network))
    return rows


def _row(found: real_people.People) -> dict[str, Figure]:
    off = found.off_deg
    return {
        "images": Figure(len(off)),
        "joints right": Figure(found.scored["mean_hit_rate"]),
        "on the other side": Figure(found.scored["swap_rate"]),
        "by more than 3 px": Figure(found.far_swaps),
        "facing to 30 degrees": share(int((off <= real_people.NEAR_DEG).sum()), len(off)),
        "posture standing": share(found.postures["standing"], len(off)),
    }
