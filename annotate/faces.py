"""Removal of faces from the colour images of a session, by the heads of its depth labels or by landmarks.

Blurring leaves a few cells of a face. Constants are untuned.
"""

import json
from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.fuse import Fuser
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.scheme.regions import Region
from sensors.errors import CalibrationError, FormatError, Setting
from sensors.files.bounded import read_bounded
from sensors.files.natural_order import in_order
from sensors.rig.camera import project, unproject
from sensors.rig.frame import RigFrame
from sensors.session.reader import Session

CELLS = 4  # across the box of a head; the face is 3 of them wide, too few to recognise anybody
MARGIN = 0.3  # of a head's side, by which its outline grows: hair without depth, motion between two images
MARGIN_OF_PERSON = 0.05  # the same for the outline of a whole person
N_FACE = 11  # landmarks of the face, the first of 33 (Bazarevsky et al., arXiv:2006.10204)
HEAD = 2.0  # side of a head over the widest distance of its landmarks from their mean
QUALITY = 95  # of JPEG
MAX_POSE_BYTES = 1 << 28
FAR_PX = 1e5  # from the image's corner; landmarks farther away are damage


class Outline(NamedTuple):
    """Outline of a head or person in a colour image: points (n, 2), column and row.

    margin: share of its larger side, by which it grows.
    """

    points_px: Float64
    margin: float = MARGIN


class Heads(ABC):
    """Outlines of the heads in the colour image of each frame."""

    @abstractmethod
    def outlines(self, index: int) -> list[Outline]:
        """Return the outlines to blur in a frame; none where no head is known."""


class LabelledHeads(Heads):
    """Heads of a label set, and people whose head is not labelled, seen from the colour camera.

    Raises CalibrationError without the colour camera's calibration, FormatError for labels of another
    recording.
    """

    def __init__(self, labels: LabelSet, session: Session) -> None:
        camera, pose = session.calibration.color, session.calibration.color_from_depth
        if camera is None or pose is None:
            raise CalibrationError(
                f"{session.path} lacks the calibration of its colour camera; give a pose file, or remove the "
                "colour",
                Setting.FACES,
                Setting.COLOUR,
            )
        _check_same(labels, session)
        self._labels, self._camera, self._pose = labels, camera, pose
        self._ids = set(labels.frame_ids)

    def outlines(self, index: int) -> list[Outline]:
        if (frame_id := f"{index:06d}") not in self._ids:
            return []
        frame = self._labels.read(frame_id)
        count, which = cv2.connectedComponents(head_of(frame).astype(np.uint8))
        if count == 1:
            return []
        masks = [(which == n, MARGIN) for n in range(1, count)]
        masks += [(person, MARGIN_OF_PERSON) for person in headless_of(frame)]
        points_m = unproject(self._labels.whole_image, frame.depth_mm.astype(np.float32) / 1000)
        found = [Outline(self._seen_px(points_m[mask]), margin) for mask, margin in masks]
        return [outline for outline in found if len(outline.points_px)]

    def _seen_px(self, points_m: Float32) -> Float64:
        """Return the pixels (n, 2) of the points (m, 3) in front of the colour camera."""
        points_px = project(self._camera, self._pose.apply(points_m))
        return points_px[np.isfinite(points_px).all(axis=1)]


class PosedHeads(Heads):
    """Heads of a pose file (``people.json``: landmarks of each person by image, in the frames' order).

    Raises FormatError for another file, or for another number of images than frames.
    """

    def __init__(self, path: Path, session: Session) -> None:
        self._faces = read_faces(path)
        if len(self._faces) != len(session):
            raise FormatError(
                f"{path} has {len(self._faces)} images, {session.path} has {len(session)} frames; give its "
                "pose file"
            )

    def outlines(self, index: int) -> list[Outline]:
        return [square_about(face) for face in self._faces[index]]


