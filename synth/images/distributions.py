"""Distributions of people's statistics in a dataset, a label set or a recording."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from annotate.array_types import Bool, Float64, UInt16
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.crop import SIZE, crop_around, crop_from_note, person_of, window_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.person.extract import PersonDetection
from sensors.errors import CloudError, FormatError
from sensors.importers.open_source import Source, open_source
from synth.body.skeleton import N_JOINTS
from synth.images.silhouette_statistics import LEVELS, height_px, holes, roughness, widths
from synth.images.standing_statistics import ankles_m, arms_deg, facing_deg

FRAMES = 500  # measured frames of a recording at most, evenly spread
CUT_OUT_SHARE, CUT_OUT_BORDER = 0.5, 0.25  # of pixels with depth, below which a person is cut out; untuned
BUILD = ("height_cm", "bmi")
T = TypeVar("T")
Figures = dict[str, Float64]
"""Statistics by name, (k,) of one person or (n, k) of n; NaN where unknown."""


@dataclass(frozen=True)
class Distributions:
    """Statistics of the people of some frames: (frames, k) by name, NaN where unknown.

    From silhouettes: holes, roughness, height_px, widths (k = 12). From joints: ankles_m, arms_deg (k = 2),
    facing_deg. From a dataset's notes: bmi and height_cm.
    """

    name: str
    frames: int
    figures: Figures

    @staticmethod
    def of(name: str, persons: Iterable[Figures | None]) -> "Distributions":
        """Stack the statistics of single persons. Raises CloudError without any."""
        rows = [figures for figures in persons if figures is not None]
        if not rows:
            raise CloudError(f"{name} shows no person; give a recording of people")
        return Distributions(name, len(rows), {key: np.stack([row[key] for row in rows]) for key in rows[0]})


def figures_of(person: Bool, joints_mm: Float64 | None = None) -> Figures | None:
    """Return the statistics of a person in an image; None if the person is too small.

    person: (h, w), pixels with depth. joints_mm: (J, 3), camera frame. Silhouettes are measured in the
    networks' crop, so that images of any size are comparable; height_px counts rows of the image. height_px
    and widths are NaN for a person cut by the image's border.
    """
    if not person.any():
        return None
    whole = not (person[[0, -1]].any() or person[:, [0, -1]].any())
    return _figures(crop_around(person).cut(person, False), height_px(person), whole, joints_mm)


def figures_of_labels(frame: FrameLabels) -> Figures | None:
    """Return ``figures_of`` for a frame's labelled person; joints and build come from its notes.

    Raises FormatError for malformed notes.
    """
    person, notes = person_of(frame.parts) & (frame.depth_mm > 0), frame.notes
    joints = _numbers(frame, "joints_mm", (N_JOINTS, 3)) if "joints_mm" in notes else None
    if person.shape != (SIZE, SIZE) or "crop" not in notes:
        return figures_of(person, joints)
    rows = height_px(person) * crop_from_note(notes["crop"], "crop").side / SIZE
    figures = _figures(person, rows, notes.get("beyond", 0) == 0, joints)
    if figures is not None and "body" in notes:
        figures |= {name: _numbers(frame, "body", (1,), name) for name in BUILD}
    return figures


def _figures(crop: Bool, rows: float, whole: bool, joints_mm: Float64 | None) -> Figures | None:
    crop = crop[window_of(crop)]
    if len(crop) < LEVELS:
        return None
    joints = np.full((N_JOINTS, 3), np.nan) if joints_mm is None else joints_mm
    known = 1.0 if whole else np.nan
    single = {
        "holes": holes(crop),
        "roughness": roughness(crop),
        "height_px": known * rows,
        "ankles_m": ankles_m(joints),
        "facing_deg": facing_deg(joints),
        **dict.fromkeys(BUILD, np.nan),
    }
    several = {"widths": known * widths(crop), "arms_deg": arms_deg(joints)}
    return {name: np.array([value]) for name, value in single.items()} | several


def _numbers(frame: FrameLabels, note: str, shape: tuple[int, ...], key: str | None = None) -> Float64:
    try:
        value = frame.notes[note]
        numbers = np.array(value if key is None else [value[key]], np.float64)
    except (TypeError, ValueError, KeyError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape != shape:
        raise FormatError(f"frame {frame.frame_id}: field notes.{note} is malformed; give {shape} numbers")
    return numbers


def distributions_at(path: Path) -> Distributions:
    """Return the distributions of a recording or a label set.

    Raises CloudError if no person is found, FormatError for an unreadable file.
    """
    name = path.resolve().name
    if (path / MANIFEST).is_file():
        labels = LabelSet.open(path)
        ids = _spread(labels.frame_ids, len(labels))
        return Distributions.of(name, (figures_of_labels(labels.read(i)) for i in ids))
    return Distributions.of(name, map(figures_of, _persons(open_source(path))))


def _spread(frames: Iterable[T], count: int) -> Iterator[T]:
    return islice(frames, 0, None, max(1, -(-count // FRAMES)))


def _persons(source: Source) -> Iterator[Bool]:
    """Yield masks (h, w) of the person: the pixels with depth if the image shows only a person, else the
    person detected in the frame.
    """
    fuser = Fuser(source.calibration)
    for frame in _spread(source, len(source)):
        depth_mm = fuser.fuse(frame.depth_mm).depth_mm
        if cut_out(depth_mm):
            yield depth_mm > 0
        else:
            yield PersonDetection(CoarseCloud.of(fuser.fuse_frame(frame))).person().mask


def cut_out(depth_mm: UInt16) -> bool:
    """Return True if the depth image (h, w) shows a person without a room."""
    seen = depth_mm > 0
    border = np.concatenate([seen[0], seen[:, 0], seen[:, -1]])
    return bool(seen.mean() < CUT_OUT_SHARE and border.mean() < CUT_OUT_BORDER)
