"""Scores of an exported network on crops: confusion of parts, and joints within a tenth of the trunk."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float32, Float64, Int64
from annotate.scheme.scheme import BACKGROUND
from eval.network.onnx_network import OnnxNetwork
from eval.scores.confusion import confusion_matrix, mean_recall, ratio
from eval.scores.joints import JOINT, N_JOINTS
from eval.training.body_targets import JOINTS
from eval.training.crops import Crops

NEAR = 0.1  # of the trunk's length in the image: about 5 cm
BATCH = 8
PLACES = 2  # place of the joints in the outputs after the probabilities: facing, posture, joints
SHOULDERS, HIPS = ([JOINT[f"{side}_{kind}"] for side in ("left", "right")] for kind in ("shoulder", "hip"))


@dataclass(frozen=True, eq=False)
class CropScores:
    """Counts of n crops. confusion: int64 (n, k, k). joints: int64 (n, 2), near joints and known joints."""

    confusion: Int64
    joints: Int64

    def recall(self) -> float:
        """Return the mean recall of the parts over all crops."""
        return float(mean_recall(self.confusion.sum(0)))

    def near(self) -> float:
        """Return the share of the known joints within ``NEAR`` over all crops; NaN without known joints."""
        return float(ratio(*self.joints.sum(0)))

    def by_span(self, span_of: Int64) -> Float64:
        """Return recall and near share (2, m) of each span. span_of: (n,), from 0."""
        own = [np.flatnonzero(span_of == m) for m in range(span_of.max() + 1)]
        each = [CropScores(self.confusion[crops], self.joints[crops]) for crops in own]
        return np.array([[one.recall() for one in each], [one.near() for one in each]])


def scores_on_crops(network: OnnxNetwork, crops: Crops, advance: Callable[[int], None]) -> CropScores:
    """Return the scores of a network, with labels in the scheme of the crops; advance: called with crops.

    Inside the outline each pixel gets a part of the body, as in a prediction.
    """
    matrices, joints = list[Int64](), list[Int64]()
    for start, (depth, parts) in enumerate(crops.batches(BATCH)):
        planes, *body = network.outputs(depth)
        places = (
            body[PLACES] if len(body) > PLACES else np.full((len(depth), N_JOINTS, 3), np.nan, np.float32)
        )
        truth = crops.wholes[start * BATCH :, JOINTS].reshape(-1, N_JOINTS, 3)
        for k, (seen, true) in enumerate(zip(depth > 0, parts, strict=True)):
            best = network.merged(planes[k])[1:].argmax(axis=0) + 1
            named = np.where(seen, crops.scheme.class_ids[best], np.uint8(BACKGROUND))
            matrices.append(confusion_matrix(true, named.astype(np.uint8), crops.scheme))
            joints.append(near_joints(places[k], truth[k]))
            advance(1)
    return CropScores(np.array(matrices), np.array(joints))


def near_joints(found: Float32, truth: Float32) -> Int64:
    """Return the number of found joints (15, 3) near the true ones, and of known true ones inside the crop.

    Both are in shares of the crop's side; NaN = unknown. A joint that was not found is not near. Without a
    trunk none is known.
    """
    at = truth[:, :2]
    trunk = np.linalg.norm(at[SHOULDERS].mean(axis=0) - at[HIPS].mean(axis=0))
    with np.errstate(invalid="ignore"):
        known = (np.abs(at - 0.5) < 0.5).all(axis=1) & np.isfinite(trunk)
        near = known & (np.linalg.norm(found[:, :2] - at, axis=1) < NEAR * trunk)
    return np.array([near.sum(), known.sum()])
