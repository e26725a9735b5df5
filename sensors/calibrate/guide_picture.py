"""Picture for the person who holds the hole plate: earlier views, and the plate's current and wanted
place.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.calibrate.guide import Guidance, PlateSetup
from sensors.calibrate.plate_view import PlateView
from sensors.rig.camera import Intrinsics, project

WIDTH_PX = 1024
COVERED, NOW, WANTED = (201, 176, 60), (255, 255, 255), (32, 176, 255)  # blue, green, red
LEAST_GREY = 40  # of an image without contrast; untuned

Image = NDArray[np.uint8]


def guide_picture(
    guidance: Guidance,
    views: list[PlateView],
    now: PlateView | None,
    infrared: NDArray[np.uint16] | None,
    setup: PlateSetup,
) -> Image:
    """Return the depth camera's infrared image, enlarged, with holes and plate outlines drawn: (h, w,
    3) BGR.
    """
    camera = setup.guess.depth
    scale = WIDTH_PX / camera.width
    picture = _grey(infrared, camera, scale)
    for view in views:
        _dots(picture, scale * view.centers_px["depth"], COVERED)
    if now is not None and "depth" in now.centers_px:
        _dots(picture, scale * now.centers_px["depth"], NOW)
    text = "done"
    if guidance.wanted is not None:
        text = f"{len(views)} views; hold it {guidance.wanted.text}"
        pose, (low, high) = setup.pose(guidance.wanted), setup.plate.size_m
        corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
        outline, holes = (
            scale * project(camera, pose.apply(np.c_[at, np.zeros(len(at))]))
            for at in (corners, setup.plate.centers_m)
        )
        cv2.polylines(picture, [np.rint(outline).astype(np.int32)], True, WANTED, 2, cv2.LINE_AA)
        _dots(picture, holes, WANTED, 5, 1)
    picture[:44] //= 3
    cv2.putText(picture, text, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.62, NOW, 1, cv2.LINE_AA)
    return picture


def _grey(infrared: NDArray[np.uint16] | None, camera: Intrinsics, scale: float) -> Image:
    grey = np.full(camera.shape, LEAST_GREY, np.uint8)
    if infrared is not None and (top := float(np.percentile(infrared, 99))) > 0:
        grey = np.clip(infrared * (160 / top), 0, 255).astype(np.uint8)
    size = round(camera.width * scale), round(camera.height * scale)
    return np.asarray(cv2.cvtColor(cv2.resize(grey, size), cv2.COLOR_GRAY2BGR), np.uint8)


def _dots(
    picture: Image, px: NDArray[np.float64], color: tuple[int, int, int], radius: int = 3, line: int = -1
) -> None:
    for u, v in np.rint(px).astype(int).tolist():
        cv2.circle(picture, (u, v), radius, color, line, cv2.LINE_AA)
