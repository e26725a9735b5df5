"""Radiometric JPEGs with FLIR's data alone, one or a folder of them, as a source of frames without depth."""

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.files.flir_jpeg import FlirImage, has_flir, read_flir
from sensors.importers.folder_files import JPEGS, files_of
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, regular_times_ns
from sensors.rig.rig_calibration import Pose, RigCalibration

ASSUMED_WIDE_DEG = 45.0  # horizontal field: between the 24 and 57 degrees of FLIR's common lenses
PERIOD_NS = 1_000_000_000  # between two images without times; untuned
NAMED = 3  # files that a note names at most


class FlirImages(FrameSource):
    """Radiometric JPEGs as a ``FrameSource``: temperatures, depth images without a reading, photographs.

    Frames are in natural order of the names. Photographs without temperatures, and images of another size
    than most, are left out. notes: left out, missing and assumed data. Raises FormatError without a
    radiometric JPEG.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.resolve().stem
        found = files_of(path, JPEGS) if path.is_dir() else [path]
        thermal = [file for file in found if has_flir(file)]
        if not thermal:
            raise FormatError(
                f"{path} holds no FLIR camera's radiometric JPEG; give one as the camera wrote it"
            )
        # Shape, field, time and whether there is a photograph: pixels would fill the memory.
        facts = {file: _facts(_read(file)) for file in thermal}
        shape = Counter(fact[0] for fact in facts.values()).most_common(1)[0][0]
        self._files = [file for file in thermal if facts[file][0] == shape]
        _, fields_deg, taken_ns, photos = zip(*(facts[file] for file in self._files), strict=True)
        wide_deg, lens_note = _field(fields_deg)
        height, width = shape
        focal_px = width / 2 / np.tan(np.radians(wide_deg / 2))
        lens = Intrinsics(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
        self.calibration = RigCalibration(lens, thermal=lens, thermal_from_depth=Pose.identity())
        self.times_ns, time_note = _times_ns(np.array(taken_ns, np.int64))
        photographs = [file for file in found if file not in facts]
        other = [file for file in thermal if file not in self._files]
        self.notes = (
            "no depth images: temperatures alone cannot be labelled",
            lens_note,
            time_note,
            "photographs are not calibrated: they cannot be fused" if any(photos) else "no photographs",
            *_left_out(photographs, "photographs without temperatures"),
            *_left_out(other, f"images of another size than {width}x{height}"),
        )

    def _frame(self, index: int) -> RigFrame:
        image = _read(self._files[index])
        nothing = np.zeros(image.celsius.shape, np.uint16)
        return RigFrame(index, int(self.times_ns[index]), nothing, image.photo, image.celsius)


def is_flir_alone(path: Path) -> bool:
    """Return whether a path is a JPEG with FLIR's data, or a folder with such JPEGs and no depth images."""
    if not path.is_dir():
        return has_flir(path)
    if (path / "depth").exists() or any(path.glob("*.png")):
        return False
    return any(has_flir(file) for file in files_of(path, JPEGS))


def _read(file: Path) -> FlirImage:
    return read_flir(read_bounded(file), str(file))


def _facts(image: FlirImage) -> tuple[tuple[int, ...], float, int, bool]:
    return image.celsius.shape, image.wide_deg, image.taken_ns, image.photo is not None


def _field(fields_deg: tuple[float, ...]) -> tuple[float, str]:
    """Return the horizontal field of view in degrees, and a note on its origin."""
    stated = [field for field in fields_deg if field]
    if not stated:
        return ASSUMED_WIDE_DEG, f"a lens {ASSUMED_WIDE_DEG:g} degrees wide is assumed"
    wide = float(np.median(stated))
    differ = "" if np.ptp(stated) < 0.5 else f" (others are {min(stated):.3g} to {max(stated):.3g})"
    return wide, f"a lens {wide:.3g} degrees wide, as the files state{differ}"


def _times_ns(taken_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], str]:
    """Return the images' stamps if they increase in the order of names, else one image a second; and a
    note.
    """
    if taken_ns.min() > 0 and (np.diff(taken_ns) > 0).all():
        return taken_ns, "times from the camera's clock"
    note = "no growing time stamps: one image a second is assumed"
    return regular_times_ns(len(taken_ns), PERIOD_NS), note


def _left_out(files: list[Path], what: str) -> list[str]:
    names = ", ".join(file.name for file in files[:NAMED]) + (", ..." if len(files) > NAMED else "")
    return [f"{len(files)} {what} left out: {names}"] if files else []
