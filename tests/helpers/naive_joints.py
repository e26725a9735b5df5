"""Twin of the scores of joints: plain loops over JSON notes and pixels, from the definitions alone."""

import math
from collections import defaultdict
from typing import Any

from annotate.frame_labels import FrameLabels
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_SIDES = [[f"{side}_{kind}" for kind in _LIMBS] for side in ("left", "right")]
SKELETON = ["pelvis", "spine_lower", "spine_middle", "spine_upper", "neck", "head"]
SKELETON += [name for side in ("left", "right") for name in (f"{side}_clavicle", *_SIDES[side == "right"])]
OF_NETWORK = ["head", "neck", "pelvis", *_SIDES[0], *_SIDES[1]]
THICK_MM = {"head": 120, "neck": 190, "pelvis": 220, "shoulder": 210, "elbow": 90, "wrist": 70} | {
    "hip": 270, "knee": 120, "ankle": 90
}  # fmt: skip


def joints_of(predicted: FrameLabels, truth: FrameLabels, camera: Any = KINECT2_PINHOLE) -> list[tuple]:
    """Return (joint, visibility, error in millimetres) of each true joint of a frame.

    camera: (width, height, fx, fy, cx, cy), or intrinsics, of the whole image.
    """
    if "intrinsics" in truth.notes:
        camera = truth.notes["intrinsics"]
    elif not isinstance(camera, tuple | list):
        camera = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    width, height, fx, fy, cx, cy = camera
    rows, columns = len(truth.depth_mm), len(truth.depth_mm[0])
    top, left, side = truth.notes.get("crop", (0, 0, rows))
    scale = side / rows  # of a pixel of the crop in pixels of the image
    given = (predicted.notes.get("bearing") or {}).get("joints_px")
    found = []
    for k, name in enumerate(OF_NETWORK):
        x, y, z = truth.notes["joints_mm"][SKELETON.index(name)]
        error = math.inf
        if given:
            u, v, depth = given[k]
            u, v = (u + 0.5) * scale - 0.5 + left, (v + 0.5) * scale - 0.5 + top
            error = math.dist(((u - cx) / fx * depth, (v - cy) / fy * depth, depth), (x, y, z))
        seen = "outside"
        if (
            z > 0
            and -0.5 <= (u := x / z * fx + cx) < width - 0.5
            and -0.5 <= (v := y / z * fy + cy) < height - 0.5
        ):
            column, row = (math.floor((a + 0.5 - b) / scale) for a, b in ((u, left), (v, top)))
            there = 0 <= row < rows and 0 <= column < columns
            reading = int(truth.depth_mm[row][column]) if there else 0
            body = -60 <= z - reading <= THICK_MM[name.replace("left_", "").replace("right_", "")]
            seen = "visible" if reading > 0 and body else "hidden"
        found.append((name, seen, error))
    return found


def scores_of(joints: list[tuple]) -> dict[str, dict[str, float]]:
    """Return mean error and shares within 50, 100 and 150 mm of each group of joints."""
    groups = defaultdict(list)
    for name, seen, error in joints:
        groups[seen].append(error)
        if seen != "outside":
            groups["inside"].append(error)
            groups[name].append(error)
    scores = {}
    for group, errors in groups.items():
        given = [error for error in errors if error < math.inf]
        scores[group] = {"mpjpe_mm": sum(given) / len(given) if given else math.nan, "joints": len(errors)}
        scores[group]["missed"] = len(errors) - len(given)
        for mm in (50, 100, 150):
            scores[group][f"pck_{mm}mm"] = sum(error <= mm for error in errors) / len(errors)
    return scores
