"""Orbbec Femto and Gemini cameras through pyorbbecsdk2 (extra ``orbbec``)."""

import os
import sys
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.lens_models import intrinsics_from_rational
from sensors.device.protocol import ColorImage, DepthImage
from sensors.device.streaming_camera import (
    DEPTH_CAMERA_RATES_HZ,
    DEPTH_RATE_HZ,
    StreamingCamera,
    choose,
)
from sensors.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceFaultError,
    DeviceLostError,
    DeviceNotFoundError,
)
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

SdkObject = Any  # of pyorbbecsdk, which may be absent where types are checked
COLOR_SIZE = (1920, 1080)
CONFIG = Path(__file__).with_suffix(
    ".xml"
)  # switches off the search for network cameras, which takes seconds


def load_sdk() -> SdkObject:
    """Return the library, loaded with its output on stderr. Raises DeviceNotFoundError if it is not
    installed.
    """
    if find_spec("pyorbbecsdk") is None:
        raise DeviceNotFoundError("pyorbbecsdk2 is not installed; pip install 'annotate-cloud[orbbec]'")
    if (loaded := sys.modules.get("pyorbbecsdk")) is not None:
        return loaded
    sys.stdout.flush()
    stdout = os.dup(1)
    os.dup2(2, 1)
    try:
        import pyorbbecsdk
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
    # By default the library writes a folder Log into the working folder.
    pyorbbecsdk.Context.set_logger_level(pyorbbecsdk.OBLogLevel.NONE)
    return pyorbbecsdk


class Orbbec(StreamingCamera):
    """Orbbec camera with this serial number, or the only one. Raises DeviceError if it cannot be opened.

    pipeline: the SDK's pipeline over a recording, in place of the camera's.
    """

    def __init__(self, serial: str = "", pipeline: SdkObject | None = None) -> None:
        self._sdk: Any = load_sdk()
        self._infrared: SdkObject | None = None
        self._context: SdkObject | None = None
        # A camera without a clock stamps every image 0.
        self._has_clock: bool | None = None
        if pipeline is not None:
            self._pipeline, chosen = pipeline, pipeline.get_device().get_device_info().get_serial_number()
            super().__init__(f"orbbec:{chosen}", chosen, DEPTH_CAMERA_RATES_HZ)
            return
        pyorbbecsdk = self._sdk
        chosen = choose("Orbbec camera", orbbec_serials(), serial)
        super().__init__(f"orbbec:{chosen}", chosen, DEPTH_CAMERA_RATES_HZ)
        try:
            # The list of devices must not outlive its context.
            self._context = pyorbbecsdk.Context(str(CONFIG))
            device = self._context.query_devices().get_device_by_serial_number(chosen)
            self._pipeline = pyorbbecsdk.Pipeline(device)
        except pyorbbecsdk.OBError as error:
            raise DeviceBusyError(
                f"{self.address} cannot be opened ({error}); close the program that uses it, "
                "or add Orbbec's udev rule"
            ) from error

    def _begin(self) -> RigCalibration:
        sdk, config = self._sdk, self._sdk.Config()
        try:
            colors = self._pipeline.get_stream_profile_list(sdk.OBSensorType.COLOR_SENSOR)
            color = colors.get_video_stream_profile(*COLOR_SIZE, sdk.OBFormat.MJPG, round(DEPTH_RATE_HZ))
            depths = self._pipeline.get_stream_profile_list(sdk.OBSensorType.DEPTH_SENSOR)
            depth = depths.get_default_video_stream_profile()
            # The default of some cameras is 15 a second, not DEPTH_RATE_HZ.
            self.rates_hz = {
                DepthImage.stream: float(depth.get_fps()),
                ColorImage.stream: float(color.get_fps()),
            }
            if self._context is not None:
                unmirror(self._pipeline.get_device())
            config.enable_stream(color)
            config.enable_stream(depth)
            self._infrared = self._with_infrared(config)
            self._pipeline.start(config)
            return calibration_of(self._pipeline.get_camera_param())
        except sdk.OBError as error:
            raise DeviceError(f"{self.address} does not start ({error}); use a USB 3 port") from error

    def _with_infrared(self, config: SdkObject) -> SdkObject | None:
        """Enable infrared images in the depth camera's pixels; return their frame type, None without any."""
        sensors, kinds = self._sdk.OBSensorType, self._sdk.OBFrameType
        for sensor, kind in (
            (sensors.IR_SENSOR, kinds.IR_FRAME),
            (sensors.LEFT_IR_SENSOR, kinds.LEFT_IR_FRAME),
        ):
            with suppress(self._sdk.OBError):
                profiles = self._pipeline.get_stream_profile_list(sensor)
                config.enable_stream(profiles.get_default_video_stream_profile())
                return kind
        return None

    def _receive(self, timeout_s: float) -> None:
        try:
            frames = self._pipeline.wait_for_frames(max(1, round(timeout_s * 1000)))
        except self._sdk.OBError as error:
            raise DeviceLostError(f"{self.address} is gone ({error}); plug it in again") from error
        if frames is None:
            return
        if (depth := frames.get_depth_frame()) is not None:
            image, infrared = depth_of(depth), None
            if self._infrared is not None and (frame := frames.get_frame(self._infrared)) is not None:
                infrared = infrared_of(frame.as_video_frame(), image.shape)
            self._take(self._stamp_ns(depth), DepthImage(image, infrared))
        if (color := frames.get_color_frame()) is not None:
            encoded = np.asarray(color.get_data(), np.uint8).tobytes()
            self._take(self._stamp_ns(color), ColorImage(encoded))

    def _stamp_ns(self, frame: SdkObject) -> int:
        """Return the camera's time of a frame, or the arrival for a camera without a clock."""
        stamp_us = int(frame.get_timestamp_us())
        if self._has_clock is None:
            self._has_clock = stamp_us > 0
        return 1000 * stamp_us if self._has_clock else time.monotonic_ns()

    def _end(self) -> None:
        self._pipeline.stop()


