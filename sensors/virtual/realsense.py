"""Twin of a RealSense: a software device of the maker's SDK."""

import threading
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.drivers.realsense import SdkObject, load_sdk
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.schedule import Faults, Schedule, UnpluggedError

RATE_HZ = 30
PERIOD_MS = 2**32 / 1000
FIRST_MS = PERIOD_MS - 2000  # the clock wraps two seconds after the start, instead of after 71 minutes
COLOR_LATER_MS = 4.0
FOCAL = 0.5, 0.49  # focal lengths of depth and colour / image width: a D455's field of view
BASELINE_M = 0.059  # m from the left infrared to the colour camera of a D455
COLOR_LENS = (-0.0557, 0.0603, -0.00098, -0.00085, -0.0161)  # a D455's (data set ABC-iRobotics/Hand_Tools)
# Options of the stereo sensor: smallest, largest, step, initial value.
OPTIONS = {"visual_preset": (0, 6, 1, 0), "exposure": (1, 200_000, 1, 8500), "laser_power": (0, 360, 30, 150)}


class VirtualRealSense:
    """RealSense in place of ``pyrealsense2.context()``.

    The scene's frames must have colour. size, color_size: (width, height) of the scene's images. unit_mm:
    millimetres of one unit of depth. Raises DeviceNotFoundError without pyrealsense2.
    """

    def __init__(self, scene: FrameLoop, faults: Faults | None = None, unit_mm: float = 1.0) -> None:
        self._sdk = rs = load_sdk()
        self._scene, self._unit_mm = scene, unit_mm
        self.schedule = Schedule(RATE_HZ, faults)
        self.size = scene.depth(0).shape[1], scene.depth(0).shape[0]
        color = self.color(0)
        self.color_size = color.shape[1], color.shape[0]
        self._thread: threading.Thread | None = None
        self._plugged = True
        # The SDK's own software device never counts as unplugged.
        kind = type("Pluggable", (rs.software_device,), {"is_connected": lambda device: self._plugged})
        self.device = kind()
        self.device.register_info(rs.camera_info.serial_number, "virtual")
        self._stereo, self._rgb = (self.device.add_sensor(name) for name in ("Stereo Module", "RGB Camera"))
        self._stereo.add_read_only_option(rs.option.depth_units, unit_mm / 1000)
        for option, limits in OPTIONS.items():
            span = rs.option_range()
            span.min, span.max, span.step, span.default = limits
            self._stereo.add_option(getattr(rs.option, option), span, True)
        self.depth_profile = self._add(rs.stream.depth, rs.format.z16, 2)
        if scene.infrared(0) is not None:
            self._infrared = self._add(rs.stream.infrared, rs.format.y8, 1, index=1)
        self.color_profile = self._add(rs.stream.color, rs.format.yuyv, 2)
        pose = rs.extrinsics()
        pose.rotation, pose.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [-BASELINE_M, 0, 0]
        self.depth_profile.register_extrinsics_to(self.color_profile, pose)

    def query_devices(self) -> list[SdkObject]:
        """Return the camera, which streams from the first call on."""
        if self._thread is None:
            self.schedule.start()
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()
        return [self.device] if self._plugged else []

    def unplug(self) -> None:
        """Remove the device, as if it was unplugged; idempotent."""
        self._plugged = False
        self.schedule.stop()
        if self._thread is not None:
            self._thread.join()

    def show(self, number: int) -> None:
        """Send the three images of frame ``number`` through the software device."""
        seconds = number / RATE_HZ
        millimetres, infrared = self._scene.depth(seconds), self._scene.infrared(seconds)
        stamp_ms = FIRST_MS + 1000 * self.schedule.device_s(number)
        if infrared is not None:
            image = (infrared >> 8).astype(np.uint8)
            self._feed(self._infrared, image, number, stamp_ms)
        units = np.rint(millimetres / self._unit_mm).clip(0, 65535).astype(np.uint16)
        self._feed(self.depth_profile, units, number, stamp_ms)
        color = self.color(seconds)
        self._feed(self.color_profile, color, number, stamp_ms + COLOR_LATER_MS)

    def color(self, seconds: float) -> NDArray[np.uint8]:
        """Return the scene's colour as YUYV, uint8 (h, w, 2)."""
        encoded = np.frombuffer(self._scene.color(seconds), np.uint8)
        bgr = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_YUY2), np.uint8)

    def _run(self) -> None:
        while True:
            try:
                number = self.schedule.wait(1.0)
            except UnpluggedError:
                self._plugged = False
                return
            # The SDK itself discards short frames.
            if number is not None and not self.schedule.is_short():
                self.show(number)

    def _add(self, stream: SdkObject, pixels: SdkObject, size: int, index: int = 0) -> SdkObject:
        """Add a mode of ``size`` bytes a pixel."""
        rs, is_color = self._sdk, stream == self._sdk.stream.color
        width, height = self.color_size if is_color else self.size
        mode, lens = rs.video_stream(), rs.intrinsics()
        lens.width, lens.height, lens.ppx, lens.ppy = width, height, (width - 1) / 2, (height - 1) / 2
        lens.fx = lens.fy = FOCAL[is_color] * width
        lens.model = rs.distortion.inverse_brown_conrady if is_color else rs.distortion.brown_conrady
        lens.coeffs = list(COLOR_LENS) if is_color else [0.0] * 5
        mode.type, mode.fmt, mode.index, mode.uid = stream, pixels, index, int(stream)
        mode.width, mode.height, mode.bpp, mode.fps, mode.intrinsics = width, height, size, RATE_HZ, lens
        sensor = self._rgb if is_color else self._stereo
        return sensor.add_video_stream(mode).as_video_stream_profile()

    def _feed(self, profile: SdkObject, image: NDArray[Any], number: int, stamp_ms: float) -> None:
        frame = self._sdk.software_video_frame()
        # The SDK ignores the array's strides.
        frame.pixels = np.ascontiguousarray(image)
        frame.bpp, frame.stride = image[0, 0].nbytes, image[0].nbytes
        frame.timestamp = stamp_ms % PERIOD_MS
        frame.domain = self._sdk.timestamp_domain.hardware_clock
        frame.frame_number, frame.profile = number + 1, profile
        frame.depth_units = self._unit_mm / 1000
        (self._rgb if profile is self.color_profile else self._stereo).on_video_frame(frame)
