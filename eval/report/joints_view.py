"""Joints found from parts, as the page shows them: PCK by threshold, error by joint."""

from dataclasses import dataclass

import numpy as np

from eval.joint_errors import summary
from eval.joints import JOINT_NAMES
from eval.results import Result

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
    rows = []
    for name, own in zip(JOINT_NAMES, errors.T, strict=True):
        own = own[~np.isnan(own)]
        met = own[np.isfinite(own)]
        mean = float(met.mean()) if met.size else np.nan
        within = float((own <= 100).mean()) if own.size else np.nan
        rows.append(JointRow(name.replace("_", " ").capitalize(), own.size, met.size, mean, within))
    return JointsView(
        result.title,
        frames=int((~np.isnan(errors)).any(1).sum()),
        scored=scored.size,
        found=int(np.isfinite(scored).sum()),
        mpjpe_mm=float(total["mpjpe_mm"]) if isinstance(total["mpjpe_mm"], int | float) else np.nan,
        pck=[float((scored <= limit).mean()) for limit in THRESHOLDS_MM],
        rows=rows,
    )
