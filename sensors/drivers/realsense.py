"""RealSense cameras (D400) through pyrealsense2 (extra ``realsense``): depth with its left infrared, colour.

The driver uses sensors and a frame queue, because the SDK's pipeline pairs and repeats frames.
"""

import time
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.lens_models import realsense_intrinsics
from sensors.device.node import check_usb
from sensors.device.protocol import ColorImage, DepthImage
from sensors.device.streaming_camera import StreamingCamera, choose
from sensors.errors import DeviceBusyError, DeviceError, DeviceLostError, DeviceNotFoundError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import mm_from_units
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.rig.wrapping_counter import WrappingCounter

SdkObject = Any  # of pyrealsense2, which may be absent where types are checked
Size = tuple[int, int]

_PRODUCTS = "0ad1 0ad2 0ad3 0ad4 0ad5 0b07 0b3a 0b3d 0b48 0b4d 0b5b 0b5c 1155 1156"
USB_IDS = tuple(f"8086:{product}" for product in _PRODUCTS.split())  # config/99-realsense-libusb.rules
_SIZES = "848x480 1280x720 640x480 640x360 480x270 424x240 1280x800 1920x1080"
SIZES: dict[str, Size] = {size: (int(size.split("x")[0]), int(size.split("x")[1])) for size in _SIZES.split()}
PRESETS = {"default": 1, "hand": 2, "high-accuracy": 3, "high-density": 4, "medium-density": 5}
RATES = {"30": 30, "15": 15, "6": 6}
QUEUE = 32  # frames that may wait for a slow reader, 0.3 s of three streams; untuned
# The cameras deliver uncompressed YUYV, whose chroma has half the columns.
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422)


@dataclass(frozen=True)
class Settings:
    """Settings of a camera. size: of depth and infrared, (width, height). None leaves a setting unchanged.

    preset: ``rs400_visual_preset`` of the stereo matching. exposure_us: of the stereo pair. laser_mw: 0 =
    off.
    """

    size: Size = (848, 480)
    color_size: Size = (1280, 720)
    rate_hz: int = 30
    preset: int | None = None
    exposure_us: float | None = None
    laser_mw: float | None = None


