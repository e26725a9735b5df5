"""Azure Kinect through pyk4a (extra ``kinect``; it needs Microsoft's Azure Kinect SDK 1.4)."""

from contextlib import suppress
from importlib.util import find_spec
from typing import Any

import numpy as np

from sensors.device.protocol import ColorImage, DepthImage
from sensors.device.streaming_camera import DEPTH_CAMERA_RATES_HZ, StreamingCamera, choose
from sensors.errors import DeviceBusyError, DeviceError, DeviceLostError, DeviceNotFoundError
from sensors.rig.camera import intrinsics_from_rational
from sensors.rig.rig_calibration import Pose, RigCalibration

DEPTH_SIZE, COLOR_SIZE = (640, 576), (1920, 1080)
"""Narrow field of view, unbinned; 1080p as the device's own JPEG."""


class AzureKinect(StreamingCamera):
    """One Azure Kinect. serial: which, or empty for the only one. Raises DeviceError."""

    def __init__(self, serial: str = "") -> None:
        if find_spec("pyk4a") is None:
            raise DeviceNotFoundError("no pyk4a; install the Azure Kinect SDK, then annotate-cloud[kinect]")
        import pyk4a

        there = azure_devices()
        chosen = choose("Azure Kinect", [number for _, number in there], serial)
        index = next(index for index, number in there if number == chosen)
        super().__init__(f"azure:{chosen}", chosen, DEPTH_CAMERA_RATES_HZ)
        self._pyk4a: Any = pyk4a
        config = pyk4a.Config(
            color_resolution=pyk4a.ColorResolution.RES_1080P,
            color_format=pyk4a.ImageFormat.COLOR_MJPG,
            depth_mode=pyk4a.DepthMode.NFOV_UNBINNED,
            camera_fps=pyk4a.FPS.FPS_30,
            synchronized_images_only=False,
        )
        self._device = pyk4a.PyK4A(config, device_id=index)
        try:
            self._device.open()
        except pyk4a.K4AException as error:
            raise DeviceBusyError(
                f"{self.address} cannot be opened; close the program that uses it, or add its udev rule"
            ) from error

    def _begin(self) -> RigCalibration:
        try:
            self._device.start()
        except self._pyk4a.K4AException as error:
            raise DeviceError(f"{self.address} does not start; use a USB 3 port and its power") from error
        lens, types = self._device.calibration, self._pyk4a.CalibrationType
        cameras = [
            intrinsics_from_rational(
                size, lens.get_camera_matrix(kind), lens.get_distortion_coefficients(kind)
            )
            for size, kind in ((DEPTH_SIZE, types.DEPTH), (COLOR_SIZE, types.COLOR))
        ]
        # The SDK maps points in millimetres; where it takes the origin and the axes is the pose.
        origin, *axes = (
            np.array(lens.depth_to_color_3d(point), float) / 1000
            for point in ((0.0, 0.0, 0.0), (1000.0, 0.0, 0.0), (0.0, 1000.0, 0.0), (0.0, 0.0, 1000.0))
        )
        pose = Pose(np.stack([axis - origin for axis in axes], axis=-1), origin)
        return RigCalibration(cameras[0], cameras[1], pose)

    def _receive(self, timeout_s: float) -> None:
        try:
            capture = self._device.get_capture(timeout=round(timeout_s * 1000))
        except self._pyk4a.K4ATimeoutException:
            return
        except self._pyk4a.K4AException as error:
            raise DeviceLostError(f"{self.address} is no longer connected; plug it in again") from error
        if capture.depth is not None:
            infrared = None if capture.ir is None else np.array(capture.ir, np.uint16)
            depth = DepthImage(np.array(capture.depth, np.uint16), infrared)
            self._take(1000 * capture.depth_timestamp_usec, depth)
        if capture.color is not None:
            self._take(1000 * capture.color_timestamp_usec, ColorImage(bytes(capture.color)))

    def _end(self) -> None:
        if self._device.is_running:
            self._device.stop()
        elif self._device.opened:
            self._device.close()


def azure_devices() -> list[tuple[int, str]]:
    """Index and serial number of the devices that are plugged in; none where pyk4a is not installed.

    Each is opened for a moment, as its number cannot be read otherwise; one in use is left out.
    """
    if find_spec("pyk4a") is None:
        return []
    import pyk4a

    found = []
    for index in range(pyk4a.connected_device_count()):
        device = pyk4a.PyK4A(device_id=index)
        with suppress(pyk4a.K4AException):
            device.open()
            found.append((index, str(device.serial)))
            device.close()
    return found
