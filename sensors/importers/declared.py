"""Frames of a source with its user's declarations: upright images, unit, camera, times, subject."""

from dataclasses import replace

import cv2
import numpy as np

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.checks.depth_check import UPSIDE_DOWN, judge_depth, spread
from sensors.files.images import JPEG_MAGIC, PNG_MAGIC
from sensors.files.jpeg import encoded_jpeg, mirrored_jpeg
from sensors.importers.options import ImportOptions
from sensors.rig.frame import FrameSource, RigFrame, mm_from_units, regular_times_ns
from sensors.rig.turn import Turn


class Declared(FrameSource):
    """Frames of another source with the declarations of its user. Raises CalibrationError or FormatError
    where intrinsics or unit do not fit.

    own: True if the source itself applies unit and intrinsics of ``options``. Otherwise its depth has steps
    of one millimetre.
    """

    def __init__(self, source: FrameSource, options: ImportOptions, *, own: bool) -> None:
        self._source, self._options, self._own = source, options, own
        self._turn = Turn(options.turn_deg // 90, options.mirror)
        self.name, self.path, self.events = source.name, source.path, source.events
        self.subject, self.cast = options.subject or source.subject, source.cast
        self.times_ns, calibration, notes = source.times_ns, source.calibration, list(source.notes)
        if options.intrinsics is not None and not own:
            found = read_intrinsics(options.intrinsics, calibration.depth.shape)
            found.depth.check_size("depth image", calibration.depth.shape)
            calibration = replace(calibration, depth=found.depth)
            notes.append(f"intrinsics of depth from {options.intrinsics.name}, as declared")
        if options.rate_hz is not None:
            self.times_ns = regular_times_ns(len(source), options.period_ns)
            notes += [] if own else [f"times: {options.rate}"]
        if options.depth_unit_mm is not None and not own:
            samples = [source.frame(at).depth_mm for at in spread(len(source))]
            notes += judge_depth(samples, options.depth_unit_mm, source.name).notes
        self._calibration, self.calibration = calibration, self._turn.whole(calibration)
        if self._turn != Turn():
            notes = [note for note in notes if not note.startswith(UPSIDE_DOWN)]
            mirrored = "mirrored and " if options.mirror else ""
            notes.append(f"images, cameras and poses are {mirrored}turned by {options.turn_deg} degrees")
        self.notes = tuple(notes)

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of the source's file."""
        return self._source.sha256

    def _frame(self, index: int) -> RigFrame:
        frame = self._source.frame(index)
        unit_mm, turn = self._options.depth_unit_mm, self._turn
        depth_mm = frame.depth_mm if self._own or unit_mm is None else mm_from_units(frame.depth_mm, unit_mm)
        thermal, infrared = frame.thermal_c, frame.infrared
        return replace(
            frame,
            stamp_ns=int(self.times_ns[index]),
            depth_mm=turn.image(depth_mm),
            color_encoded=turned_color(frame.color_encoded, turn),
            thermal_c=None if thermal is None else turn.image(thermal),
            infrared=None if infrared is None else turn.image(infrared),
        )


def turned_color(encoded: bytes | None, turn: Turn) -> bytes | None:
    """Return a turned colour image in its own format; bytes of no image are returned unchanged.

    PNGs, and JPEGs that are only mirrored, are turned without loss; another JPEG is encoded again. An EXIF
    orientation is ignored, because calibrations are for the sensor's pixels.
    """
    if encoded is None or turn == Turn():
        return encoded
    if turn == Turn(mirror=True) and encoded.startswith(JPEG_MAGIC):
        return mirrored_jpeg(encoded)
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        return encoded
    upright = turn.image(np.asarray(image, np.uint8))
    if encoded.startswith(PNG_MAGIC):
        return bytes(cv2.imencode(".png", upright)[1])
    return encoded_jpeg(upright)
