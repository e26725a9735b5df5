"""The thermal camera: lens, noise, lag, drift, and the flag that closes now and then."""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Float32, Float64
from synth.cameras.optics import Lens
from synth.surface.rasterize import ZBuffer

FLAG_EVERY_S = (12.0, 22.0)
"""The automatic flag closes after 12 s or more (Optris PI series manual); the upper end has no source."""
FLAG_CLOSED_S = 0.5
"""So long it freezes the image (Optris PI series manual: about 500 ms)."""
LAG_SHARES = 3
"""Images of which a lagging one is the mean. Chosen by eye."""
DRIFT_PERIODS_S = (45.0, 90.0, 240.0)
"""Periods of the drift, a warming camera's and its flag's; no source but that it is slow."""


@dataclass(frozen=True)
class ThermalNoise:
    """The FIR camera's faults; 0 or False switches one off.

    netd_c: noise-equivalent temperature difference. blur_px: the lens, standard deviation. drift_c: how far
    the common error of all pixels strays at most. flag: whether the flag closes, for how long, and after how
    long again, least and most. lag_s: time constant of the pixels. late_s: how far the nearest thermal image
    is from the depth image at most.
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
        """How long before the depth image that was which the thermal image shows, each in equal shares.

        The answer of a pixel falls off exponentially: its quantiles in the middle of each share.
        """
        late_s = rng.uniform(-self.late_s, self.late_s) if self.late_s > 0 else 0.0
        if self.lag_s == 0:
            return [late_s]
        middles = (np.arange(LAG_SHARES) + 0.5) / LAG_SHARES
        return [late_s - self.lag_s * float(np.log(1 - middle)) for middle in middles]


class ThermalState:
    """State of the camera over a recording: its drift, and when its flag is closed."""

    def __init__(self, noise: ThermalNoise, rng: np.random.Generator) -> None:
        self.noise = noise
        self._phases = rng.uniform(0, 2 * np.pi, len(DRIFT_PERIODS_S))
        self._flag_rng = rng
        self._closes_s = [float(rng.uniform(0, noise.flag_every_s[1]))]

    def drift_c(self, time_s: float) -> float:
        """Error of all pixels at a time, within plus and minus ``noise.drift_c``."""
        waves = np.sin(2 * np.pi * time_s / np.array(DRIFT_PERIODS_S) + self._phases)
        return float(self.noise.drift_c * waves.mean())

    def flag_closed(self, time_s: float) -> bool:
        """Whether the camera looks at its own flag at a time >= 0."""
        if not self.noise.flag:
            return False
        while self._closes_s[-1] <= time_s:
            self._closes_s.append(
                self._closes_s[-1] + float(self._flag_rng.uniform(*self.noise.flag_every_s))
            )
        return any(0 <= time_s - closes < self.noise.flag_closed_s for closes in self._closes_s[-2:])


def warmth_seen(seen: ZBuffer, celsius: Float64, ambient_c: float) -> Float32:
    """Temperatures (h, w) of what a pinhole render shows; celsius: (F,) of the faces."""
    return np.append(celsius, ambient_c).astype(np.float32)[seen.face]


def through_lens(warm: Float32, lens: Lens) -> Float32:
    """A supersampled pinhole image of temperatures as the lens maps it to the camera's pixels (h, w).

    Silhouette pixels mix person and background, as real ones do.
    """
    fine = cv2.remap(warm, *lens.maps, interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.resize(fine, lens.camera.shape[::-1], interpolation=cv2.INTER_AREA), np.float32)


def thermograph(image: Float32, noise: ThermalNoise, drift_c: float, rng: np.random.Generator) -> Float32:
    """True temperatures (h, w) as the camera reads them, float32 degrees Celsius."""
    if noise.blur_px > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), noise.blur_px), np.float32)
    grain = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(noise.netd_c)
    return np.asarray(image + grain + np.float32(drift_c), np.float32)
