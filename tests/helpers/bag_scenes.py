"""Messages of a small rig that other programs' bags hold: a wall, a disc in front of it, flat colours."""

import numpy as np

from sensors.rig.camera import Intrinsics
from tests.helpers.bags import SECOND, camera_info, header, image, ros, transform

H, W = 48, 64
LENS = Intrinsics(W, H, 60.0, 60.0, 31.5, 23.5)
PERIOD = 100_000_000
START = 1_700_000_000 * SECOND

Messages = list[tuple[str, object, int]]
"""(topic, message, time logged)."""


def scene(index: int = 0) -> np.ndarray:
    """Depth in millimetres; a rim has no reading."""
    v, u = np.mgrid[:H, :W]
    mm = 2600 + 3 * u + 2 * v + 7 * index - 900 * (np.hypot(u - 30, v - 25) < 12)
    return np.where(u > 2, mm, 0).astype(np.uint16)


def packed(stamp_ns: int, frame: str, kind: str, data: bytes) -> object:
    return ros(
        "sensor_msgs/msg/CompressedImage", header=header(stamp_ns, frame), format=kind,
        data=np.frombuffer(data, np.uint8),
    )  # fmt: skip


def camera(frame: str = "d", **changed: object) -> object:
    """A camera_info whose fields are changed."""
    info = camera_info(LENS, frame)
    for name, value in changed.items():
        setattr(info, name, np.asarray(value, float) if name in "dkrp" else value)
    return info


def depths(
    topic: str = "/camera/depth/image_raw", frame: str = "d", stamps: object = range(4), encoding="16UC1"
) -> Messages:
    """Depth images, received in time; stamps: in periods."""
    kinds = {"32FC1": lambda i: (scene(i) / 1000).astype(np.float32)}
    return _messages(topic, frame, stamps, encoding, kinds.get(encoding, scene))


def colours(topic: str = "/camera/color/image_raw", frame: str = "c", stamps: object = range(4)) -> Messages:
    """RGB, one flat colour a frame, so that a pair is recognised after JPEG."""
    return _messages(
        topic, frame, stamps, "rgb8", lambda i: np.full((H, W, 3), (20 * i, 250 - 20 * i, 90), np.uint8)
    )


def _messages(topic: str, frame: str, stamps: object, encoding: str, pixels) -> Messages:
    return [
        (topic, image(pixels(i), encoding, START + int(stamp * PERIOD), frame), START + i * PERIOD)
        for i, stamp in enumerate(stamps)
    ]


def rig() -> Messages:
    """Descriptions of a depth and a colour camera, and their transform."""
    return [
        ("/camera/depth/camera_info", camera(), START),
        ("/camera/color/camera_info", camera("c"), START),
        ("/tf_static", transform("d", "c", (0.05, 0.0, 0.0)), START),
    ]


def assert_depth(source, count: int = 4) -> None:
    assert len(source) == count
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.depth_mm, scene(index))


def colour_of(frame) -> int:
    """The number of the colour image that a frame has."""
    return round(float(frame.decode_color()[..., 0].mean()) / 20)


def noted(source, *words: str) -> bool:
    return any(all(word in note for word in words) for note in source.notes)