class RealSense(StreamingCamera):
    """The RealSense with this serial number, or the only one, stamped by its own clock.

    context: ``pyrealsense2.context()`` or its software twin. Raises DeviceError if it cannot be opened.
    """

    silence_s = 5.0  # the SDK itself notices an unplugged camera

    def __init__(
        self, serial: str = "", settings: Settings | None = None, context: SdkObject | None = None
    ) -> None:
        self._sdk = rs = load_sdk()
        self._settings = settings or Settings()
        # The context detects an unplugged camera while it exists.
        self._context = context or rs.context()
        devices = devices_of(rs, self._context)
        if not devices and context is None:
            check_usb(USB_IDS)
        chosen = choose("RealSense", [number for number, _ in devices], serial)
        self._device = next(device for number, device in devices if number == chosen)
        super().__init__(f"realsense:{chosen}", chosen, {})
        self._sensors = list(self._device.query_sensors())
        stereo, self._depth = self._mode("depth", rs.stream.depth, self._settings.size, rs.format.z16)
        modes = [(stereo, self._depth)]
        self._color: SdkObject | None = None
        if self._modes(rs.stream.color):
            size = self._settings.color_size
            color, self._color = self._mode("colour", rs.stream.color, size, rs.format.yuyv)
            modes.append((color, self._color))
        with suppress(DeviceError):
            modes.append(self._mode("infrared", rs.stream.infrared, self._settings.size, rs.format.y8))
        self._has_infrared = any(profile.stream_type() == rs.stream.infrared for _, profile in modes)
        streams = ["depth"] if self._color is None else ["depth", "color"]
        self.rates_hz = dict.fromkeys(streams, float(self._settings.rate_hz))
        self._configure(self._sensors[stereo])
        self._unit_mm = self._unit(self._sensors[stereo])
        self._streaming = self._open(modes)
        self._queue = rs.frame_queue(QUEUE, True)
        # Microseconds in 32 bits, which wrap every 71.6 minutes.
        self._clock = WrappingCounter()
        self._numbers: dict[str, int] = {}
        self._stereo: dict[str, tuple[int, int, NDArray[Any]]] = {}

    def _begin(self) -> RigCalibration:
        try:
            for sensor in self._streaming:
                sensor.start(self._queue)
        except RuntimeError as error:
            raise DeviceError(f"{self.address} does not start ({error}); use a USB 3 port") from error
        depth = intrinsics_of(self._depth)
        if self._color is None:
            return RigCalibration(depth)
        lens = self._depth.get_extrinsics_to(self._color)
        pose = Pose(np.array(lens.rotation, float).reshape(3, 3).T, np.array(lens.translation, float))
        return RigCalibration(depth, intrinsics_of(self._color), pose)

    def _receive(self, timeout_s: float) -> None:
        came, frame = self._queue.try_wait_for_frame(max(1, round(1000 * timeout_s)))
        if not came:
            if not self._device.is_connected():
                raise DeviceLostError(f"{self.address} is no longer connected; plug it in again")
            return
        # One half of a stereo exposure makes no reading yet.
        self._last_image_s = time.monotonic()
        number, profile = frame.get_frame_number(), frame.get_profile()
        stamp_ns = 1000 * self._clock.unwrap(round(1000 * frame.get_timestamp()))
        # The SDK has few buffers, so the frame is copied and released at once.
        pixels = np.array(np.asanyarray(frame.get_data()))
        del frame
        stream = profile.stream_type()
        if stream == self._sdk.stream.color:
            self._take(stamp_ns, ColorImage(jpeg_of(pixels)), self._lost("color", number))
        else:
            kind = "depth" if stream == self._sdk.stream.depth else "infrared"
            self._take_stereo(kind, number, stamp_ns, pixels)

    def _end(self) -> None:
        for sensor in self._streaming:
            # A sensor that was unplugged or not started raises.
            with suppress(RuntimeError):
                sensor.stop()
            with suppress(RuntimeError):
                sensor.close()

    def _take_stereo(self, kind: str, number: int, stamp_ns: int, pixels: NDArray[Any]) -> None:
        """Keep depth or infrared of an exposure; queue the depth image when its infrared image is there or
        late.
        """
        waiting = self._stereo.get("depth")
        if waiting is not None and waiting[0] != number:
            self._take_depth()
        self._stereo[kind] = number, stamp_ns, pixels
        halves = [self._stereo.get(half) for half in ("depth", "infrared")]
        if halves[0] and (not self._has_infrared or (halves[1] and halves[0][0] == halves[1][0])):
            self._take_depth()

    def _take_depth(self) -> None:
        number, stamp_ns, units = self._stereo.pop("depth")
        infrared = self._stereo.get("infrared")
        beside = infrared[2].astype(np.uint16) if infrared and infrared[0] == number else None
        value = DepthImage(mm_from_units(units, self._unit_mm), beside)
        self._take(stamp_ns, value, self._lost("depth", number))

    def _lost(self, stream: str, number: int) -> int:
        """Return the number of lost frames of a stream by the camera's count."""
        before, self._numbers[stream] = self._numbers.get(stream, number - 1), number
        return max(0, number - before - 1)

    def _modes(self, stream: SdkObject) -> list[tuple[int, SdkObject]]:
        """Return the modes of a stream at the wanted rate, with their sensors' numbers."""
        return [
            (index, profile.as_video_stream_profile())
            for index, sensor in enumerate(self._sensors)
            for profile in sensor.get_stream_profiles()
            # The left infrared camera, 1, has the pixels of depth.
            if profile.stream_type() == stream and profile.stream_index() in (0, 1)
            if profile.fps() == self._settings.rate_hz
        ]

    def _mode(self, name: str, stream: SdkObject, size: Size, pixels: SdkObject) -> tuple[int, SdkObject]:
        """Return the mode of this size and native format. Raises DeviceError if there is none."""
        fit = [one for one in self._modes(stream) if one[1].format() == pixels]
        for index, profile in fit:
            if (profile.width(), profile.height()) == size:
                return index, profile
        there = sorted({f"{profile.width()}x{profile.height()}" for _, profile in fit})
        remedy = f"choose {' or '.join(there)}" if there else "choose another rate"
        raise DeviceError(
            f"{self.address} has no {name} images of {size[0]}x{size[1]} at {self._settings.rate_hz} a "
            f"second; {remedy}{self._usb()}"
        )

    def _usb(self) -> str:
        key = self._sdk.camera_info.usb_type_descriptor
        slow = self._device.supports(key) and str(self._device.get_info(key)).startswith("2")
        return ", or use a USB 3 port and cable: it is on USB 2" if slow else ""

    def _configure(self, stereo: SdkObject) -> None:
        option, wanted = self._sdk.option, self._settings
        for sensor in self._sensors:
            # Global time converts stamps to the host's time, with jumps.
            if sensor.supports(option.global_time_enabled):
                sensor.set_option(option.global_time_enabled, 0)
        for name, key, value in (
            ("preset", option.visual_preset, wanted.preset),
            ("exposure", option.exposure, wanted.exposure_us),
            ("laser", option.laser_power, wanted.laser_mw),
        ):
            if value is None:
                continue
            if not stereo.supports(key):
                raise DeviceError(f"{self.address} has no option {name}; leave it out")
            try:
                stereo.set_option(key, value)
            except RuntimeError as error:
                span = stereo.get_option_range(key)
                raise DeviceError(
                    f"{self.address} refused {name} {value:g}; "
                    f"give {span.min:g} to {span.max:g} in steps of {span.step:g}"
                ) from error

    def _unit(self, stereo: SdkObject) -> float:
        """Return the millimetres of one depth unit, rounded to the digits of the SDK's float32."""
        return float(f"{1000 * stereo.get_option(self._sdk.option.depth_units):.6g}")

    def _open(self, modes: list[tuple[int, SdkObject]]) -> list[SdkObject]:
        """Open the sensors of these modes. Raises DeviceBusyError if one cannot be opened."""
        opened: list[SdkObject] = []
        for index in sorted({index for index, _ in modes}):
            sensor = self._sensors[index]
            try:
                sensor.open([profile for at, profile in modes if at == index])
            except RuntimeError as error:
                for one in opened:
                    one.close()
                raise DeviceBusyError(
                    f"{self.address} cannot be opened ({error}); close the program that uses it"
                ) from error
            opened.append(sensor)
        return opened


