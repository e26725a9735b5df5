"""A folder of depth images, with colour and thermal images where there are some, as a source of frames.

Layout, everything but depth optional::

    depth/NAME.png      16-bit depth (or TIFF, PGM, .npy); other layouts: ``folder_files``
    color/NAME.jpg      JPEG or PNG of the same name; or in rgb/
    thermal/NAME.png    16-bit temperatures in the scale of a session (``messages.THERMAL_OFFSET_C``), or in
                        hundredths or tenths of a kelvin (``celsius_check``); or a TIFF, floats in degrees
                        Celsius; or NAME.jpg, a FLIR camera's radiometric JPEG
    associations.txt    pairs of colour and depth images, and their times, where names differ; or depth.txt
                        and rgb.txt (see ``tum_lists``)
    calibration.json    the rig's calibration as ``rig_calibration.save_calibration`` writes it; or
    intrinsics.json     the depth camera's numbers (see ``intrinsics_file``); or one of
                        ``INTRINSICS``

Without calibration.json, colour and thermal images of the depth images' size are aligned with them pixel for
pixel.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.intrinsics_file import FoundIntrinsics, first_intrinsics, read_intrinsics
from sensors.checks.celsius_check import SESSION, judge_celsius
from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.files.flir_jpeg import read_flir
from sensors.files.images import decode_depth, image_shape
from sensors.importers.folder_files import (
    JPEGS,
    STREAMS,
    Files,
    FolderImages,
    find_images,
    matching,
    unread_colors,
)
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.importers.tum_lists import TUM_UNIT_MM, Listed, is_tum, read_lists
from sensors.rig.frame import FrameSource, RigFrame, regular_times_ns
from sensors.rig.rig_calibration import Pose, RigCalibration, load_calibration

TEXTS = ("json", "yaml", "yml", "xml", "txt")
CALIBRATION = "calibration.json"
INTRINSICS = (
    *("intrinsics.json", "intrinsic.json", "camera_intrinsic.json", "camera_intrinsics.json"),
    *(f"{name}.{kind}" for name in ("depth_intrinsics", "intrinsics_depth") for kind in TEXTS),
    *("intrinsic_depth.txt", "intrinsic/intrinsic_depth.txt", "intrinsics/intrinsic_depth.txt"),
    *(f"{name}.{kind}" for name in ("depth_camera_info", "camera_info") for kind in TEXTS),
    *(f"{name}.{kind}" for name in ("intrinsics", "intrinsic", "camera") for kind in TEXTS),
    *("camera-intrinsics.txt", "camera_intrinsics.txt", "K.txt", "cam_K.txt"),
    *("calibration.txt", "calib.txt", "calibration.yaml", "calibration.yml"),
)
"""Files in which programs write the depth camera's numbers; the first that exists is read: ours, Open3D's,
ScanNet's (SensReader/python/SensorData.py), ROS's, 3DMatch's, SUN RGB-D's and ETH3D's."""


class ImageFolder(FrameSource):
    """An image folder as a ``FrameSource``, frames in the natural order of their names, or by their times.

    Opening it reads a few images, which are judged; a frame reads its own images alone. notes: missing and
    assumed data, one sentence each. Raises FormatError without depth images, CalibrationError when the
    intrinsics are missing or contradict the images.
    """

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self.path, self.name = path, path.resolve().name
        images, listed = find_images(path), read_lists(path)
        timed = _by_list(path, images, listed, options) if listed else _by_name(images, options)
        self._depth, self._color, self._thermal = timed.depth, timed.color, timed.thermal
        self._names, self.times_ns = tuple(timed.depth), timed.times_ns
        first = next(iter(timed.depth.values()))
        cameras = _cameras(path, first, timed.color, timed.thermal, options.intrinsics)
        self.calibration = cameras.calibration
        declared_mm = options.depth_unit_mm or cameras.unit_mm
        tum = is_tum(path) and not declared_mm
        likely_mm = TUM_UNIT_MM if listed else None
        samples = _readable(list(timed.depth.values()))
        self._reading = judge_depth(samples, TUM_UNIT_MM if tum else declared_mm, str(path), likely_mm)
        # Photographs of FLIR cameras state their scale.
        words = [file for file in timed.thermal.values() if file.suffix.lower() not in JPEGS]
        where = f"{path}: thermal images"
        self._scale, judged = judge_celsius(_readable(words), where) if words else (SESSION, ())
        self.notes = (
            *cameras.notes,
            *(["depth in 1/5000 m, as in every TUM dataset"] if tum else []),
            *self._reading.notes,
            timed.note,
            *images.notes,
            *self._presence("colour", timed.color),
            *unread_colors(path),
            *self._presence("thermal", timed.thermal),
            *judged,
        )

    def _presence(self, name: str, files: Files) -> list[str]:
        camera = self.calibration.color if name == "colour" else self.calibration.thermal
        if not files:
            return [f"no {name} images"]
        missing, frames = len(self._names) - len(files), len(self._names)
        notes = [f"{missing} of {frames} frames have no {name} image"] if missing else []
        fused = [] if camera else [f"no calibration of the {name} camera: its images cannot be fused"]
        return notes + fused

    def _frame(self, index: int) -> RigFrame:
        name = self._names[index]
        thermal, color = self._thermal.get(name), self._color.get(name)
        return RigFrame(
            index=index,
            stamp_ns=int(self.times_ns[index]),
            depth_mm=self._reading.to_mm(_stored_image(self._depth[name])),
            color_encoded=read_bounded(color) if color else None,
            thermal_c=self._celsius(thermal) if thermal else None,
        )

    def _celsius(self, file: Path) -> NDArray[np.float32]:
        if file.suffix.lower() in JPEGS:
            return read_flir(read_bounded(file), str(file)).celsius
        return self._scale.celsius(_stored_image(file))


