"""Fit the odds of detected persons: ``python -m tools.fit.person_odds SEED ROOMS``.

SEED: of the first of ROOMS groups of ten random rooms, training cast, which the finder has not seen. A
detection is a person if half of it shows one person, and none if less than a fifth shows people; others are
left out. Every fourth group is held out: the tool prints what it gains there, fits on all and writes
annotate/person/odds.json.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from annotate.array_types import Bool, Float64
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.finder import find_people
from annotate.person.odds import FEATURES, LIKELY_ODDS, SURE_ODDS
from eval.training.finder.scenes import Scene, room_scenes
from sensors.rig.rig_calibration import RigCalibration

OUT = Path(__file__).resolve().parents[2] / "annotate" / "person" / "odds.json"
OF_ONE, OF_ANY = 0.5, 0.2  # shares of a detection: least on one person, most on people of a false one
SHRINK = 1e-3  # weight of the squared weights in the loss; untuned


def examples(scene: Scene) -> Iterator[tuple[Float64, bool]]:
    """Yield the features (F,) of each detection in a scene and whether it is a person."""
    cloud = CoarseCloud.of(Fuser(RigCalibration(scene.camera)).fuse(scene.depth_mm))
    unfelt = np.full(cloud.cloud.depth_mm.shape, np.nan, np.float32)
    persons = np.where(cloud.pixel >= 0, scene.persons.ravel()[cloud.pixel], np.uint8(0))
    for person in find_people(cloud.cloud, unfelt, least_odds=-np.inf):
        shares = np.bincount(persons[person.mask], minlength=2)[1:] / np.count_nonzero(person.mask)
        if shares.max() >= OF_ONE or shares.sum() < OF_ANY:
            yield person.evidence.features, bool(shares.max() >= OF_ONE)


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
        for scene in room_scenes(seed + group)
        for example in examples(scene)
    ]
    features, is_person, group = (np.array(column) for column in zip(*rows, strict=True))
    held = group % 4 == 0
    print(scores(features[held] @ fitted(features[~held], is_person[~held]), is_person[held]))
    weights = fitted(features, is_person).round(4).tolist()
    OUT.write_text(json.dumps(dict(zip(FEATURES, weights, strict=True)), indent=1) + "\n")


if __name__ == "__main__":
    main()
