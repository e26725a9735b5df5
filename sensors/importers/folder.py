"""A folder of 16-bit depth PNGs, with colour and thermal images where there are some, as a source of frames.

Layout, everything but depth optional::

    depth/NAME.png      16-bit depth; or NAME.depth.png, or NAME.png, in the folder itself
    color/NAME.jpg      JPEG or PNG of the same name; or in rgb/
    thermal/NAME.png    16-bit temperatures in the scale of a session (``messages.THERMAL_OFFSET_C``); or
                        NAME.jpg, a FLIR camera's radiometric JPEG
    associations.txt    which colour belongs to which depth image, and when they were taken, where names
                        differ; or depth.txt and rgb.txt (see ``associations``)
    calibration.json    the rig's calibration as ``calibration.save_calibration`` writes it; or
    intrinsics.json     the depth camera's numbers (see ``intrinsics_file``); or intrinsic.json,
                        camera_intrinsic.json, camera_intrinsics.json
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.files.flir_jpeg import read_flir
from sensors.files.png import decode_grey, png_shape
from sensors.importers.tum_lists import (
    ASSOCIATIONS,
    TUM_UNIT_MM,
    WINDOW_NS,
    Image,
    is_tum,
    read_associations,
    read_list,
)
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FRAME_PERIOD_NS, FrameSource, RigFrame, mm_from_units
from sensors.rig.intrinsics_file import first_intrinsics
from sensors.rig.pairing import pair_stamps
from sensors.rig.rig_calibration import Pose, RigCalibration, load_calibration
from sensors.session.messages import thermal_from_uint16

INTRINSICS = ("intrinsics.json", "intrinsic.json", "camera_intrinsic.json", "camera_intrinsics.json")


class ImageFolder(FrameSource):
    """An image folder as a ``FrameSource``, frames in the order of their names, read one at a time.

    notes: what is absent or assumed, one sentence each. Raises FormatError when there are no depth images,
    CalibrationError when the intrinsics are missing or contradict them.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.resolve().name
        self._depth, self._stamps_ns, self._color, timing = _colors(path, _depth_files(path))
        stamps = (self._stamps_ns.get(stem, i * FRAME_PERIOD_NS) for i, stem in enumerate(self._depth))
        self.times_ns = np.fromiter(stamps, np.int64, len(self._depth))
        self._stems = tuple(self._depth)
        self._thermal = _matching(path / "thermal", (".png", ".jpg", ".jpeg"), self._depth)
        self.calibration, self._unit_mm, origin = _calibration(path, next(iter(self._depth.values())))
        self.notes = (
            *origin,
            timing,
            *_presence("colour", self._color, len(self._depth), self.calibration.color),
            *_presence("thermal", self._thermal, len(self._depth), self.calibration.thermal),
        )

    def _frame(self, index: int) -> RigFrame:
        stem = self._stems[index]
        thermal, color = self._thermal.get(stem), self._color.get(stem)
        return RigFrame(
            index=index,
            stamp_ns=int(self.times_ns[index]),
            depth_mm=mm_from_units(_grey16(self._depth[stem]), self._unit_mm),
            color_encoded=read_bounded(color) if color else None,
            thermal_c=_celsius(thermal) if thermal else None,
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


def _colors(
    path: Path, depth: dict[str, Path]
) -> tuple[dict[str, Path], dict[str, int], dict[str, Path], str]:
    """Depth files, their stamps in ns, and their colour files, by the depth image's name; a note on time.

    Where there is a list, depth is in the order of its stamps, less what it leaves out. Raises FormatError.
    """
    folder = path / "color" if (path / "color").is_dir() else path / "rgb"
    suffixes = (".jpg", ".jpeg", ".png")
    listed = [path / name for name in ASSOCIATIONS if (path / name).is_file()]
    if listed:
        pairs = read_associations(listed[0])
        images = [image for image, _ in pairs]
    elif (path / "depth.txt").is_file() and (path / "rgb.txt").is_file():
        images = sorted(read_list(path / "depth.txt"))
        pairs = _nearest(images, sorted(read_list(path / "rgb.txt")))
    else:
        return depth, {}, _matching(folder, suffixes, depth), "no time stamps: 30 frames a second assumed"
    stamped = {Path(name).stem: stamp_ns for stamp_ns, name in images}
    wanted = {Path(name).stem: color for (_, name), (_, color) in pairs}
    order = sorted((stem for stem in stamped if stem in depth), key=lambda stem: stamped[stem])
    if not order:
        raise FormatError(f"{path}: no depth image is named in its list; give the folder the list belongs to")
    there = {file.name: file for file in folder.glob("*") if file.suffix.lower() in suffixes}
    color = {stem: there[name] for stem, name in wanted.items() if stem in depth and name in there}
    left_out = len(depth) - len(order)
    rest = f"; {left_out} depth images that it does not name are left out" if left_out else ""
    timing = f"times from {listed[0].name if listed else 'depth.txt'}{rest}"
    return {stem: depth[stem] for stem in order}, stamped, color, timing


def _nearest(depth: list[Image], color: list[Image]) -> list[tuple[Image, Image]]:
    """Depth images with the colour image nearest in time; both sorted."""
    depth_ns, color_ns = (np.array([stamp for stamp, _ in images], np.int64) for images in (depth, color))
    pairs = pair_stamps(depth_ns, color_ns, WINDOW_NS).tolist()
    return [(image, color[at]) for image, at in zip(depth, pairs, strict=True) if at >= 0]


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
    missing = frames - len(files)
    absent = (f"{missing} of {frames} frames have no {name} image",) if missing else ()
    return absent if camera else (*absent, f"no calibration of the {name} camera: its images cannot be fused")


def _calibration(path: Path, first_depth: Path) -> tuple[RigCalibration, float, tuple[str, ...]]:
    """Calibration, millimetres of a depth step, and notes on where they are from."""
    if (path / "calibration.json").is_file():
        return load_calibration(path / "calibration.json"), 1.0, ("calibration from calibration.json",)
    shape = png_shape(read_bounded(first_depth), str(first_depth))
    found, origin = first_intrinsics([path / name for name in INTRINSICS], shape)
    notes, unit_mm = [origin], found.unit_mm
    if unit_mm == 1.0 and is_tum(path):
        notes, unit_mm = [*notes, "depth in 1/5000 m, as in every TUM dataset"], TUM_UNIT_MM
    if not found.aligned:
        return RigCalibration(found.depth), unit_mm, tuple(notes)
    notes.append("colour assumed to be aligned with depth, as Open3D's recorder saves it")
    return RigCalibration(found.depth, found.depth, Pose.identity()), unit_mm, tuple(notes)


def _celsius(file: Path) -> NDArray[np.float32]:
    if file.suffix.lower() == ".png":
        return thermal_from_uint16(_grey16(file))
    return read_flir(read_bounded(file), str(file)).celsius


def _grey16(file: Path) -> NDArray[np.uint16]:
    return decode_grey(read_bounded(file), np.uint16, str(file))
