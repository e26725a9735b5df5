"""Temperatures from the raw words of a FLIR camera: Planck's law with five constants (ExifTool's FLIR
tables).

Formulas: Minkina and Dudzik, "Infrared Thermography" (2009), and Thermimage (gtatters, ``raw2temp``).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ZERO_C_K = 273.15
HOTTEST_K = 4000.0  # K; hotter is NaN; above the range of every thermal camera
ROOM_K = 293.15  # K; replaces a stated temperature of 0 K or less


class Radiometry(NamedTuple):
    """A camera's constants and its scene. Temperatures and b in kelvin; emissivity, window transmission and
    humidity as shares; alphas, betas and x: of the air."""

    emissivity: float
    distance_m: float
    reflected_k: float
    air_k: float
    window_k: float
    window_transmission: float
    humidity: float
    r1: float
    b: float
    f: float
    o: float
    r2: float
    alphas: tuple[float, float]
    betas: tuple[float, float]
    x: float

    def celsius(self, words: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return the temperatures of the scene (h, w); NaN for words outside the camera's range."""
        with np.errstate(all="ignore"):  # a damaged file may state any numbers
            return self._celsius(words.astype(np.float64))

    def _celsius(self, words: NDArray[np.float64]) -> NDArray[np.float32]:
        emissivity, window = _share(self.emissivity), _share(self.window_transmission)
        air = self._transmission()
        reflected = (1 - emissivity) / emissivity * self._words_of(self.reflected_k)
        before = (1 - air) / emissivity / air * self._words_of(self.air_k)
        lens = (1 - window) / emissivity / air / window * self._words_of(self.window_k)
        behind = (1 - air) / emissivity / air**2 / window * self._words_of(self.air_k)
        scene = words / emissivity / air**2 / window - before - behind - lens - reflected
        kelvin = self.b / np.log(self.r1 / (self.r2 * (scene + self.o)) + self.f)
        kelvin[~((kelvin > 0) & (kelvin < HOTTEST_K)) | (scene + self.o <= 0)] = np.nan
        return np.asarray(kelvin - ZERO_C_K, np.float32)

    def _words_of(self, kelvin: float) -> float:
        kelvin = kelvin if kelvin > 0 else ROOM_K
        return float(self.r1 / (self.r2 * (np.exp(self.b / kelvin) - self.f)) - self.o)

    def _transmission(self) -> float:
        """Return the transmission of half of the air path, as the formula applies it twice."""
        air_c = (self.air_k if self.air_k > 0 else ROOM_K) - ZERO_C_K
        exponent = 1.5587 + air_c * (0.06939 + air_c * (-0.00027816 + air_c * 0.00000068455))
        water = self.humidity * np.exp(exponent)
        way = np.sqrt(max(self.distance_m, 0.0) / 2)
        first, second = (
            np.exp(-way * (alpha + beta * np.sqrt(max(water, 0.0))))
            for alpha, beta in zip(self.alphas, self.betas, strict=True)
        )
        return _share(float(self.x * first + (1 - self.x) * second))


def _share(number: float) -> float:
    """Return a number in (0, 1] unchanged; 1, which is neutral, for other numbers."""
    return number if 0 < number <= 1 else 1.0
