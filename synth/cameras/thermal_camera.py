"""The thermal camera: lens, noise, drift, and the flag that closes now and then."""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Float32, Float64
from synth.surface.rasterize import ZBuffer

SUPERSAMPLE = 3
"""Renders per FIR pixel side: its silhouette pixels mix person and background, as real ones do."""
FLAG_EVERY_S = (12.0, 22.0)
"""The automatic flag closes after 12 s or more (Optris PI series manual); the upper end has no source."""
FLAG_CLOSED_S = 0.5
"""So long it freezes the image (Optris PI series manual: about 500 ms)."""
DRIFT_PERIODS_S = (45.0, 90.0, 240.0)
"""Periods of the drift, a warming camera's and its flag's; no source but that it is slow."""


@dataclass(frozen=True)
class ThermalNoise:
    """The FIR camera's faults; 0 or False switches one off.

    netd_c: noise-equivalent temperature difference. blur_px: the lens, standard deviation. drift_c: how far
    the common error of all pixels strays at most. flag: whether the flag closes.
    """

    netd_c: float = 0.08
    blur_px: float = 0.6
    drift_c: float = 1.0
    flag: bool = True


class ThermalState:
    """What of the camera changes over a recording: its drift, and when its flag is closed."""

    def __init__(self, noise: ThermalNoise, rng: np.random.Generator) -> None:
        self.noise = noise
        self._phases = rng.uniform(0, 2 * np.pi, len(DRIFT_PERIODS_S))
        self._flag_rng = rng
        self._closes_s = [float(rng.uniform(0, FLAG_EVERY_S[1]))]

    def drift_c(self, time_s: float) -> float:
        """Error of all pixels at a time, within plus and minus ``noise.drift_c``."""
        waves = np.sin(2 * np.pi * time_s / np.array(DRIFT_PERIODS_S) + self._phases)
        return float(self.noise.drift_c * waves.mean())

    def flag_closed(self, time_s: float) -> bool:
        """Whether the camera looks at its own flag at a time >= 0."""
        if not self.noise.flag:
            return False
        while self._closes_s[-1] <= time_s:
            self._closes_s.append(self._closes_s[-1] + float(self._flag_rng.uniform(*FLAG_EVERY_S)))
        return any(0 <= time_s - closes < FLAG_CLOSED_S for closes in self._closes_s[-2:])


def thermograph(
    seen: ZBuffer,
    celsius: Float64,
    ambient_c: float,
    noise: ThermalNoise,
    drift_c: float,
    maps: tuple[Float32, Float32],
    rng: np.random.Generator,
) -> Float32:
    """A supersampled pinhole render and face temperatures (F,) -> float32 (h, w) degrees Celsius.

    maps: where each distorted supersampled pixel looks in the render (cv2.remap's x and y).
    """
    table = np.append(celsius, ambient_c).astype(np.float32)
    fine = cv2.remap(table[seen.face], *maps, interpolation=cv2.INTER_NEAREST)
    height, width = fine.shape[0] // SUPERSAMPLE, fine.shape[1] // SUPERSAMPLE
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    if noise.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), noise.blur_px)
    grain = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(noise.netd_c)
    return np.asarray(image + grain + np.float32(drift_c), np.float32)
