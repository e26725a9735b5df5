"""Twin of the vendor's libirdirectsdk.so: the same C interface as C function pointers."""

from ctypes import POINTER, c_ushort, cast, memmove, pointer, sizeof

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import Flag
from sensors.drivers.optris import HEIGHT, WIDTH
from sensors.drivers.optris_direct import PROTOTYPES, DirectLibrary, FrameMetadata
from sensors.virtual.frame_loop import FrameLoop, Noise
from sensors.virtual.kinect2 import Pointer
from sensors.virtual.schedule import Faults, Schedule, UnpluggedError, c_functions
from sensors.virtual.v4l2 import FLAG_CLOSED_S

RATE_HZ = 128.0
NOISE_K = 0.08
SERIAL = 13_110_042
WAIT_S = 0.1
QUEUE = 16


class VirtualDirect:
    """A PI200 behind ``library``: temperatures with noise, frozen while the flag (shutter) is closed."""

    def __init__(self, scene: FrameLoop, faults: Faults | None = None, flag_every_s: float = 12.0) -> None:
        scene.thermal(0)
        self._scene, self._flag_every_s = scene, flag_every_s
        self.schedule = Schedule(RATE_HZ, faults, QUEUE)
        self.emissivity = 1.0
        self._open, self._received = False, 0
        self._noise = Noise(NOISE_K, (HEIGHT, WIDTH))
        self.library = DirectLibrary(**c_functions(PROTOTYPES, self))

    def unplug(self) -> None:
        """Make every further call fail; idempotent."""
        self.schedule.stop()

    def _usb_init(self, config: bytes, formats: bytes | None, log: bytes | None) -> int:
        if self._open:
            return -1
        self._open = True
        self.schedule.start()
        return 0

    def _get_serial(self, serial: Pointer) -> int:
        serial[0] = SERIAL
        return 0

    def _get_thermal_image_size(self, width: Pointer, height: Pointer) -> int:
        width[0], height[0] = WIDTH, HEIGHT
        return 0

    def _get_thermal_image_metadata(
        self, width: Pointer, height: Pointer, data: Pointer, metadata: Pointer
    ) -> int:
        try:
            number = self.schedule.wait(WAIT_S)
        except UnpluggedError:
            return -1
        if number is None or (width[0], height[0]) != (WIDTH, HEIGHT):
            return -1
        flag, shown = self._flag(number)
        self._received += 1
        device_s = self.schedule.device_s(number + 1)
        head = FrameMetadata(self._received, number, round(device_s * 1e7), 0, flag.value, 38.1, 35.2, 33.9)
        memmove(metadata, pointer(head), sizeof(head))
        values = self._values(shown)
        memmove(cast(data, POINTER(c_ushort)), values.tobytes(), values.nbytes)
        return 0

    def _flag(self, number: int) -> tuple[Flag, int]:
        """Return the state of the flag and the number of the image shown, frozen while it is closed."""
        cycle = round(self._flag_every_s * RATE_HZ)
        closing = cycle - round(FLAG_CLOSED_S * RATE_HZ)
        at = number % cycle
        if at < closing:
            return Flag.OPEN, number
        state = {closing: Flag.CLOSING, cycle - 1: Flag.OPENING}.get(at, Flag.CLOSED)
        return state, number - at + closing - 1

    def _values(self, number: int) -> NDArray[np.uint16]:
        celsius = self._scene.thermal(number / RATE_HZ) + self._noise(number)
        return np.asarray(np.clip(np.rint(celsius * 10 + 1000), 0, 65535), np.uint16)

    def _set_radiation_parameters(self, emissivity: float, transmissivity: float, ambient_c: float) -> int:
        self.emissivity = emissivity
        return 0

    def _terminate(self) -> int:
        self._open = False
        self.schedule.stop()
        return 0
