"""Distributions of figures of people, in a dataset, a label set or a recording of any kind."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from annotate.array_types import Bool, Float64, UInt16
from annotate.cloud.fuse import Fuser
from annotate.crop import SIZE, crop_around, crop_from_note, person_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.store import MANIFEST, LabelSet
from annotate.person.extract import Survey
from sensors.errors import CloudError, FormatError
from sensors.importers.open_source import Source, open_source
from synth.body.skeleton import N_JOINTS
from synth.images.figures import LEVELS, height_px, holes, roughness, widths
from synth.images.stance import ankles_m, arms_deg, facing_deg

FRAMES = 500
"""Frames of a recording that are measured at most, evenly spread."""
CUT_OUT_SHARE, CUT_OUT_BORDER = 0.5, 0.25
"""A depth image shows a person cut out where a smaller share of its pixels has depth, and of those along its
left, top and right. Chosen by eye: a room fills most of both."""

T = TypeVar("T")
Figures = dict[str, Float64]
"""Figures by name, (k,) of one person or (n, k) of n; NaN where unknown."""


@dataclass(frozen=True)
class Distributions:
    """Figures of the people of some frames.

    frames: with a person. figures: (frames, k) by name: holes and roughness of the silhouette (``figures``),
    height_px, widths (k = 12); where joints are known, ankles_m, arms_deg (k = 2), facing_deg (``stance``);
    where a dataset's notes have them, bmi, height_cm.
    """

    name: str
    frames: int
    figures: Figures

    @staticmethod
    def of(name: str, persons: Iterable[Figures | None]) -> "Distributions":
        """Those of the figures of single persons. Raises CloudError without any."""
        rows = [figures for figures in persons if figures is not None]
        if not rows:
            raise CloudError(f"{name} shows no person; give a recording of people")
        return Distributions(name, len(rows), {key: np.stack([row[key] for row in rows]) for key in rows[0]})


def figures_of(person: Bool, joints_mm: Float64 | None = None) -> Figures | None:
    """Figures of a person in an image; None of one that is too small to be measured.

    person: (h, w), pixels with depth. joints_mm: (J, 3), camera frame. The silhouette is that of the crop
    which networks see, so that images of any size compare; height_px counts rows of the image itself.
    height_px and widths are unknown of who is cut by the image's border.
    """
    if not person.any():
        return None
    whole = not (person[[0, -1]].any() or person[:, [0, -1]].any())
    return _figures(crop_around(person).cut(person, False), height_px(person), whole, joints_mm, {})


def figures_of_labels(frame: FrameLabels) -> Figures | None:
    """Figures of a frame's labelled person, its joints and build those of the notes. See ``figures_of``.

    Raises FormatError for malformed notes.
    """
    person, joints = person_of(frame.parts) & (frame.depth_mm > 0), _joints(frame)
    if person.shape != (SIZE, SIZE) or "crop" not in frame.notes:
        return figures_of(person, joints)
    rows = height_px(person) * crop_from_note(frame.notes["crop"], "crop").side / SIZE
    whole = frame.notes.get("beyond", 0) == 0
    return _figures(person, rows, whole, joints, frame.notes.get("body", {}))


def _figures(
    crop: Bool, rows: float, whole: bool, joints_mm: Float64 | None, body: dict[str, float]
) -> Figures | None:
    if height_px(crop) < LEVELS:
        return None
    joints = np.full((N_JOINTS, 3), np.nan) if joints_mm is None else joints_mm
    single = {
        "holes": holes(crop),
        "roughness": roughness(crop),
        "height_px": rows if whole else np.nan,
        "ankles_m": ankles_m(joints),
        "facing_deg": facing_deg(joints),
        **{name: body.get(name, np.nan) for name in ("height_cm", "bmi")},
    }
    known = 1.0 if whole else np.nan
    several = {"widths": known * widths(crop), "arms_deg": arms_deg(joints)}
    return {name: np.array([value], np.float64) for name, value in single.items()} | several


def _joints(frame: FrameLabels) -> Float64 | None:
    if "joints_mm" not in frame.notes:
        return None
    try:
        joints = np.array(frame.notes["joints_mm"], np.float64)
    except (TypeError, ValueError):
        joints = np.empty(0)
    if joints.shape != (N_JOINTS, 3):
        raise FormatError(
            f"frame {frame.frame_id}: its note 'joints_mm' is malformed; give {N_JOINTS} joints (x, y, z)"
        )
    return joints


def distributions_at(path: Path) -> Distributions:
    """Distributions of a recording of any kind, or of a label set.

    Raises CloudError where nobody is found, FormatError where nothing can be read.
    """
    name = path.resolve().name
    if (path / MANIFEST).is_file():
        labels = LabelSet.open(path)
        ids = _spread(labels.frame_ids, len(labels))
        return Distributions.of(name, (figures_of_labels(labels.read(i)) for i in ids))
    return Distributions.of(name, map(figures_of, _persons(open_source(path))))


def _spread(frames: Iterable[T], count: int) -> Iterator[T]:
    """``FRAMES`` of the frames at most, evenly spread."""
    return islice(frames, 0, None, max(1, -(-count // FRAMES)))


def _persons(source: Source) -> Iterator[Bool]:
    """Masks (h, w) of the person in frames of a source: its depth where that is cut out, else as found."""
    fuser = Fuser(source.calibration)
    for frame in _spread(source, len(source)):
        depth_mm = fuser.fuse(frame.depth_mm).depth_mm
        # Every frame for itself: frames that lie apart tell nothing about each other's persons.
        yield depth_mm > 0 if cut_out(depth_mm) else Survey(fuser.fuse_frame(frame)).person().mask


def cut_out(depth_mm: UInt16) -> bool:
    """Whether the depth image (h, w) shows a person alone, as trackers cut one out of the room."""
    seen = depth_mm > 0
    border = np.concatenate([seen[0], seen[:, 0], seen[:, -1]])
    return bool(seen.mean() < CUT_OUT_SHARE and border.mean() < CUT_OUT_BORDER)
