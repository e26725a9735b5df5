"""Verdict on a calibration: whether it is reliable, and which views to add if it is not."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibrate.bundle import Adjusted
from sensors.rig.camera import Intrinsics

LIMIT_ROTATION_DEG, LIMIT_LATERAL_MM, LIMIT_AXIAL_MM = 0.1, 1.0, 2.0
"""Two deviations beyond these shift the edge of a person at 2 m by a third of a thermal pixel."""
LIMIT_PX = {"depth": 0.2, "color": 0.4, "thermal": 0.2}  # rms; untuned (published: 0.06, 0.38 at 80 x 62)
LIMIT_COVERAGE = 0.35  # least share of an image's cells with holes: beyond, the lens is extrapolated; untuned
CELLS = 8  # of an image's side; untuned


class Finding(NamedTuple):
    """Result of one check. text: sentence with the number; remedy: "" if the check passed."""

    text: str
    remedy: str = ""


def judge(found: Adjusted) -> tuple[bool, list[Finding]]:
    """Return whether all checks passed, and their findings."""
    findings = [_residual(name, seen.rms_px) for name, seen in found.residuals.items()]
    sizes = vars(found.calibration)
    findings += [_coverage(name, seen.px, sizes[name]) for name, seen in found.residuals.items()]
    for name, sd in found.deviations.items():
        turn, shift = 2 * sd.rotation_deg.max(), 2 * sd.translation_mm
        weak = turn > LIMIT_ROTATION_DEG or shift[:2].max() > LIMIT_LATERAL_MM or shift[2] > LIMIT_AXIAL_MM
        text = (
            f"{name}: pose known to {turn:.3f} degrees, {shift[:2].max():.2f} mm sideways, "
            f"{shift[2]:.2f} mm along the view (two standard deviations)"
        )
        findings.append(Finding(text, "record more views, nearer, tilted up to 35 degrees" if weak else ""))
    findings.append(_bad_views(found))
    return not any(finding.remedy for finding in findings), findings


def _residual(name: str, rms_px: float) -> Finding:
    blurred = rms_px > LIMIT_PX[name]
    remedy = "hold the plate still, light it evenly, check the pitch of the plate's holes" if blurred else ""
    return Finding(f"{name}: holes off by {rms_px:.3f} px (rms)", remedy)


def _coverage(name: str, px: NDArray[np.float64], camera: Intrinsics) -> Finding:
    cells = np.floor(px / (camera.width, camera.height) * CELLS).clip(0, CELLS - 1)
    share = len(np.unique(cells, axis=0)) / CELLS**2
    remedy = "move the plate into the image's corners" if share < LIMIT_COVERAGE else ""
    return Finding(f"{name}: holes seen in {share:.0%} of the image", remedy)


def _bad_views(found: Adjusted) -> Finding:
    frames = list(found.left_out)
    many = len(frames) > 0.25 * found.views
    text = f"{len(frames)} of {found.views} views left out" + (f" (frames {frames})" if frames else "")
    return Finding(text, "hold the plate still while the cameras expose" if many else "")
