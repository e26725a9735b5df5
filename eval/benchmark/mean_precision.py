"""Mean average precision of joints at 10 cm, the measure of ITOP (Haque et al., ECCV 2016).

A joint is a hit if its predicted place lies nearer than 10 cm to the true place. The precision of a joint is
its share of hits over the frames; the mean is over the joints. A frame without a prediction holds no hit. The
authors of V2V-PoseNet and A2J count all fifteen joints of all valid frames, the hidden ones too
(mks0601/V2V-PoseNet_RELEASE issue 27; zhangboshen/A2J, src/itop_side.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from eval.scores.confusion import Scores, ratio
from eval.scores.intervals import UNKNOWN, cluster_sums, clusters_of, interval, note_on, resampled_sums
from sensors.errors import CloudError

REACH_M = 0.1  # m; a nearer joint is a hit; Haque et al. 2016


@dataclass(frozen=True, eq=False)
class MeanPrecision:
    """Precision (J,) of each joint, NaN for joints not counted; their mean, and its 95 % interval over
    people.

    people: number of known people. note: a reason to doubt the interval, or "".
    """

    by_joint: Scores
    mean: float
    ci95: tuple[float, float]
    frames: int
    people: int
    note: str

    def to_json(self, joints: Sequence[str]) -> dict[str, Any]:
        """Return precisions, interval and counts as JSON; None for unknown values."""
        known = [value if np.isfinite(value) else None for value in (*self.by_joint.tolist(), *self.ci95)]
        counts = {"frames": self.frames, "people": self.people, "ci_note": self.note}
        return counts | {
            "map": self.mean,
            "ci95": known[-2:],
            "joints": dict(zip(joints, known, strict=False)),
        }


def joint_hits(predicted_m: Float64, true_m: Float64) -> Bool:
    """Return hits (F, J): predicted joints nearer than 10 cm to the true ones; False for a NaN.

    Both arguments: (F, J, 3), metres.
    """
    return np.asarray(np.linalg.norm(predicted_m - true_m, axis=-1) < REACH_M)


def mean_precision(hits: Bool, counted: Bool, subjects: Sequence[str]) -> MeanPrecision:
    """Return each joint's precision over frames, and the mean over joints.

    hits, counted: (F, J). subjects: (F,). The interval is a bootstrap over people. Raises CloudError where no
    joint counts.
    """
    rows = np.flatnonzero(counted.any(axis=1))
    people = [subjects[row] for row in rows.tolist()]
    if not people:
        raise CloudError("no frame has a visible true joint; give frames with visible true joints")
    counts = np.hstack([hits & counted, counted])[rows].astype(np.int64)
    sums = cluster_sums(counts, clusters_of(people))
    by_joint = _by_joint(counts.sum(axis=0))
    mean = _mean(by_joint)
    low, high = interval(mean, _mean(_by_joint(resampled_sums(sums))), len(sums)).tolist()
    return MeanPrecision(
        by_joint, float(mean), (low, high), len(rows), len(set(people) - {UNKNOWN}), note_on(people)
    )


def _by_joint(sums: Int64) -> Scores:
    """Return precisions (..., J) from J numbers of hits, then J numbers of counted frames (..., 2 J)."""
    return ratio(*np.split(sums, 2, axis=-1))


def _mean(by_joint: Scores) -> Scores:
    """Return the mean (...) of the known precisions (..., J)."""
    known = ~np.isnan(by_joint)
    return ratio(np.where(known, by_joint, 0.0).sum(axis=-1), known.sum(axis=-1))
