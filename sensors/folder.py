"""A folder of 16-bit depth PNGs, with colour and thermal images where there are some, as a source of frames.

Layout, everything but depth optional::

    depth/NAME.png      16-bit depth; or NAME.depth.png, or NAME.png, in the folder itself
    color/NAME.jpg      JPEG or PNG of the same name
    thermal/NAME.png    16-bit temperatures in the scale of a session (``messages.THERMAL_OFFSET_C``)
    calibration.json    the rig's calibration as ``calibration.save_calibration`` writes it; or
    intrinsics.json     {"fx", "fy", "cx", "cy", "width", "height"}, optionally "k1", "k2", "p1", "p2", "k3"
                        and "depth_unit_mm", the millimetres of one depth step (default 1)
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.calibration import MAX_CALIBRATION_BYTES, RigCalibration, load_calibration
from sensors.camera import Intrinsics
from sensors.errors import CalibrationError, FormatError
from sensors.frame import MAX_DEPTH_MM, RigFrame
from sensors.messages import thermal_from_uint16
from sensors.png import decode_grey, png_shape

FRAME_PERIOD_NS = 33_333_333
"""Stamps of images that carry none: 30 a second."""

MAX_FILE_BYTES = 1 << 28
_NUMBERS = frozenset({"fx", "fy", "cx", "cy", "width", "height"})
_OPTIONAL = frozenset({"k1", "k2", "p1", "p2", "k3", "depth_unit_mm"})


class ImageFolder:
    """An image folder as a ``FrameSource``, frames in the order of their names, read one at a time.

    notes: what is absent or assumed, one sentence each. Raises FormatError when there are no depth images,
    CalibrationError when the intrinsics are missing or contradict them.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.resolve().name
        self._depth = _depth_files(path)
        self._color = _matching(path / "color", (".jpg", ".jpeg", ".png"), self._depth)
        self._thermal = _matching(path / "thermal", (".png",), self._depth)
        self.calibration, self._unit_mm, origin = _calibration(path, next(iter(self._depth.values())))
        self.notes = (
            origin,
            "no time stamps: 30 frames a second assumed",
            *_presence("colour", self._color, len(self._depth), self.calibration.color),
            *_presence("thermal", self._thermal, len(self._depth), self.calibration.thermal),
        )

    def __len__(self) -> int:
        return len(self._depth)

    def __iter__(self) -> Iterator[RigFrame]:
        return (self._frame(index, stem) for index, stem in enumerate(self._depth))

    def _frame(self, index: int, stem: str) -> RigFrame:
        depth = _grey16(self._depth[stem], self.calibration.depth)
        thermal, color = self._thermal.get(stem), self._color.get(stem)
        return RigFrame(
            index=index,
            stamp_ns=index * FRAME_PERIOD_NS,
            depth_mm=_to_mm(depth, self._unit_mm),
            color_encoded=_read(color) if color else None,
            thermal_c=thermal_from_uint16(_grey16(thermal, self.calibration.thermal)) if thermal else None,
        )


def _depth_files(path: Path) -> dict[str, Path]:
    """Depth files by name without suffix, sorted."""
    if (path / "depth").is_dir():
        files = {file.stem: file for file in (path / "depth").glob("*.png")}
    else:
        suffixed = list(path.glob("*.depth.png"))
        files = {file.name.removesuffix(".depth.png"): file for file in suffixed}
        files = files or {file.stem: file for file in path.glob("*.png")}
    if not files:
        raise FormatError(f"{path} holds no depth images; put 16-bit PNGs into {path / 'depth'}")
    return dict(sorted(files.items()))


def _matching(folder: Path, suffixes: tuple[str, ...], depth: dict[str, Path]) -> dict[str, Path]:
    files = {f.stem: f for f in sorted(folder.glob("*")) if f.suffix.lower() in suffixes}
    matching = {stem: file for stem, file in files.items() if stem in depth}
    if files and not matching:
        first = next(iter(depth))
        raise FormatError(
            f"no image in {folder} is named like a depth image; name them alike, e.g. {first}{suffixes[0]}"
        )
    return matching


def _presence(name: str, files: dict[str, Path], frames: int, camera: Intrinsics | None) -> tuple[str, ...]:
    if not files:
        return (f"no {name} images",)
    notes = (
        () if len(files) == frames else (f"{frames - len(files)} of {frames} frames have no {name} image",)
    )
    return notes if camera else (*notes, f"no calibration of the {name} camera: its images cannot be fused")


def _calibration(path: Path, first_depth: Path) -> tuple[RigCalibration, float, str]:
    """Calibration, millimetres of a depth step, and a note that says where they are from."""
    if (path / "calibration.json").is_file():
        return load_calibration(path / "calibration.json"), 1.0, "calibration from calibration.json"
    file = path / "intrinsics.json"
    if not file.is_file():
        height, width = png_shape(_read(first_depth), str(first_depth))
        raise CalibrationError(
            f"{path} has no intrinsics; add {file} holding "
            f'{{"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": {width}, "height": {height}}} '
            "with the depth camera's four numbers in pixels"
        )
    numbers = _numbers(file)
    unit_mm = float(numbers.pop("depth_unit_mm", 1.0))
    if not 0 < unit_mm <= 1000:
        raise CalibrationError(f"{file} says depth_unit_mm is {unit_mm}; give a number above 0, up to 1000")
    size = {side: int(numbers.pop(side)) for side in ("width", "height")}
    return RigCalibration(Intrinsics(**size, **numbers)), unit_mm, "intrinsics from intrinsics.json"


def _numbers(file: Path) -> dict[str, Any]:
    try:
        fields = json.loads(_read(file, MAX_CALIBRATION_BYTES))
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{file} is no JSON ({error}); correct it") from error
    if not isinstance(fields, dict) or not set(fields) >= _NUMBERS or set(fields) - _NUMBERS - _OPTIONAL:
        raise CalibrationError(f"{file} must hold {sorted(_NUMBERS)}, optionally {sorted(_OPTIONAL)}")
    for name, value in fields.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
            raise CalibrationError(f"{file} says {name} is {str(value)[:40]!r}; give a finite number")
    return fields


def _grey16(file: Path, camera: Intrinsics | None) -> NDArray[np.uint16]:
    image: NDArray[np.uint16] = decode_grey(_read(file), np.uint16, str(file))
    if camera is not None and image.shape != camera.shape:
        raise CalibrationError(
            f"{file} is {image.shape[1]}x{image.shape[0]} but its calibration says "
            f"{camera.width}x{camera.height}; give the calibration of this camera"
        )
    return image


def _to_mm(depth: NDArray[np.uint16], unit_mm: float) -> NDArray[np.uint16]:
    if unit_mm == 1.0:
        return depth
    millimetres = np.rint(depth.astype(np.float64) * unit_mm)
    return np.where(millimetres <= MAX_DEPTH_MM, millimetres, 0).astype(np.uint16)


def _read(file: Path, limit: int = MAX_FILE_BYTES) -> bytes:
    try:
        if file.stat().st_size > limit:
            raise FormatError(f"{file} is larger than {limit} bytes; restore it from a copy")
        return file.read_bytes()
    except OSError as error:
        raise FormatError(f"{file} cannot be read ({error.strerror}); restore it from a copy") from error