def orbbec_serials() -> list[str]:
    """Return the serial numbers of the cameras at USB ports; empty without the library."""
    if find_spec("pyorbbecsdk") is None:
        return []
    devices = load_sdk().Context(str(CONFIG)).query_devices()
    return [str(devices.get_device_serial_number_by_index(index)) for index in range(devices.get_count())]


def unmirror(device: SdkObject) -> None:
    """Switch off mirroring and flipping, which a viewer may have left on for a stream.

    JPEG colour ignores both settings (orbbec/OrbbecSDK_v2 issue 127), so a mirrored depth image would not
    match.
    """
    sdk = load_sdk()
    for stream in ("DEPTH", "COLOR", "IR"):
        for change in ("MIRROR", "FLIP"):
            setting = getattr(sdk.OBPropertyID, f"OB_PROP_{stream}_{change}_BOOL")
            if device.is_property_supported(setting, sdk.OBPermissionType.PERMISSION_WRITE):
                device.set_bool_property(setting, False)


def depth_of(frame: SdkObject) -> NDArray[np.uint16]:
    """Return a depth frame as uint16 (h, w) millimetres. Raises DeviceFaultError for a truncated frame."""
    shape = frame.get_height(), frame.get_width()
    values = np.frombuffer(np.asarray(frame.get_data()).tobytes(), "<u2")
    if values.size != shape[0] * shape[1]:
        raise DeviceFaultError(
            f"an Orbbec depth image has {values.size} pixels, not {shape[1]}x{shape[0]}; wait for the next"
        )
    millimetres = np.rint(values.reshape(shape) * np.float32(frame.get_depth_scale()))
    return millimetres.clip(0, 65535).astype(np.uint16)


def infrared_of(frame: SdkObject, shape: tuple[int, ...]) -> NDArray[np.uint16] | None:
    """Return an infrared frame of 8 or 16 bits as uint16 (h, w).

    None if its size is not the depth image's.
    """
    data = np.asarray(frame.get_data()).tobytes()
    pixels = shape[0] * shape[1]
    if (frame.get_height(), frame.get_width()) != shape or len(data) not in (pixels, 2 * pixels):
        return None
    values = np.frombuffer(data, np.uint8 if len(data) == pixels else "<u2")
    return values.reshape(shape).astype(np.uint16)


def calibration_of(param: SdkObject) -> RigCalibration:
    """Return the factory's calibration (OBCameraParam, pose in millimetres)."""
    rotation = np.array(param.transform.rot, float).reshape(3, 3)
    pose = Pose(rotation, np.array(param.transform.transform, float).ravel() / 1000)
    depth = _camera(param.depth_intrinsic, param.depth_distortion)
    return RigCalibration(depth, _camera(param.rgb_intrinsic, param.rgb_distortion), pose)


def _camera(lens: SdkObject, distortion: SdkObject) -> Intrinsics:
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]], float)
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    coefficients = np.array([getattr(distortion, name) for name in names], float)
    return intrinsics_from_rational((lens.width, lens.height), matrix, coefficients)
