"""Small valid files of formats without a writer in the installed packages."""

import io
import json

import cv2
import numpy as np
import pytest

DEPTH_SIZE, COLOR_SIZE = (320, 288), (1280, 720)
"""Azure Kinect, narrow field of view, binned; width, height."""


def element(number: int, payload: bytes) -> bytes:
    """One EBML element with an eight-byte length."""
    head = number.to_bytes((number.bit_length() + 7) // 8, "big")
    return head + (len(payload) | 1 << 56).to_bytes(8, "big") + payload


def azure_depth(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 4000, DEPTH_SIZE[::-1], np.uint16)


def azure_jpeg(seed: int) -> bytes:
    small = np.random.default_rng(seed).integers(0, 256, (9, 16, 3), np.uint8)
    return bytes(cv2.imencode(".jpg", cv2.resize(small, COLOR_SIZE))[1])


def azure_calibration() -> bytes:
    def camera(
        purpose: str, lens: list[float], size: tuple[int, int], shift: list[float]
    ) -> dict[str, object]:
        return {
            "Purpose": f"CALIBRATION_CameraPurpose{purpose}",
            "Intrinsics": {
                "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
                "ModelParameters": [*lens, *[0.0] * 10],
            },
            "Rt": {"Rotation": np.eye(3).ravel().tolist(), "Translation": shift},
            "SensorWidth": size[0],
            "SensorHeight": size[1],
        }

    cameras = [
        camera("Depth", [0.5, 0.5, 0.49, 0.49], (1024, 1024), [0.0, 0.0, 0.0]),
        camera("PhotoVideo", [0.5, 0.5, 0.48, 0.64], (4096, 3072), [-0.03, 0.0, 0.0]),
    ]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras}}).encode()


def azure_mkv(frames: int = 2, color: bytes = b"MJPG", calibration: bytes | None = None) -> bytes:
    """A recording as k4arecorder lays it out: colour 5 ms after depth, infrared with it."""

    def track(number: int, name: bytes, size: tuple[int, int], fourcc: bytes) -> bytes:
        sides = b"".join(side.to_bytes(4, "little") for side in size)
        header = (40).to_bytes(4, "little") + sides + b"\1\0\x10\0" + fourcc + bytes(20)
        return element(0xAE, element(0xD7, bytes([number])) + element(0x536E, name) + element(0x63A2, header))

    def block(number: int, ticks: int, data: bytes) -> bytes:
        return element(0xA3, bytes([0x80 | number]) + ticks.to_bytes(2, "big", signed=True) + b"\0" + data)

    tracks = track(1, b"COLOR", COLOR_SIZE, color) + track(2, b"DEPTH", DEPTH_SIZE, b"b16g")
    tracks += track(3, b"IR", DEPTH_SIZE, b"b16g")
    file = element(0x466E, b"calibration.json") + element(0x465C, calibration or azure_calibration())
    tag = element(0x67C8, element(0x45A3, b"K4A_DEPTH_MODE") + element(0x4487, b"NFOV_2X2BINNED"))
    body = element(0x1549A966, element(0x2AD7B1, (1000).to_bytes(3, "big")))  # microseconds
    body += element(0x1654AE6B, tracks) + element(0x1941A469, element(0x61A7, file))
    body += element(0x1254C367, element(0x7373, tag))
    for i in range(frames):
        depth = azure_depth(i).astype(">u2").tobytes()
        blocks = block(2, 0, depth) + block(3, 0, depth) + block(1, 5000, azure_jpeg(i))
        body += element(0x1F43B675, element(0xE7, (33_333 * i).to_bytes(4, "big")) + blocks)
    return element(0x1A45DFA3, element(0x4282, b"matroska")) + element(0x18538067, body)


def las(points: np.ndarray, offset: float, compressed: bool) -> bytes:
    """Points (n, 3) in metres, stored relative to an offset in metres."""
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.offsets, header.scales = np.full(3, offset), np.full(3, 0.001)
    cloud = laspy.LasData(header)
    cloud.xyz = points + offset
    stream = io.BytesIO()
    cloud.write(stream, do_compress=compressed)
    return stream.getvalue()
