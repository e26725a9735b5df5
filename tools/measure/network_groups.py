"""Scores of a network by group of images: facing, skirt, sensor, posture, and changed images.

Facing is right to 20 degrees. Every fourth image is also measured with 5 % of its pixels lost, squeezed and
cut off.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.crop import RANGE_MM, network_crop, normalize, person_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import open_frames
from annotate.parts import PAPER, UNDEFINED
from annotate.posture import POSTURES
from eval.network.onnx_network import OnnxNetwork
from eval.network.posture_model import with_posture
from eval.network.refine import camera_in
from eval.scores.confusion import confusion_matrix
from eval.scores.intervals import UNKNOWN
from eval.training.body_targets import FACING, POSTURE, body_targets
from eval.training.crops import to_crop
from synth.data_files import CASTS, table_of

Crop = tuple[Float32, UInt8]
BATCH, EACH = 32, 4
LEAST_PIXELS = 300  # of a person that a change leaves
COS = float(np.cos(np.radians(20)))


def squeezed(crop: Crop, factor: float) -> Crop | None:
    """Return a person ``factor`` times as wide, in a crop that fits."""
    middle = (crop[0].shape[1] - 1) / 2
    matrix = np.array([[factor, 0, middle * (1 - factor)], [0, 1, 0]]) / max(1.0, factor)
    depth, parts = (cv2.warpAffine(x, matrix, x.shape, flags=cv2.INTER_NEAREST) for x in crop)
    return refitted((np.asarray(depth, np.float32), np.asarray(parts, np.uint8)))


def kept(crop: Crop, first: float, last: float, axis: int) -> Crop | None:
    """Return an image that ends at these shares of a person's rows (axis 0) or columns."""
    rows = np.flatnonzero((crop[0] > 0).any(axis=1 - axis))
    low, high = (round(rows[0] + share * (rows[-1] + 1 - rows[0])) for share in (first, last))
    inside = np.zeros(crop[0].shape, np.bool_)
    inside[(slice(low, high), slice(None))[:: 1 - 2 * axis]] = True
    return refitted((np.where(inside, crop[0], np.float32(0)), np.where(inside, crop[1], np.uint8(0))))


def refitted(crop: Crop) -> Crop | None:
    """Return a crop's person cut out again, as `predict` would; None below ``LEAST_PIXELS``."""
    depth, parts = (np.pad(x, ((0, 1), (0, 1))) for x in crop)
    if np.count_nonzero(parts) < LEAST_PIXELS:
        return None
    depth_mm = np.where(depth > 0, np.rint(depth * RANGE_MM + RANGE_MM), 0).astype(np.uint16)
    square = network_crop(depth > 0)
    return normalize(square.cut(depth_mm, 0), square.cut(depth > 0, False)), square.cut(parts, 0)


def holed(crop: Crop) -> Crop:
    """Return a crop that has lost 5 % of its pixels."""
    lost = np.random.default_rng(int(crop[1].sum())).random(crop[0].shape) < 0.05
    return np.where(lost, np.float32(0), crop[0]), crop[1]


CHANGES: dict[str, Callable[[Crop], Crop | None]] = {
    "every fourth, as it is": lambda crop: crop,
    "5 % holes": holed,
    "width x 0.8": lambda crop: squeezed(crop, 0.8),
    "width x 1.25": lambda crop: squeezed(crop, 1.25),
    "to the knees": lambda crop: kept(crop, 0, 0.72, 0),
    "to the waist": lambda crop: kept(crop, 0, 0.45, 0),
    "to the chest": lambda crop: kept(crop, 0, 0.28, 0),
    "one side": lambda crop: kept(crop, 0, 0.6, 1),
}


@dataclass
class Tally:
    """Counts of a group of n images.

    facing, posture: (right, known) of each; a posture that cannot be told is not right. true_postures: names;
    "" if unknown.
    """

    subjects: list[str] = field(default_factory=list)
    matrices: list[np.ndarray] = field(default_factory=list)
    facing: list[tuple[bool, bool]] = field(default_factory=list)
    posture: list[tuple[bool, bool]] = field(default_factory=list)
    true_postures: list[str] = field(default_factory=list)


def groups(frame: FrameLabels, row: Float32) -> Iterator[str]:
    """Yield the names of the groups that a frame belongs to. row: its joint and facing targets."""
    yield "all"
    azimuth = abs(np.degrees(np.arctan2(row[FACING][1], row[FACING][0])))
    if np.isfinite(azimuth):
        view = "from the front" if azimuth < 45 else "from the side" if azimuth < 135 else "from behind"
        yield view
        if "clothes" in frame.notes:
            skirts = {name for cast in CASTS for name in table_of(cast, "clothes")["skirts"]}
            in_skirt = not skirts.isdisjoint(frame.notes["clothes"])
            yield f"{view}, {'in a skirt' if in_skirt else 'without a skirt'}"
    if "sensor" in frame.notes:
        yield f"sensor: {frame.notes['sensor']['kind']}"
    if np.isfinite(row[POSTURE]):
        yield f"posture: {POSTURES[int(row[POSTURE])]}"
    if frame.notes.get("beyond", 0) > 0.1:
        yield "cut by the image"


def measured(network: OnnxNetwork, path: Path) -> dict[str, Tally]:
    """Count a dataset's images by group."""
    frames, tallies = open_frames(path), defaultdict[str, Tally](Tally)
    waiting: list[tuple[Crop, FrameLabels, list[str], Float32 | None]] = []

    def count() -> None:
        planes, *whole = network.outputs(np.stack([crop[0] for crop, *_ in waiting]))
        for k, ((depth, parts), frame, names, row) in enumerate(waiting):
            found = np.where(depth > 0, network.merged(planes[k])[1:].argmax(0) + 1, 0).astype(np.uint8)
            matrix = confusion_matrix(np.where(depth > 0, parts, np.uint8(UNDEFINED)), found, PAPER)
            facing = posture = (False, False)
            true_posture = ""
            if whole and row is not None:
                mask = person_of(frame.parts) & (frame.depth_mm > 0)
                image, camera = (frame.depth_mm, mask), camera_in(frames, frame)
                outputs = [values[k] for values in whole]
                own = network.body_state(network_crop(mask), image, outputs, planes[k], camera)
                if np.isfinite(row[FACING]).all():
                    azimuth = np.radians(own.faced_by_joints(camera).facing_deg)
                    facing = bool(np.array([np.cos(azimuth), np.sin(azimuth)]) @ row[FACING] > COS), True
                if np.isfinite(row[POSTURE]):
                    true_posture = POSTURES[int(row[POSTURE])]
                    posture = with_posture(own, image, camera).name == true_posture, True
            for name in names:
                tally = tallies[name]
                tally.subjects.append(frame.subject or UNKNOWN)
                tally.matrices.append(matrix)
                tally.facing.append(facing)
                tally.posture.append(posture)
                tally.true_postures.append(true_posture)
        waiting.clear()

    for number, frame in enumerate(frames):
        crop, row = to_crop(frame), body_targets(frames, frame)
        waiting.append((crop, frame, list(groups(frame, row)), row))
        if number % EACH == 0:
            changed = ((name, change(crop)) for name, change in CHANGES.items())
            waiting += [(crop, frame, [name], None) for name, crop in changed if crop is not None]
        if len(waiting) >= BATCH:
            count()
    if waiting:
        count()
    return tallies
