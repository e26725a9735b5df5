"""Thermal camera: lens, noise, lag, drift and flag (calibration shutter)."""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Float32, Float64
from synth.cameras.optics import Lens
from synth.surface.rasterize import ZBuffer

FLAG_EVERY_S = (12.0, 22.0)  # 12 s or more (Optris PI manual); upper end untuned
FLAG_CLOSED_S = 0.5  # Optris PI manual: about 500 ms
LAG_SHARES = 3  # images whose mean is a lagging image
DRIFT_PERIODS_S = (45.0, 90.0, 240.0)  # untuned


@dataclass(frozen=True)
class ThermalNoise:
    """Faults of a thermal camera; 0 or False switches a fault off.

    netd_c: noise-equivalent temperature difference. blur_px: standard deviation of the blur. drift_c:
    greatest error common to all pixels. flag: True if the flag closes at times. lag_s: time constant of the
    pixels. late_s: greatest delay to the depth image.
    """

    netd_c: float = 0.08
    blur_px: float = 0.6
    drift_c: float = 1.0
    flag: bool = True
    flag_closed_s: float = FLAG_CLOSED_S
    flag_every_s: tuple[float, float] = FLAG_EVERY_S
    lag_s: float = 0.0
    late_s: float = 0.0

    def delays_s(self, rng: np.random.Generator) -> list[float]:
        """Draw the ages, seconds before the depth image, of the scenes whose mean the thermal image shows.

        The ages are quantiles of an exponential response.
        """
        late_s = rng.uniform(-self.late_s, self.late_s) if self.late_s > 0 else 0.0
        if self.lag_s == 0:
            return [late_s]
        middles = (np.arange(LAG_SHARES) + 0.5) / LAG_SHARES
        return [late_s - self.lag_s * float(np.log(1 - middle)) for middle in middles]


class ThermalState:
    """State of a thermal camera over a recording: drift and flag."""

    def __init__(self, noise: ThermalNoise, rng: np.random.Generator) -> None:
        self.noise = noise
        self._phases = rng.uniform(0, 2 * np.pi, len(DRIFT_PERIODS_S))
        self._flag_rng = rng
        self._closes_s = [float(rng.uniform(0, noise.flag_every_s[1]))]

    def drift_c(self, time_s: float) -> float:
        """Return the error common to all pixels at a time, in degrees Celsius."""
        waves = np.sin(2 * np.pi * time_s / np.array(DRIFT_PERIODS_S) + self._phases)
        return float(self.noise.drift_c * waves.mean())

    def flag_closed(self, time_s: float) -> bool:
        """Return True if the flag is closed at a time of at least 0 s."""
        if not self.noise.flag:
            return False
        while self._closes_s[-1] <= time_s:
            wait_s = float(self._flag_rng.uniform(*self.noise.flag_every_s))
            self._closes_s.append(self._closes_s[-1] + wait_s)
        return any(0 <= time_s - closes < self.noise.flag_closed_s for closes in self._closes_s[-2:])


def warmth_seen(seen: ZBuffer, celsius: Float64, ambient_c: float) -> Float32:
    """Return the temperatures (h, w) of a render's pixels; celsius: (F,) of the faces."""
    return np.append(celsius, ambient_c).astype(np.float32)[seen.face]


def through_lens(warm: Float32, lens: Lens) -> Float32:
    """Return a supersampled pinhole image resampled to the camera's pixels (h, w); edge pixels are mixed."""
    fine = cv2.remap(warm, *lens.maps, interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.resize(fine, lens.camera.shape[::-1], interpolation=cv2.INTER_AREA), np.float32)


def thermograph(image: Float32, noise: ThermalNoise, drift_c: float, rng: np.random.Generator) -> Float32:
    """Return the thermal image (h, w) of true temperatures, degrees Celsius, with blur, noise and drift."""
    if noise.blur_px > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), noise.blur_px), np.float32)
    grain = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(noise.netd_c)
    return np.asarray(image + grain + np.float32(drift_c), np.float32)
