"""The twin of an Optris PI200 over V4L2."""

import numpy as np
from numpy.typing import NDArray

from sensors.drivers.optris import HEIGHT, WIDTH, Layout, pack
from sensors.virtual.fake_kernel import FakeCamera
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.schedule import Faults, Schedule

COUNTS_AT_20_C, COUNTS_PER_K, FLAG_COUNTS = 8000.0, 25.0, 8150
"""Counts at 20 C, per kelvin above it, and of the closed flag. Chosen by eye."""
NOISE_COUNTS = 2.0
"""0.08 K, the camera's stated NETD."""
FLAG_CLOSED_S = 0.5
"""Seconds of a flag cycle with the flag closed. Chosen by eye."""


class VirtualOptris(FakeCamera):
    """The camera.

    flag_every_s: seconds from one flag cycle to the next, 12 chosen by eye. The kernel's clock counts seconds
    since the start here. One reader at a time.
    """

    kind = "optris"

    def __init__(
        self, layout: Layout, scene: FrameLoop, faults: Faults | None = None, flag_every_s: float = 12.0
    ) -> None:
        scene.thermal(0)
        super().__init__((layout.width, layout.height), Schedule(layout.uvc_hz, faults))
        self.layout, self._scene, self._flag_every_s = layout, scene, flag_every_s
        rng = np.random.default_rng(0)
        self._noise = rng.normal(0, NOISE_COUNTS, (2 * HEIGHT, WIDTH)).astype(np.float32)

    def counts(self, number: int) -> NDArray[np.uint16]:
        """Thermal image ``number`` as uint16 (120, 160) counts."""
        seconds = number / self.layout.thermal_hz
        noise = self._noise[number * 7 % HEIGHT :][:HEIGHT]
        if seconds % self._flag_every_s >= self._flag_every_s - FLAG_CLOSED_S:
            return np.asarray(np.rint(FLAG_COUNTS + noise), np.uint16)
        kelvin = self._scene.thermal(seconds) - 20
        counts = np.rint(COUNTS_AT_20_C + COUNTS_PER_K * kelvin + noise)
        return np.asarray(np.clip(counts, 0, 65535), np.uint16)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """UVC frame ``number`` as words (height, width); metadata is the running number, then its index."""
        n = self.layout.subframes
        images = range(n * number, n * (number + 1))
        words = [np.array([at & 0xFFFF, *range(1, 13)], np.uint16) for at in images]
        return pack(self.layout, [(self.counts(at), w) for at, w in zip(images, words, strict=True)])