class _Timed(NamedTuple):
    """Images sorted by time, their times int64 (n,) in ns, and a note on the times."""

    depth: Files
    color: Files
    thermal: Files
    times_ns: NDArray[np.int64]
    note: str


def _by_name(images: FolderImages, options: ImportOptions) -> _Timed:
    depth, stamps = images.depth, images.stamps_ns
    others = matching(images.color, depth), matching(images.thermal, depth)
    if stamps and not options.rate_hz:
        names = sorted(depth, key=stamps.__getitem__)
        times, note = np.array([stamps[name] for name in names], np.int64), "times from the images' names"
        return _Timed({name: depth[name] for name in names}, *others, times, note)
    note = f"no time stamps: {options.rate}, in the natural order of names"
    return _Timed(depth, *others, regular_times_ns(len(depth), options.period_ns), note)


def _by_list(path: Path, images: FolderImages, listed: Listed, options: ImportOptions) -> _Timed:
    """Order a folder's images by its lists; images that the lists omit are left out. Raises FormatError."""
    names = {file.stem: name for name, file in images.depth.items()}
    there = {file.name: file for file in images.color.values()}
    depth, color, stamps = {}, {}, []
    for (stamp_ns, wanted), its_color in listed.depth:
        name = names.get(Path(wanted).stem)
        if name is None or name in depth:
            continue
        depth[name] = images.depth[name]
        stamps.append(stamp_ns // 1_000_000_000 * options.period_ns if listed.counted else stamp_ns)
        if its_color in there:
            color[name] = there[its_color]
    if not depth:
        raise FormatError(
            f"{path}: {listed.file} names none of its depth images; give the folder that {listed.file} lists"
        )
    left_out = len(images.depth) - len(depth)
    rest = f"; {left_out} depth images that it does not name are left out" if left_out else ""
    counted = f"{listed.file} has numbers, not times: {options.rate}"
    note = (counted if listed.counted else f"times from {listed.file}") + rest
    return _Timed(depth, color, matching(images.thermal, depth), np.array(stamps, np.int64), note)


def _readable(files: list[Path]) -> list[NDArray[Any]]:
    """Read a few images, evenly spread over the files. Raises FormatError where none can be read."""
    images, error = [], None
    for at in spread(len(files)):
        try:
            images.append(_stored_image(files[at]))
        except FormatError as found:
            error = error or found
    if error is not None and not images:
        raise error
    return images


def _stored_image(file: Path) -> NDArray[Any]:
    """Read the pixels (h, w) of a depth or thermal image as they are stored."""
    return decode_depth(read_bounded(file), str(file))


class _Cameras(NamedTuple):
    """Calibration; millimetres of a depth step if a file states it; notes on their origin."""

    calibration: RigCalibration
    unit_mm: float | None
    notes: tuple[str, ...]


def _cameras(path: Path, first: Path, color: Files, thermal: Files, declared: Path | None) -> _Cameras:
    """Return the calibration of a folder's depth, colour and thermal cameras.

    It is read from ``declared``, a file of intrinsics; without one, from the calibration or intrinsics files
    in the folder ``path``. first: a depth image. color, thermal: image files. Raises CalibrationError where
    files are missing or malformed.
    """
    shape = image_shape(read_bounded(first), str(first))
    files = [path / name for name in INTRINSICS]
    if declared is not None:
        found, origin = read_intrinsics(declared, shape), f"intrinsics from {declared.name}"
    elif (path / CALIBRATION).exists():
        stated = any(file.exists() for file in files)
        unit_mm = first_intrinsics(files, shape)[0].unit_mm if stated else None
        return _Cameras(load_calibration(path / CALIBRATION), unit_mm, (f"calibration from {CALIBRATION}",))
    else:
        found, origin = first_intrinsics(files, shape)
    calibration = RigCalibration(found.depth)
    notes, fits = _aligned("colour", color, found)
    if fits:
        calibration = replace(calibration, color=found.depth, color_from_depth=Pose.identity())
    more, fits = _aligned("thermal", thermal, found)
    if fits:
        calibration = replace(calibration, thermal=found.depth, thermal_from_depth=Pose.identity())
    return _Cameras(calibration, found.unit_mm, (origin, *notes, *more))


def _aligned(name: str, images: Files, found: FoundIntrinsics) -> tuple[list[str], bool]:
    """Return a note on the images, and True if they are aligned with depth.

    Images of the size of depth images count as aligned.
    """
    if name == "colour" and found.aligned:
        return [f"{name} assumed to be aligned with depth, as Open3D's recorder saves it"], True
    shape = _shape_of(list(images.values()))
    if shape is None:
        return [], False
    size, depth = (f"{width}x{height}" for height, width in (shape, found.depth.shape))
    if size == depth:
        note = f"{name} assumed to be aligned with depth pixel for pixel: of its size, no {CALIBRATION}"
        return [note], True
    remedy = f"register them to depth, or add {CALIBRATION}"
    return [f"{name} images are {size}, depth is {depth}: not used; {remedy}"], False


def _shape_of(files: list[Path]) -> tuple[int, int] | None:
    """Return (h, w) of the first readable image of a few; None without one, so that reading a frame reports
    the cause.
    """
    for at in spread(len(files)):
        try:
            data, name = read_bounded(files[at]), str(files[at])
            folder, suffix = files[at].parent.name.lower(), files[at].suffix.lower()
            flir = folder in STREAMS["thermal"] and suffix in JPEGS
            height, width = read_flir(data, name).celsius.shape if flir else image_shape(data, name)
        except FormatError:
            continue
        return height, width
    return None
