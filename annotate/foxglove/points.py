"""Point clouds of a fused frame for Foxglove, coloured by temperature or by parts."""

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from numpy.typing import NDArray

from annotate.array_types import UInt8
from annotate.cloud.color_map import heat_rgb
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.scheme.scheme import BACKGROUND, Scheme
from sensors.session.messages import time_message

ROOM_RGB = np.array((74, 80, 92), np.float32)  # without temperature or part; untuned
_TYPES = {"f4": PackedElementField.FLOAT32, "u1": PackedElementField.UINT8}
_PLACE = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
_COLOR = [("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")]
HEAT_POINT = np.dtype([*_PLACE, ("temperature", "<f4"), *_COLOR])  # metres, Celsius (NaN = none), sRGB
PART_POINT = np.dtype([*_PLACE, *_COLOR, ("part", "u1")])


def heat_points(cloud: ThermalCloud, stamp_ns: int) -> PointCloud:
    """Return all valid points as ``HEAT_POINT`` records, in pixel order."""
    celsius = cloud.temperature_c[cloud.valid]
    points = _points(cloud, HEAT_POINT, heat_rgb(celsius, ROOM_RGB).astype(np.uint8))
    points["temperature"] = celsius
    return _message(points, stamp_ns)


def part_points(cloud: ThermalCloud, parts: UInt8, scheme: Scheme, stamp_ns: int) -> PointCloud:
    """Return all valid points as ``PART_POINT`` records with part ids (h, w), in pixel order."""
    palette = scheme.palette_rgb()
    palette[BACKGROUND] = ROOM_RGB
    ids = parts[cloud.valid]
    points = _points(cloud, PART_POINT, palette[ids])
    points["part"] = ids
    return _message(points, stamp_ns)


def _points(cloud: ThermalCloud, kind: np.dtype[Any], rgb: UInt8) -> NDArray[Any]:
    places = cloud.points_m[cloud.valid]
    points = np.zeros(len(places), kind)
    for axis, name in enumerate("xyz"):
        points[name] = places[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = rgb[:, channel]
    points["alpha"] = 255
    return points


def _message(points: NDArray[Any], stamp_ns: int) -> PointCloud:
    cloud = PointCloud(
        timestamp=time_message(stamp_ns),
        frame_id="depth",
        point_stride=points.dtype.itemsize,
        data=points.tobytes(),
    )
    cloud.pose.orientation.w = 1.0
    for name, field in (points.dtype.fields or {}).items():
        cloud.fields.add(name=name, offset=field[1], type=_TYPES[field[0].str[1:]])
    return cloud
