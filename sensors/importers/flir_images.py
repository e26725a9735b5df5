"""Radiometric JPEGs with FLIR's data alone, one or a folder of them, as a source of frames without depth."""

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.files.flir_jpeg import FlirImage, has_flir, read_flir
from sensors.importers.folder_files import JPEGS, files_of
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, regular_times_ns
from sensors.rig.rig_calibration import Pose, RigCalibration

ASSUMED_WIDE_DEG = 45.0
"""Horizontal field of view where no file states it: between the 24 and 57 degrees of FLIR's common lenses."""
PERIOD_NS = 1_000_000_000
"""Nanoseconds between two images without times. Untuned."""
NAMED = 3
"""Files that a note names at most."""


class _Facts(NamedTuple):
    """Facts of an image. shape: (h, w). photo: whether the file holds a photograph."""

    shape: tuple[int, ...]
    photo: bool
    wide_deg: float
    taken_ns: int


class FlirImages(FrameSource):
    """Radiometric JPEGs as a ``FrameSource``: temperatures, depth images without a reading, photographs.

    Frames are in natural order of the names. Photographs without temperatures, and images of another size
    than most, are left out. notes: left out, absent and assumed data. Raises FormatError.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.resolve().stem
        found = files_of(path, JPEGS) if path.is_dir() else [path]
        thermal = [file for file in found if has_flir(file)]
        if not thermal:
            raise FormatError(
                f"{path} holds no FLIR camera's radiometric JPEG; give one as the camera wrote it"
            )
        facts = {file: _facts(read_flir(read_bounded(file), str(file))) for file in thermal}
        (shape, _), *others = Counter(fact.shape for fact in facts.values()).most_common()
        self._files = [file for file in thermal if facts[file].shape == shape]
        kept = [facts[file] for file in self._files]
        wide_deg, lens_note = _field(kept)
        height, width = shape
        focal_px = width / 2 / np.tan(np.radians(wide_deg / 2))
        lens = Intrinsics(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
        self.calibration = RigCalibration(lens, thermal=lens, thermal_from_depth=Pose.identity())
        self.times_ns, time_note = _times_ns(kept)
        photographs = [file for file in found if file not in facts]
        other = [file for file in thermal if file not in self._files]
        self.notes = (
            "no depth images: temperatures alone cannot be labelled",
            lens_note,
            time_note,
            "photographs are not calibrated: they cannot be fused"
            if any(fact.photo for fact in kept)
            else "no photographs",
            *_left_out(photographs, "photographs without temperatures"),
            *(_left_out(other, f"images of another size than {width}x{height}") if others else ()),
        )

    def _frame(self, index: int) -> RigFrame:
        file = self._files[index]
        image = read_flir(read_bounded(file), str(file))
        nothing = np.zeros(image.celsius.shape, np.uint16)
        return RigFrame(index, int(self.times_ns[index]), nothing, image.photo, image.celsius)


def _facts(image: FlirImage) -> _Facts:
    return _Facts(image.celsius.shape, image.photo is not None, image.wide_deg, image.taken_ns)


def is_flir_alone(path: Path) -> bool:
    """Return whether a JPEG, or any of a folder that has no depth images, holds FLIR's data."""
    if not path.is_dir():
        return has_flir(path)
    if (path / "depth").exists() or any(path.glob("*.png")):
        return False
    return any(has_flir(file) for file in files_of(path, JPEGS))


def _field(facts: list[_Facts]) -> tuple[float, str]:
    """Return the horizontal field of view in degrees, and a note on its source."""
    stated = [fact.wide_deg for fact in facts if fact.wide_deg]
    if not stated:
        return ASSUMED_WIDE_DEG, f"a lens {ASSUMED_WIDE_DEG:g} degrees wide is assumed"
    wide = float(np.median(stated))
    differ = "" if np.ptp(stated) < 0.5 else f" (others are {min(stated):.3g} to {max(stated):.3g})"
    return wide, f"a lens {wide:.3g} degrees wide, as the files state{differ}"


def _times_ns(facts: list[_Facts]) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], str]:
    """Return the images' stamps if they all grow with the names, else one a second; and a note."""
    taken = np.array([fact.taken_ns for fact in facts], np.int64)
    if taken.min() > 0 and (np.diff(taken) > 0).all():
        return taken, "times are those of the camera's clock"
    return regular_times_ns(len(facts), PERIOD_NS), "no growing time stamps: one image a second is assumed"


def _left_out(files: list[Path], what: str) -> tuple[str, ...]:
    if not files:
        return ()
    names = ", ".join(file.name for file in files[:NAMED]) + (", ..." if len(files) > NAMED else "")
    return (f"{len(files)} {what} left out: {names}",)
