"""The pyrometer as reference for the thermal camera: its drift as an offset, and a gain where there is one.

Both have to look at the same spot with the same emissivity; a camera drifts by a kelvin or two between its
flag cycles, the pyrometer does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError
from sensors.rig.camera import FloatArray

FEWEST = 5
GAIN_RANGE_K = 10.0
"""Over a smaller range of temperatures the pair's noise would make up the gain."""
GAIN_LIMITS = (0.8, 1.25)
MAD_TO_SD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class Drift:
    """true = gain * camera + offset_c. sd_c: spread of single pairs about it; pairs: how many there were."""

    offset_c: float
    gain: float
    sd_c: float
    pairs: int

    def correct(self, celsius: FloatArray) -> NDArray[np.float32]:
        """The camera's temperatures as the pyrometer would have measured them; NaN stays NaN."""
        return (self.gain * np.asarray(celsius, np.float64) + self.offset_c).astype(np.float32)


def fit_drift(camera_c: FloatArray, reference_c: FloatArray) -> Drift:
    """Drift of a camera from pairs of readings (n,), NaN pairs left out; bears a third of wild pairs.

    Offset is the median difference; the gain is Theil and Sen's (median slope over all pairs of pairs), and
    1 where the temperatures span less than GAIN_RANGE_K. Raises CalibrationError for too few pairs or a
    gain that no drift explains.
    """
    camera, reference = np.asarray(camera_c, np.float64), np.asarray(reference_c, np.float64)
    good = np.isfinite(camera) & np.isfinite(reference)
    camera, reference = camera[good], reference[good]
    if len(camera) < FEWEST:
        raise CalibrationError(
            f"only {len(camera)} pairs of camera and pyrometer; record at least {FEWEST} with the flag open"
        )
    gain = _slope(camera, reference) if np.ptp(np.percentile(camera, (10, 90))) >= GAIN_RANGE_K else 1.0
    if not GAIN_LIMITS[0] <= gain <= GAIN_LIMITS[1]:
        raise CalibrationError(
            f"camera and pyrometer differ by a factor of {gain:.2f}; "
            "point both at one spot, with one emissivity"
        )
    left = reference - gain * camera
    offset = float(np.median(left))
    return Drift(offset, gain, MAD_TO_SD * float(np.median(np.abs(left - offset))), len(camera))


def _slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Theil and Sen's slope, over at most some 500 values."""
    step = -(-len(x) // 500)
    x, y = x[::step], y[::step]
    first, second = np.triu_indices(len(x), 1)
    across = x[second] - x[first]
    apart = np.abs(across) > 1.0
    return float(np.median((y[second] - y[first])[apart] / across[apart]))
