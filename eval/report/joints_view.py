"""Joints found from parts, as the page shows them: PCK by threshold, error by joint."""

import math
from dataclasses import dataclass

import numpy as np

from eval.compare.results import Result
from eval.scores.joint_errors import summary

THRESHOLDS_MM = tuple(range(0, 301, 10))
"""Of the PCK curve."""


@dataclass(frozen=True)
class JointRow:
    """One joint: where it was found, its mean error in millimetres; share within 100 mm of all scored."""

    name: str
    scored: int
    found: int
    mpjpe_mm: float
    pck_100mm: float


@dataclass(frozen=True)
class JointsView:
    """A result's joints. pck: share of the scored joints within each of `THRESHOLDS_MM`."""

    title: str
    frames: int
    scored: int
    found: int
    mpjpe_mm: float
    pck: list[float]
    rows: list[JointRow]


def joints_of(result: Result) -> JointsView | None:
    """None where the truth knew no joints."""
    errors = result.comparison.joints_mm
    if errors is None or np.isnan(errors).all():
        return None
    total = summary(errors)
    scored = errors[~np.isnan(errors)]
    return JointsView(
        result.title,
        frames=total["frames"],
        scored=total["scored"],
        found=total["found"],
        mpjpe_mm=_number(total["mpjpe_mm"]),
        pck=[float((scored <= limit).mean()) for limit in THRESHOLDS_MM],
        rows=[
            JointRow(
                name.replace("_", " ").capitalize(),
                own["scored"],
                own["found"],
                _number(own["mpjpe_mm"]),
                _number(own["pck_100mm"]),
            )
            for name, own in total["by_joint"].items()
        ],
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value
