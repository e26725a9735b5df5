"""A live frame as flat pictures, and as the scene of the cloud view."""

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.cloud.color_map import heat_rgb, mapped_rgb
from annotate.gui.state.point_colors import MAPS, ROOM_RGB, edges
from annotate.gui.state.scene import FrameScene, levels, shade_of
from annotate.live.live_frame import LiveFrame
from annotate.scheme.scheme import BACKGROUND
from sensors.rig.camera import project

NEAR_M, FAR_M = 0.5, 4.5  # m; range of the depth colours: a Kinect v2's
# Points of the thinned room, a quarter of the correction window's, as each frame is redrawn.
ROOM_POINTS = 12_000
STEP = 2  # px of the depth image a pixel of a picture
DIM = 3  # factor that darkens the picture below the parts; untuned
_NONE = np.array(ROOM_RGB[True], np.float32)
TITLES = ("Depth", "Colour", "Heat", "Parts")


def pictures(frame: LiveFrame) -> dict[str, UInt8]:
    """Return pictures uint8 (h / 2, w / 2, 3) by title; the person's outline is drawn on the temperatures."""
    cloud, parts, persons = frame.cloud, frame.labels.parts[::STEP, ::STEP], frame.labels.persons
    color = np.ascontiguousarray(cloud.color_rgb[::STEP, ::STEP])
    share = (FAR_M - cloud.points_m[::STEP, ::STEP, 2].ravel()) / (FAR_M - NEAR_M)
    depth = _image(mapped_rgb(share, MAPS["depth"], _NONE), parts.shape)
    heat = _image(heat_rgb(cloud.temperature_c[::STEP, ::STEP].ravel(), _NONE), parts.shape)
    assert persons is not None
    heat[edges(persons[::STEP, ::STEP], cloud.valid[::STEP, ::STEP])] = 255
    labelled = (color if color.any() else depth) // np.uint8(DIM)
    body = parts != BACKGROUND
    labelled[body] = frame.labels.scheme.palette_rgb()[parts[body]]
    return dict(zip(TITLES, (depth, color, heat, labelled), strict=True))


def joints_px(frame: LiveFrame) -> Float64 | None:
    """Return joints (J, 2) in the pictures' pixels, None without a person."""
    if frame.body_pose is None:
        return None
    return project(frame.cloud.camera, frame.body_pose.joints_m) / STEP


def live_scene(frame: LiveFrame) -> FrameScene:
    """Return the scene of the cloud view: the whole person, a thinned room, no selectable supervoxels."""
    near, room, step = levels(frame.labels, None, ROOM_POINTS)
    pieces = np.full(frame.labels.parts.shape, -1, np.int32)
    return FrameScene(frame.labels, frame.cloud, None, near, room, step, shade_of(frame.cloud), pieces)


def _image(colors: Float32, shape: tuple[int, ...]) -> UInt8:
    """Return colours (h * w, 3), 0 to 255, as a picture uint8 (h, w, 3). shape: (h, w)."""
    return np.ascontiguousarray(colors.astype(np.uint8).reshape(*shape, 3))
