"""Input files of the documentation's commands."""

import json
import warnings
from dataclasses import asdict
from pathlib import Path

import c3d
import cv2
import numpy as np

from annotate.cloud.fuse import Fuser
from sensors.session.reader import Session
from synth.motion_files.marker_files import Markers
from tests.helpers.marker_truth import RATE, synthesise


def write_image_folder(folder: Path, session: Session) -> None:
    """Write aligned depth, colour and thermal PNGs of a session's frames, with intrinsics."""
    fuser = Fuser(session.calibration)
    for name in ("depth", "color", "thermal"):
        (folder / name).mkdir(parents=True)
    for frame in session:
        cloud = fuser.fuse_frame(frame)
        kelvin_like = np.nan_to_num((cloud.temperature_c + 100) * 100).astype(np.uint16)
        for name, image in (
            ("depth", cloud.depth_mm),
            ("color", cloud.color_rgb[..., ::-1]),
            ("thermal", kelvin_like),
        ):
            cv2.imwrite(str(folder / name / f"{frame.index:06d}.png"), image)
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    (folder / "intrinsics.json").write_text(json.dumps({k: asdict(cloud.camera)[k] for k in keys}))


def write_trials(folder: Path) -> None:
    """Write ``walk.c3d`` and ``standing.c3d`` of one person in Plug-in-Gait markers."""
    truth = synthesise(3, 40)
    _write_c3d(folder / "walk.c3d", truth.moving)
    _write_c3d(folder / "standing.c3d", truth.static)


def _write_c3d(path: Path, markers: Markers) -> None:
    writer = c3d.Writer(point_rate=RATE, point_scale=-1.0, point_units="mm ")
    for row in markers.positions:
        frame = np.zeros((len(row), 5), np.float32)
        frame[:, :3] = row
        writer.add_frames([(frame, np.zeros((0, 1)))])
    writer.set_point_labels(list(markers.labels))
    with path.open("wb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        writer.write(file)
