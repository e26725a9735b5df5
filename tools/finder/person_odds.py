"""Fit the odds of detected persons: ``python -m tools.finder.person_odds SEED ROOMS``.

SEED: of the first of ROOMS groups of ten random and ten close rooms, training cast; give rooms that neither
network was trained on. A detection is a person as in ``eval.training.finder.verification_examples``. The
tool fits on three of four groups and prints the scores on the fourth. Then it fits on all groups and writes
odds.json, one model for each number of stages.
"""

import json
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy.optimize import minimize

from annotate.array_types import Bool, Float64
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.detection.finder import find_people
from annotate.person.detection.odds import FEATURES, LIKELY_ODDS, ONE_STAGE, SURE_ODDS, TWO_STAGES, Evidence
from eval.training.finder.verification_examples import truths
from eval.training.rooms.close_rooms import close_scenes
from eval.training.rooms.scenes import Scene, room_scenes
from sensors.rig.rig_calibration import RigCalibration

OUT = Path(__file__).resolve().parents[2] / "annotate" / "person" / "detection" / "odds.json"
Row: TypeAlias = tuple[Evidence, bool, int]
"""Evidence for a detection, whether it is a person, and its group."""
SHRINK = 1e-3  # weight of the squared weights in the loss; untuned


def examples(scene: Scene) -> Iterator[tuple[Evidence, bool]]:
    """Yield the evidence for each detection in a scene and whether it is a person."""
    cloud = CoarseCloud.of(Fuser(RigCalibration(scene.camera)).fuse(scene.depth_mm))
    unfelt = np.full(cloud.cloud.depth_mm.shape, np.nan, np.float32)
    persons = np.where(cloud.pixel >= 0, scene.persons.ravel()[cloud.pixel], np.uint8(0))
    people = find_people(cloud.cloud, unfelt, least_odds=-np.inf)
    known = truths([person.mask for person in people], persons)
    for person, truth in zip(people, known, strict=True):
        if truth is not None:
            yield person.evidence, truth


def fitted(features: Float64, is_person: Bool) -> Float64:
    """Return the weights (F,) of least log loss of features (n, F)."""
    sign = np.where(is_person, 1.0, -1.0)

    def loss(weights: Float64) -> tuple[float, Float64]:
        odds = sign * (features @ weights)
        slope = -(sign / (1 + np.exp(odds))) @ features / len(features)
        lost = np.logaddexp(0, -odds).mean() + SHRINK * np.square(weights).sum()
        return float(lost), slope + 2 * SHRINK * weights

    return np.asarray(minimize(loss, np.zeros(features.shape[1]), jac=True, method="L-BFGS-B").x)


def scores(odds: Float64, is_person: Bool) -> str:
    """Return the scores of log odds (n,): calibration error, persons and false ones above the thresholds."""
    chance = 1 / (1 + np.exp(-odds))
    bins = np.minimum((chance * 10).astype(int), 9)
    off = sum(abs(chance[bins == b].sum() - is_person[bins == b].sum()) for b in range(10)) / len(odds)
    above = (
        f"at odds of {least}: {np.mean(odds[is_person] >= least):.3f} of the persons, "
        f"{np.sum(odds[~is_person] >= least)} of {np.sum(~is_person)} false ones"
        for least in (LIKELY_ODDS, SURE_ODDS)
    )
    return "; ".join([f"calibration error {off:.3f}", *above])


def main() -> None:
    """Fit, print the held-out scores, and write the weights."""
    seed, rooms = (int(word) for word in sys.argv[1:])
    rows = [
        (*example, group)
        for group in range(rooms)
        for scene in chain(room_scenes(seed + group), close_scenes(seed + group))
        for example in examples(scene)
    ]
    models: dict[str, list[Row]] = {
        ONE_STAGE: [(evidence._replace(shape_odds=None), truth, group) for evidence, truth, group in rows],
        TWO_STAGES: [row for row in rows if row[0].shape_odds is not None],
    }
    written = {name: dict(zip(FEATURES, model(chosen), strict=False)) for name, chosen in models.items()}
    OUT.write_text(json.dumps(written, indent=1) + "\n")


def model(rows: list[Row]) -> list[float]:
    """Print the held-out scores of a model; return its weights (F,)."""
    evidence, known, group = zip(*rows, strict=True)
    features, truth = np.stack([one.features for one in evidence]), np.array(known)
    held = np.array(group) % 4 == 0
    print(scores(features[held] @ fitted(features[~held], truth[~held]), truth[held]))
    return [round(float(weight), 4) for weight in fitted(features, truth)]


if __name__ == "__main__":
    main()
