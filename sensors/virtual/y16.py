"""Twins of thermal cameras of 16-bit words over UVC: a plain one, and a FLIR Lepton with its telemetry."""

import numpy as np
from numpy.typing import NDArray

from sensors.drivers.lepton import (
    AGC_BIT,
    EFFECTIVE_GAIN,
    FFC_BIT,
    GAIN,
    GAINS,
    RATE_HZ,
    RESOLUTION,
    ROW_WORDS,
    SIZES,
    STATUS,
    TLINEAR,
    UPTIME,
)
from sensors.drivers.y16 import Radiometry
from sensors.virtual.fake_kernel import FakeCamera
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.schedule import Faults, Schedule

NOISE_K = 0.05
"""A Lepton's stated NETD in high gain."""
IMMINENT_S, RUNNING_S = 2.0, 23 / 26
"""Seconds a flat-field correction is announced ahead, and takes (Lepton datasheet)."""
SHUTTER_C = 27.0
"""Temperature of the shutter. Chosen by eye."""
COUNTS_AT_20_C, COUNTS_PER_K = 8000.0, 25.0
"""Raw counts of a camera without temperatures. Chosen by eye."""
COUNTS = Radiometry(1 / COUNTS_PER_K, 20 - COUNTS_AT_20_C / COUNTS_PER_K)
FIRST_MS = 2**32 - 2000
"""The Lepton's clock starts again at 0 two seconds after the start, which a real one does after 49 days."""


class VirtualY16(FakeCamera):
    """A camera whose words are temperatures by ``radiometry``; by default counts. hurry: times its real rate.

    shape: of its image (h, w).
    """

    kind = "y16"

    def __init__(
        self,
        scene: FrameLoop,
        faults: Faults | None = None,
        radiometry: Radiometry = COUNTS,
        rate_hz: float = RATE_HZ,
        shape: tuple[int, int] = (120, 160),
        below: int = 0,
        hurry: float = 1.0,
    ) -> None:
        scene.thermal(0)
        super().__init__((shape[1], shape[0] + below), Schedule(hurry * rate_hz, faults))
        self._scene, self._radiometry, self._rate_hz, self._hurry = scene, radiometry, rate_hz, hurry
        self._shape = shape
        rng = np.random.default_rng(0)
        self._noise = rng.normal(0, NOISE_K, (2 * shape[0], shape[1])).astype(np.float32)

    def celsius(self, number: int) -> NDArray[np.float32]:
        """What image ``number`` should show, float32 (h, w)."""
        (height, width), scene = self._shape, self._scene.thermal(number / self._rate_hz)
        noise = self._noise[number * 7 % height :][:height]
        if height > scene.shape[0]:
            finer = -(-height // scene.shape[0])
            scene = np.repeat(np.repeat(scene, finer, axis=0), finer, axis=1)[:height, :width]
        step = scene.shape[0] // height
        return np.asarray(scene[::step, ::step] + noise, np.float32)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """The image alone."""
        words = np.rint((self.celsius(number) - self._radiometry.offset_c) / self._radiometry.scale)
        return np.asarray(words.clip(0, 65535), np.uint16)


class VirtualLepton(VirtualY16):
    """A Lepton 3.5, or a 2.5 by its shape. kelvin: of one step; None for raw counts.

    ffc_every_s: seconds from one flat-field correction to the next; the one at the start is done already.
    """

    kind = "lepton"

    def __init__(
        self,
        scene: FrameLoop,
        faults: Faults | None = None,
        kelvin: float | None = 0.01,
        shape: tuple[int, int] = (120, 160),
        gain: str = "high",
        agc: bool = False,
        ffc_every_s: float = 180.0,
        hurry: float = 1.0,
    ) -> None:
        radiometry = COUNTS if kelvin is None else Radiometry(kelvin)
        size = next(size for size, image in SIZES.items() if image == shape)
        super().__init__(scene, faults, radiometry, RATE_HZ, shape, size[1] - shape[0], hurry)
        self._kelvin, self._gain, self._agc, self._ffc_every_s = kelvin, gain, agc, ffc_every_s

    def ffc_state(self, number: int) -> int:
        """1 imminent, 2 running, 3 done."""
        ahead_s = self._ffc_every_s - number / RATE_HZ % self._ffc_every_s
        return 2 if ahead_s <= RUNNING_S else 1 if ahead_s <= RUNNING_S + IMMINENT_S else 3

    def celsius(self, number: int) -> NDArray[np.float32]:
        """What image ``number`` should show, or the shutter."""
        if self.ffc_state(number) == 2:
            return np.full(self._shape, SHUTTER_C, np.float32)
        return super().celsius(number)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """The image and its telemetry."""
        image = super().uvc_frame(number)
        below = np.zeros((self.size[1] - self._shape[0], self.size[0]), np.uint16)
        rows = below.reshape(-1, ROW_WORDS)
        uptime_ms = FIRST_MS + round(1000 * self._hurry * self.schedule.device_s(number))
        status = self.ffc_state(number) << FFC_BIT | self._agc << AGC_BIT
        for at, value in ((UPTIME, uptime_ms), (STATUS, status)):
            rows[at], rows[at[0], at[1] + 1] = value & 0xFFFF, value >> 16 & 0xFFFF
        rows[GAIN], rows[EFFECTIVE_GAIN] = GAINS.index(self._gain), 1
        rows[TLINEAR], rows[RESOLUTION] = self._kelvin is not None, self._kelvin == 0.01
        return np.concatenate([image, below])
