"""Twin of a Kinect v2: the shim's C interface as C function pointers into Python.

Images and intrinsics are mirrored, as libfreenect2's are (OpenKinect/libfreenect2 issue 172).
"""

from collections import deque
from ctypes import c_float, memmove, pointer
from functools import lru_cache
from typing import Any

import numpy as np

from sensors.calibration_files.kinect2_factory import KINECT2_COLOR, KINECT2_DEPTH
from sensors.drivers.kinect2 import COLOR, DEPTH, INFRARED, MIRRORED, PROTOTYPES, Frame, Shim
from sensors.files.jpeg import mirrored_jpeg
from sensors.virtual.frame_loop import LONGEST, FrameLoop
from sensors.virtual.schedule import Faults, Schedule, UnpluggedError, c_functions

Pointer = Any  # a pointer type of ctypes, created at run time
RATE_HZ = 30.0
TICKS_PER_S = 8000
# The clock wraps two seconds after the start, instead of after 149 hours.
FIRST_TICK = 2**32 - 2 * TICKS_PER_S
COLOR_LATER_S = 0.004
QUEUE = 15  # frames of each stream, as in the shim
_HANDLE = 1


class VirtualKinect2:
    """A Kinect v2 behind ``shim``. The scene's frames must have colour."""

    def __init__(
        self, scene: FrameLoop, faults: Faults | None = None, *, serials: tuple[str, ...] = ("virtual",)
    ) -> None:
        scene.color(0)
        self._scene, self._serials = scene, serials
        self.schedule = Schedule(RATE_HZ, faults, QUEUE)
        self._open = False
        self._mirrored = lru_cache(LONGEST)(mirrored_jpeg)
        self._ready = deque[tuple[int, int]]()
        self.shim = Shim(**c_functions(PROTOTYPES, self))

    def unplug(self) -> None:
        """Deliver no more frames, as libfreenect2 does; idempotent."""
        self.schedule.stop()

    def _k2_count(self) -> int:
        return len(self._serials)

    def _k2_serial(self, index: int, text: Pointer, size: int) -> int:
        data = self._serials[index].encode() + b"\0"
        if len(data) > size:
            return -1
        memmove(text, data, len(data))
        return 0

    def _k2_open(self, serial: bytes) -> int | None:
        if self._open or serial.decode() not in self._serials:
            return None
        self._open = True
        return _HANDLE

    def _k2_params(self, handle: int, infrared: Pointer, color: Pointer) -> None:
        d, c = MIRRORED.camera(KINECT2_DEPTH), KINECT2_COLOR
        values = (
            (infrared, (d.fx, d.fy, d.cx, d.cy, d.k1, d.k2, d.k3, d.p1, d.p2)),
            (color, (c.f, c.f, c.cx, c.cy, c.shift_d, c.shift_m, *c.mx, *c.my)),
        )
        for target, numbers in values:
            memmove(target, (c_float * len(numbers))(*numbers), 4 * len(numbers))

    def _k2_start(self, handle: int) -> int:
        self.schedule.start()
        return 0

    def _k2_read(self, handle: int, timeout_ms: int, frame: Pointer, data: int, capacity: int) -> int:
        if not self._ready:
            try:
                number = self.schedule.wait(timeout_ms * 1e-3)
            except UnpluggedError:
                return 0
            if number is None:
                return 0
            kinds = (DEPTH, COLOR) if self._scene.infrared(0) is None else (INFRARED, DEPTH, COLOR)
            self._ready += ((kind, number) for kind in kinds)
        kind, number = self._ready.popleft()
        image = self._image(kind, number)
        seconds = self.schedule.device_s(number) + (COLOR_LATER_S if kind == COLOR else 0.0)
        ticks = (FIRST_TICK + int(seconds * TICKS_PER_S)) % 2**32
        size = (1920, 1080) if kind == COLOR else (512, 424)
        head = Frame(kind, ticks, number, int(self.schedule.is_short()), *size, len(image))
        memmove(frame, pointer(head), Frame.bytes.offset + Frame.bytes.size)
        if len(image) > capacity:
            return -1
        memmove(data, image, len(image))
        return 1

    def _k2_close(self, handle: int) -> None:
        self._open = False

    def _image(self, kind: int, number: int) -> bytes:
        seconds = number / RATE_HZ
        if kind == COLOR:
            return self._mirrored(self._scene.color(seconds))
        infrared = self._scene.infrared(seconds) if kind == INFRARED else None
        image = self._scene.depth(seconds) if infrared is None else infrared
        return image[:, ::-1].astype(np.float32).tobytes()
