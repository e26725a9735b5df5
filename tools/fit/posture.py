"""Fit the calibrated posture: ``python -m tools.fit.posture DATASET ...``; writes eval/weights/posture.json.

DATASET: of ``synth generate``. Each image is used whole, and once more cut at a random border, as by an
image's border. Every fourth person is held out: the tool prints the scores of these people with the network's
own, then fits on everybody.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from annotate.array_types import Bool, Float64, Int64
from annotate.labelset.labelled_frames import camera_of, open_frames, pinhole_of
from annotate.posture import POSTURES
from eval.network.body_state import LEAST_SURE, BodyState
from eval.network.onnx_network import OnnxNetwork
from eval.network.posture_model import FEATURES, PostureModel, posture_features
from tools.fit.suit_network import check_inputs

OUT = Path(__file__).resolve().parents[2] / "eval" / "weights" / "posture.json"
LEAST_PX = 400  # of a person after a cut
SHRINK = 0.002  # weight of the squared weights in the loss; untuned from 0.001 to 0.003


def cut(person: Bool, rng: np.random.Generator) -> Bool:
    """Return a person's pixels (h, w) without what lies below, above or beside a random border."""
    rows, columns = np.nonzero(person)
    kept = person.copy()
    match rng.choice(["below", "below", "above", "left", "right"]):
        case "below":
            kept[int(np.quantile(rows, rng.uniform(0.35, 0.97))) :] = False
        case "above":
            kept[: int(np.quantile(rows, rng.uniform(0.03, 0.35)))] = False
        case "left":
            kept[:, : int(np.quantile(columns, rng.uniform(0.05, 0.5)))] = False
        case "right":
            kept[:, int(np.quantile(columns, rng.uniform(0.5, 0.95))) :] = False
    return kept


def examples(folder: Path, network: OnnxNetwork) -> Iterator[tuple[Float64, int, str]]:
    """Yield features (F,), posture and person of a dataset's images, whole and cut."""
    rng, frames = np.random.default_rng(0), open_frames(folder)
    for frame in frames:
        person = frame.on_person & (frame.depth_mm > 0)
        if frame.notes.get("posture") not in POSTURES or not person.any():
            continue
        camera = pinhole_of(frame, camera_of(frames, frame))
        for mask in (person, cut(person, rng)):
            if np.count_nonzero(mask) >= LEAST_PX:
                state = BodyState.from_note(network.segment(frame.depth_mm, mask, camera).bearing)
                assert state is not None
                features = posture_features(state, (frame.depth_mm, mask), camera)
                yield features, POSTURES.index(frame.notes["posture"]), frame.subject


def model_of(features: Float64, postures: Int64) -> PostureModel:
    """Return the model of examples, each also used with a network in doubt.

    On sensors and rooms that the network has not seen, doubt is usual, and angles must decide.
    """
    of_network, doubted = slice(1, 1 + len(POSTURES)), features.copy()
    shares = 10 ** (features[:, of_network] * np.random.default_rng(0).random((len(features), 1)))
    doubted[:, of_network] = np.log10(shares / shares.sum(axis=1, keepdims=True))
    return fitted(np.concatenate([features, doubted]), np.tile(postures, 2))


def fitted(features: Float64, postures: Int64) -> PostureModel:
    """Return the model of least log loss of features (n, F) and postures (n,)."""
    shape = len(POSTURES), features.shape[1]
    one_hot = np.eye(len(POSTURES))[postures]

    def loss(flat: Float64) -> tuple[float, Float64]:
        weights = flat.reshape(shape)
        shares = PostureModel(weights).probabilities(features)
        slope = (shares - one_hot).T @ features / len(features) + 2 * SHRINK * weights
        lost = -np.log(shares[np.arange(len(shares)), postures] + 1e-12).mean()
        return float(lost + SHRINK * np.square(weights).sum()), slope.ravel()

    return PostureModel(minimize(loss, np.zeros(shape).ravel(), jac=True, method="L-BFGS-B").x.reshape(shape))


def scores(shares: Float64, postures: Int64) -> str:
    """Return the scores of probabilities (n, P): log loss, calibration error, right, "cannot tell"."""
    best, right = shares.max(axis=1), shares.argmax(axis=1) == postures
    bins = np.minimum((best * 10).astype(int), 9)
    off = sum(abs(best[bins == b].sum() - right[bins == b].sum()) for b in range(10)) / len(best)
    told = best >= LEAST_SURE
    loss = -np.log(shares[np.arange(len(shares)), postures] + 1e-4).mean()
    return (
        f"log loss {loss:.3f}, calibration error {off:.3f}, right {right.mean():.3f}, cannot tell "
        f"{1 - told.mean():.3f}, right of the told {right[told].mean():.3f}"
    )


def main() -> None:
    """Fit, print the held-out scores, and write the weights."""
    network, folders = OnnxNetwork(), [Path(folder) for folder in sys.argv[1:]]
    check_inputs(folders)
    rows = [row for folder in folders for row in examples(folder, network)]
    features, postures = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    _, person = np.unique([row[2] for row in rows], return_inverse=True)
    held = person % 4 == 0
    own = 10 ** features[held, 1 : 1 + len(POSTURES)]
    print("network:", scores(own / own.sum(axis=1, keepdims=True), postures[held]))
    kept = model_of(features[~held], postures[~held])
    print("model:", scores(kept.probabilities(features[held]), postures[held]))
    weights = model_of(features, postures).weights.round(4).tolist()
    named = {name: dict(zip(FEATURES, row, strict=True)) for name, row in zip(POSTURES, weights, strict=True)}
    OUT.write_text(json.dumps(named, indent=1) + "\n")


if __name__ == "__main__":
    main()