class FaceBlur:
    """Function that returns a colour image without faces (``sensors.session.strip.Blur``).

    An image without a known head is left out, because a face may be in it. Raises FormatError for a broken
    image.
    """

    def __init__(self, session: Session, heads: Heads) -> None:
        self._frames, self._heads = session.frame_of_color, heads

    def __call__(self, stamp_ns: int, encoded: bytes) -> bytes | None:
        index = self._frames.get(stamp_ns)
        outlines = [] if index is None else self._heads.outlines(index)
        if index is None or not outlines:
            return None
        image = RigFrame(index, stamp_ns, np.zeros((1, 1), np.uint16), encoded).decode_color()
        assert image is not None
        for outline in outlines:
            blur(image, outline)
        kind = ".png" if encoded.startswith(b"\x89PN") else ".jpg"
        return cv2.imencode(kind, image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def _check_same(labels: LabelSet, session: Session) -> None:
    """Raise FormatError unless the first labelled frame shows the session's depth image."""
    for index in range(len(session)):
        if (frame_id := f"{index:06d}") in labels:
            depth_mm = Fuser(session.calibration).fuse(session.frame(index).depth_mm).depth_mm
            if np.array_equal(depth_mm, labels.read(frame_id).depth_mm):
                return
            break
    raise FormatError(f"{labels.path} was not made from {session.path}; give labels of this session")


def heads_of(path: Path, session: Session) -> Heads:
    """Return the heads that a label set or a pose file names. Raises as the two classes do."""
    if path.is_dir() or path.name == MANIFEST:
        return LabelledHeads(LabelSet.open(path), session)
    return PosedHeads(path, session)


def read_faces(path: Path) -> list[list[Float64]]:
    """Return the landmarks (n, 2) of each face in each image of a pose file. Raises FormatError."""
    try:
        known = json.loads(read_bounded(path, MAX_POSE_BYTES, "give a pose file"))
        faces = [[np.array(one, np.float64)[:N_FACE, :2] for one in known[name]] for name in in_order(known)]
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError) as error:
        raise FormatError(f"{path} is not a pose file; give people.json or a label set") from error
    for face in (face for image in faces for face in image):
        if face.shape != (N_FACE, 2) or not (np.abs(face) < FAR_PX).all():
            raise FormatError(f"{path} has impossible landmarks; give people.json or a label set")
    return faces


def square_about(face: Float64) -> Outline:
    """Return the square about a face's landmarks (n, 2)."""
    middle = face.mean(axis=0)
    side = HEAD * np.linalg.norm(face - middle, axis=1).max()
    return Outline(middle + side / 2 * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]))


def head_of(frame: FrameLabels) -> Bool:
    """Return the mask (h, w) of the part that holds the head, where there is depth."""
    ids = frame.scheme.ids_of([Region.HEAD])
    return np.isin(frame.parts, ids) & (frame.depth_mm > 0)


def headless_of(frame: FrameLabels) -> list[Bool]:
    """Return the masks (h, w) of the people whose head no label names."""
    if frame.persons is None:
        return []
    persons = np.where(frame.depth_mm > 0, frame.persons, 0)
    named = np.unique(persons[head_of(frame)])
    return [persons == number for number in np.setdiff1d(persons, [0, *named])]


def blur(image: UInt8, outline: Outline) -> None:
    """Replace the inside of an outline in an image (h, w, 3) by a few cells, in place."""
    points_px = outline.points_px
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    margin = outline.margin * min(float((high - low).max()), max(image.shape)) + 1
    left, top = np.maximum(np.floor(low - margin), 0).astype(int)
    right, bottom = np.minimum(np.ceil(high + margin) + 1, image.shape[1::-1]).astype(int)
    if left >= right or top >= bottom:
        return
    box = image[top:bottom, left:right]
    mask = np.zeros(box.shape[:2], np.uint8)
    hull = cv2.convexHull(np.rint(points_px - (left, top)).astype(np.int32))
    cv2.fillConvexPoly(mask, hull, 255)
    size = 2 * round(margin) + 1
    near = cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))) > 0
    cells = cv2.resize(box, (CELLS, CELLS), interpolation=cv2.INTER_AREA)
    smooth = np.asarray(cv2.resize(cells, box.shape[1::-1], interpolation=cv2.INTER_LINEAR))
    box[near] = smooth[near]