def load_sdk() -> SdkObject:
    """Return the module pyrealsense2. Raises DeviceNotFoundError if it is not installed."""
    if find_spec("pyrealsense2") is None:
        raise DeviceNotFoundError("pyrealsense2 is not installed; pip install 'annotate-cloud[realsense]'")
    import pyrealsense2

    return pyrealsense2


def devices_of(sdk: SdkObject, context: SdkObject) -> list[tuple[str, SdkObject]]:
    """Return the connected cameras with their serial numbers, except cameras that wait for firmware."""
    key = sdk.camera_info.serial_number
    return [(str(one.get_info(key)), one) for one in context.query_devices() if one.supports(key)]


def realsense_serials() -> list[str]:
    """Return the serial numbers of the connected cameras; empty without the library."""
    if find_spec("pyrealsense2") is None:
        return []
    sdk = load_sdk()
    return [number for number, _ in devices_of(sdk, sdk.context())]


def jpeg_of(yuyv: NDArray[Any]) -> bytes:
    """Return the JPEG of a colour frame of two bytes a pixel."""
    bgr = cv2.cvtColor(yuyv.view(np.uint8).reshape(*yuyv.shape[:2], 2), cv2.COLOR_YUV2BGR_YUY2)
    return bytes(cv2.imencode(".jpg", bgr, JPEG)[1])


def intrinsics_of(profile: SdkObject) -> Intrinsics:
    """Return the factory's intrinsics of a mode."""
    lens = profile.get_intrinsics()
    pinhole = Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy)
    return realsense_intrinsics(pinhole, lens.model.name, lens.coeffs)
