"""FLIR's radiometric JPEG images alone, one or a folder of them, as a source of frames without depth."""

from pathlib import Path

import cv2
import numpy as np

from sensors.files.bounded import read_bounded
from sensors.files.flir_jpeg import is_flir, read_flir
from sensors.files.natural_order import paths_in_order
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, regular_times_ns
from sensors.rig.rig_calibration import Pose, RigCalibration

JPEGS = (".jpg", ".jpeg")
ASSUMED_WIDE_DEG = 45.0
"""Horizontal field of view where nobody knows: between the 24 and 57 degrees of FLIR's common lenses."""
PERIOD_NS = 1_000_000_000
"""Between two images."""


class FlirImages(FrameSource):
    """Radiometric JPEGs as a ``FrameSource``: temperatures, depth images without a reading, photographs.

    In the order of their names. notes: what is absent or assumed. Raises FormatError.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.resolve().stem
        self._files = jpegs_in(path) if path.is_dir() else [path]
        self.times_ns = regular_times_ns(len(self._files), PERIOD_NS)
        first = read_flir(read_bounded(self._files[0]), str(self._files[0]))
        height, width = first.celsius.shape
        focal_px = width / 2 / np.tan(np.radians(ASSUMED_WIDE_DEG / 2))
        lens = Intrinsics(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
        self.calibration = RigCalibration(lens, thermal=lens, thermal_from_depth=Pose.identity())
        self.notes = (
            "no depth images: temperatures alone cannot be labelled",
            f"a lens {ASSUMED_WIDE_DEG:g} degrees wide is assumed",
            "no time stamps: one image a second assumed",
            "no photographs"
            if first.photo is None
            else "photographs are not calibrated: they cannot be fused",
        )

    def _frame(self, index: int) -> RigFrame:
        file = self._files[index]
        image = read_flir(read_bounded(file), str(file))
        encoded = None
        if image.photo is not None:
            bgr = np.ascontiguousarray(image.photo[..., ::-1])
            encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        nothing = np.zeros(image.celsius.shape, np.uint16)
        return RigFrame(index, int(self.times_ns[index]), nothing, encoded, image.celsius)


def jpegs_in(folder: Path) -> list[Path]:
    """The JPEGs of a folder, in the natural order of their names, without hidden ones."""
    found = (file for file in folder.iterdir() if file.suffix.lower() in JPEGS and file.is_file())
    return paths_in_order(file for file in found if not file.name.startswith("."))


def is_flir_alone(path: Path) -> bool:
    """Whether a JPEG, or the first of a folder that has nothing else, holds FLIR's data."""
    if not path.is_dir():
        return is_flir(path)
    files = jpegs_in(path)
    if not files or (path / "depth").exists() or any(path.glob("*.png")):
        return False
    return is_flir(files[0])
