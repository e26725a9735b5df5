"""Messages of Foxglove's public schemas for a labelled frame, by topic, for files and streams.

Images, calibrations and events have the topics and units of a session, so a file of these messages is a
session. Positions are in metres in the frame ``depth`` (x right, y down, z forward); the depth image is
undistorted. The frame ``upright`` has the same origin with z up, as Foxglove's views expect.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from annotate.array_types import Float32, UInt8
from annotate.cloud.color_map import heat_rgb
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.foxglove.points import ROOM_RGB, heat_points, part_points
from annotate.foxglove.skeleton import skeleton_message
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session import messages
from sensors.session.messages import CALIBRATIONS, COLOR, DEPTH, EVENTS, TF, THERMAL

IDS, PARTS, HEAT = "/parts/ids", "/parts/image", "/thermal/picture"
HEAT_CLOUD, PART_CLOUD, SKELETON = "/cloud/temperature", "/cloud/parts", "/skeleton"
UPRIGHT = "upright"  # parent frame of ``depth``: x right, y forward, z up, if the depth camera is level
UPRIGHT_FROM_DEPTH = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
SCHEMAS: dict[str, type[Message]] = {
    **{topic: messages.SCHEMAS[topic] for topic in (DEPTH, COLOR, THERMAL, *CALIBRATIONS, TF, EVENTS)},
    **dict.fromkeys((IDS, PARTS, HEAT), RawImage),
    **dict.fromkeys((HEAT_CLOUD, PART_CLOUD), PointCloud),
    SKELETON: SceneUpdate,
}


@dataclass(frozen=True)
class Shown:
    """Labelled frame to show in Foxglove.

    stamp_ns: of the depth image; parts: uint8 (h, w) of the cloud's pixels. color_encoded, thermal_c: as in
    ``RigFrame``. joints_mm: (x, y, z) by joint, depth camera. events: stamps (ns) and texts since the
    previous frame. scheme: of the parts.
    """

    stamp_ns: int
    cloud: ThermalCloud
    parts: UInt8
    calibration: RigCalibration
    color_encoded: bytes | None = None
    thermal_c: Float32 | None = None
    joints_mm: Mapping[str, Sequence[float]] | None = None
    events: tuple[tuple[int, str], ...] = ()
    scheme: Scheme = PAPER


def shown_messages(
    shown: Shown, wanted: Callable[[str], bool] = lambda topic: True
) -> Iterator[tuple[str, int, Message]]:
    """Yield topic, stamp (ns) and message of the wanted topics with data.

    Without joints a message removes the last skeleton. Raises FormatError for a colour image that is neither
    JPEG nor PNG.
    """
    for topic, message in _cameras(shown) if any(map(wanted, (*CALIBRATIONS, TF))) else ():
        if wanted(topic):
            yield topic, shown.stamp_ns, message
    for topic, make in _MAKERS.items():
        if wanted(topic) and (made := make(shown)) is not None:
            yield topic, shown.stamp_ns, made
    if wanted(EVENTS):
        for stamp_ns, text in shown.events:
            yield EVENTS, stamp_ns, messages.event_message(stamp_ns, text)


def _cameras(shown: Shown) -> Iterator[tuple[str, Message]]:
    """Yield calibrations and poses of the cameras, and the frame ``upright``."""
    # The cloud's depth image is already undistorted and shifted.
    turn = Pose(UPRIGHT_FROM_DEPTH, np.zeros(3))
    calibration = replace(shown.calibration, depth=shown.cloud.camera, depth_shift_mm=0.0)
    upright = messages.transform_message(UPRIGHT, "depth", turn, shown.stamp_ns)
    links = FrameTransforms(transforms=[upright])
    for topic, message in messages.calibration_messages(calibration, shown.stamp_ns):
        if topic == TF:
            links.MergeFrom(message)
        else:
            yield topic, message
    yield TF, links


def _color(shown: Shown) -> Message | None:
    encoded = shown.color_encoded
    return None if encoded is None else messages.color_message(encoded, shown.stamp_ns)


def _thermal(shown: Shown) -> Message | None:
    return None if shown.thermal_c is None else messages.thermal_message(shown.thermal_c, shown.stamp_ns)


def _heat(shown: Shown) -> Message | None:
    """Return the temperatures as a colour image, because Foxglove's 16-bit greys hardly differ
    within a room.
    """
    if shown.thermal_c is None:
        return None
    rgb = heat_rgb(shown.thermal_c.reshape(-1), ROOM_RGB).astype("u1").reshape(*shown.thermal_c.shape, 3)
    return messages.raw_image(rgb, "rgb8", "thermal", shown.stamp_ns)


def _parts(shown: Shown) -> Message:
    rgb = shown.scheme.palette_rgb()[shown.parts]
    return messages.raw_image(rgb, "rgb8", "depth", shown.stamp_ns)


_MAKERS: dict[str, Callable[[Shown], Message | None]] = {
    DEPTH: lambda shown: messages.image_message(shown.cloud.depth_mm, "depth", shown.stamp_ns),
    COLOR: _color,
    THERMAL: _thermal,
    HEAT: _heat,
    IDS: lambda shown: messages.raw_image(shown.parts, "8UC1", "depth", shown.stamp_ns),
    PARTS: _parts,
    HEAT_CLOUD: lambda shown: heat_points(shown.cloud, shown.stamp_ns),
    PART_CLOUD: lambda shown: part_points(shown.cloud, shown.parts, shown.scheme, shown.stamp_ns),
    SKELETON: lambda shown: skeleton_message(shown.joints_mm, shown.stamp_ns, shown.scheme),
}  # functions that make the message of a topic, None without data
