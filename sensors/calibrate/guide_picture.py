"""Picture for the person who holds the hole plate: views so far, where it is, and where to hold it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.calibrate.guide import Guidance, Room
from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import PlateView
from sensors.rig.camera import Intrinsics, project

WIDTH_PX = 1024
"""Width of the picture. Chosen by eye."""
COVERED, NOW, WANTED = (201, 176, 60), (255, 255, 255), (32, 176, 255)
"""Colours (blue, green, red) of holes seen so far, of the plate as it is held, and as it is wanted."""
LEAST_GREY = 40
"""Grey of an image without contrast. Chosen by eye."""

Image = NDArray[np.uint8]


def guide_picture(
    guidance: Guidance,
    views: list[PlateView],
    now: PlateView | None,
    infrared: NDArray[np.uint16] | None,
    camera: Intrinsics,
    plate: HolePlate,
    room: Room,
) -> Image:
    """The depth camera's infrared image, enlarged, with holes and plates drawn in: (h, w, 3) BGR."""
    scale = WIDTH_PX / camera.width
    picture = _grey(infrared, camera, scale)
    for view in views:
        _dots(picture, view.centers_px["depth"], scale, COVERED)
    if now is not None and "depth" in now.centers_px:
        _dots(picture, now.centers_px["depth"], scale, NOW)
    if guidance.wanted is not None:
        _plate(picture, guidance, camera, plate, room, scale)
    text = "done" if guidance.wanted is None else f"{len(views)} views; hold it {guidance.wanted.text}"
    picture[:44] //= 3
    cv2.putText(picture, text, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.62, NOW, 1, cv2.LINE_AA)
    return picture


def _grey(infrared: NDArray[np.uint16] | None, camera: Intrinsics, scale: float) -> Image:
    grey = np.full(camera.shape, LEAST_GREY, np.uint8)
    if infrared is not None and (top := float(np.percentile(infrared, 99))) > 0:
        grey = np.clip(infrared * (160 / top), 0, 255).astype(np.uint8)
    size = round(camera.width * scale), round(camera.height * scale)
    return np.asarray(cv2.cvtColor(cv2.resize(grey, size), cv2.COLOR_GRAY2BGR), np.uint8)


def _dots(picture: Image, px: NDArray[np.float64], scale: float, color: tuple[int, int, int]) -> None:
    for u, v in np.rint(scale * px).astype(int).tolist():
        cv2.circle(picture, (u, v), 3, color, -1, cv2.LINE_AA)


def _plate(
    picture: Image, guidance: Guidance, camera: Intrinsics, plate: HolePlate, room: Room, scale: float
) -> None:
    """Outline and holes of the plate where it is wanted."""
    assert guidance.wanted is not None
    pose, (low, high) = room.pose(guidance.wanted, plate), plate.size_m
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    outline, holes = (
        scale * project(camera, pose.apply(np.c_[at, np.zeros(len(at))])) for at in (corners, plate.centers_m)
    )
    cv2.polylines(picture, [np.rint(outline).astype(np.int32)], True, WANTED, 2, cv2.LINE_AA)
    for u, v in np.rint(holes).astype(int).tolist():
        cv2.circle(picture, (u, v), 5, WANTED, 1, cv2.LINE_AA)
