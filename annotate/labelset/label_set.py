"""Label set: a folder of labelled depth images in common image formats, with atomic writes."""

import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, UInt8
from annotate.frame_labels import FrameLabels, Status
from annotate.labelset import images
from annotate.labelset.dataset import Entry
from annotate.labelset.images import Probabilities
from annotate.labelset.journal import Journal
from annotate.labelset.json_object import encode_object, read_object
from annotate.labelset.scheme_note import check_scheme, scheme_in
from sensors.errors import CalibrationError, CloudError, ExistsError, FormatError, Setting, fault_of
from sensors.files.atomic import is_taken, write_bytes
from sensors.files.natural_order import in_order, paths_in_order
from sensors.files.own_files import own_file
from sensors.rig.camera import Intrinsics
from sensors.versions import versions

SCHEMA = 1
MANIFEST = "labelset.json"
TOOLS = ("annotate-cloud", "numpy", "opencv-contrib-python-headless", "onnxruntime")
FRAMES, ORIGINAL = "frames", "original"
LEARNT = "learnt"  # folder of each fine-tuning step's confidences; note of a frame's step
PROBABILITY = "probability.png"
RECORDING = "recording"  # manifest entry of the recording's name and size; the name may change
_STEP = re.compile(r"[0-9]{4,9}")
_FRAME_ID = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")

T = TypeVar("T", bound=np.generic)
V = TypeVar("V")
Decode = Callable[[bytes], NDArray[T]]


class LabelSet:
    """Label set on disk. Every write is atomic; a frame exists once its JSON does.

    intrinsics: undistorted depth camera of all frames. info: manifest, with source, steps and
    ``scheme_note``. scheme: of all frames. Raises FormatError for a malformed scheme.
    """

    def __init__(self, path: Path, intrinsics: Intrinsics, info: dict[str, Any]) -> None:
        self.path, self.intrinsics, self.info = path, intrinsics, info
        self.scheme = scheme_in(info, path / MANIFEST)

    @classmethod
    def create(cls, path: Path, intrinsics: Intrinsics, info: dict[str, Any]) -> Self:
        """Start an empty label set in a new or empty folder. Raises ExistsError otherwise."""
        if is_taken(path):
            raise ExistsError(f"{path} already exists; choose another folder", Setting.OVERWRITE)
        scheme = scheme_in(info, path / MANIFEST)
        (path / FRAMES).mkdir(parents=True, exist_ok=True)
        manifest = {
            "schema": SCHEMA,
            "versions": versions(TOOLS),
            "parts": scheme.part_id,
            "intrinsics": asdict(intrinsics),
            **info,
        }
        write_bytes(path / MANIFEST, encode_object(manifest))
        return cls(path, intrinsics, info)

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a label set. Raises FormatError where its manifest is missing or malformed."""
        path = Path(path)
        if not (path / MANIFEST).exists():
            raise FormatError(_no_label_set(path))
        for name in (FRAMES, ORIGINAL, LEARNT):
            if (path / name).is_symlink():
                raise FormatError(f"{path / name} is a link out of the label set; put a copy of it there")
        manifest = read_object(path / MANIFEST)
        if (held := manifest.pop("schema", None)) != SCHEMA:
            raise FormatError(
                f"{path / MANIFEST} has schema {held!r:.9}, not {SCHEMA}; use the version that wrote it"
            )
        scheme = scheme_in(manifest, path / MANIFEST)
        if manifest.pop("parts", None) != scheme.part_id:
            raise FormatError(
                f"{path / MANIFEST} names other parts than scheme {scheme.name!r}; "
                "restore it from a copy, or label the recording again"
            )
        try:
            intrinsics = Intrinsics(**manifest.pop("intrinsics"))
        except (TypeError, KeyError, CalibrationError) as error:
            raise FormatError(
                f"{path / MANIFEST} has malformed intrinsics ({fault_of(error)}); restore it from a copy"
            ) from error
        manifest.pop("versions", None)
        return cls(path, intrinsics, manifest)

    @classmethod
    def resume(cls, path: Path, intrinsics: Intrinsics, info: dict[str, Any]) -> Self:
        """Continue a label set begun with the same ``info``, or start it. Raises ExistsError otherwise."""
        if not (path / MANIFEST).is_file():
            return cls.create(path, intrinsics, info)
        begun = cls.open(path)
        if _settings(begun.info) != _settings(json.loads(json.dumps(info))) or begun.intrinsics != intrinsics:
            raise ExistsError(
                f"{path} was made from another source or with other settings; choose another folder",
                Setting.OVERWRITE,
            )
        return begun

    @property
    def frame_ids(self) -> list[str]:
        """Return the ids of the finished frames, in natural order."""
        try:
            # scandir, because a glob holds all names of the folder at once.
            with os.scandir(self.path / FRAMES) as files:
                ids = [file.name[:-5] for file in files if file.name.endswith(".json")]
        except FileNotFoundError:
            return []
        return in_order(i for i in ids if _FRAME_ID.fullmatch(i))

    def __len__(self) -> int:
        return len(self.frame_ids)

    def __contains__(self, frame_id: str) -> bool:
        return self._file(frame_id, "json").is_file()

    def __iter__(self) -> Iterator[FrameLabels]:
        return map(self.read, self.frame_ids)

    @property
    def whole_image(self) -> Intrinsics:
        """Return the undistorted camera of the frames, or of the image they were cut from."""
        return self.intrinsics.undistorted()

    @property
    def source(self) -> str:
        return str(self.info.get("source", ""))

    @property
    def identity(self) -> dict[str, str]:
        """Return an empty dict, because corrections change a label set's hash."""
        return {}

    def entries(self) -> Iterator[Entry]:
        """Yield the ``Entry`` of each frame."""
        return map(Entry, self.frame_ids)

    def load(self, entry: Entry, persons: bool = True) -> FrameLabels:
        """Read the frame of an entry."""
        return self.read(entry.frame_id, persons=persons)

    def read(self, frame_id: str, original: bool = False, persons: bool = True) -> FrameLabels:
        """Read one frame, or its labels before the first correction (``original``).

        persons: read the persons' numbers too. Raises FormatError naming the file that is missing or corrupt.
        """
        folder = ORIGINAL if original else FRAMES
        fields = read_object(self._file(frame_id, "json", folder))
        depth = self._image(frame_id, "depth.png", images.decode_depth)
        parts = self._image(frame_id, "parts.png", images.decode_parts, folder)
        confidence = self.confidence(frame_id, _learnt_in(fields.get("notes")))
        whose = self._optional_image(frame_id, "persons.png", images.decode_persons) if persons else None
        try:
            return FrameLabels(
                frame_id, depth, parts, confidence, persons=whose, scheme=self.scheme, **fields
            )
        except TypeError as error:
            raise FormatError(
                f"{self._file(frame_id, 'json')} is malformed ({fault_of(error)}); restore it from a copy"
            ) from error

    def parts(self, frame_id: str) -> UInt8:
        """Read a frame's parts alone, uint8 (h, w). Raises FormatError."""
        return self._image(frame_id, "parts.png", images.decode_parts)

    def confidence(self, frame_id: str, step: str = "") -> Float32 | None:
        """Return the confidence (h, w) of a fine-tuning step's labels ("" = the first labels), or None."""
        if not step:
            return self._optional_image(frame_id, "confidence.png", images.decode_confidence)
        return self._optional_image(frame_id, _of_step(step), images.decode_confidence, LEARNT)

    def write_confidence(self, frame_id: str, step: str, confidence: Float32) -> None:
        """Store the confidence (h, w) of a fine-tuning step's labels."""
        (self.path / LEARNT).mkdir(exist_ok=True)
        write_bytes(self._file(frame_id, _of_step(step), LEARNT), images.encode_confidence(confidence))

    def notes(self, frame_id: str) -> dict[str, Any]:
        """Read a frame's notes alone."""
        notes = read_object(self._file(frame_id, "json")).get("notes", {})
        return notes if isinstance(notes, dict) else {}

    def status(self, frame_id: str, original: bool = False) -> Status:
        """Read a frame's status alone. Raises FormatError."""
        file = self._file(frame_id, "json", ORIGINAL if original else FRAMES)
        if (status := read_object(file).get("status")) not in get_args(Status):
            raise FormatError(f"{file} has the unknown status {str(status)[:20]!r}; restore it from a copy")
        return cast(Status, status)

    def probabilities(self, frame_id: str) -> Probabilities | None:
        """Read a frame's class probabilities, if stored. Raises FormatError."""
        file = self._file(frame_id, PROBABILITY)
        if not file.is_file():
            return None
        notes, n_classes = self.notes(frame_id), self.scheme.n_classes
        decode = partial(images.decode_probabilities, notes=notes, n_classes=n_classes)
        return images.read_image(file, decode)

    def write(self, frame: FrameLabels, probabilities: Probabilities | None = None) -> None:
        """Add or replace one frame, with a network's probabilities if they are to be stored.

        The frame's notes must hold ``probabilities.note()`` then. Raises FormatError for an image size or a
        scheme that is not the set's.
        """
        check_scheme(frame.frame_id, frame.scheme, self.path, self.scheme)
        if frame.depth_mm.shape != self.intrinsics.shape:
            raise FormatError(
                f"frame {frame.frame_id} has shape {frame.depth_mm.shape}, {self.path} has frames of "
                f"{self.intrinsics.shape}; write each camera into its own label set"
            )
        self._put(frame.frame_id, "depth.png", images.encode_png, frame.depth_mm)
        self._put(frame.frame_id, "confidence.png", images.encode_confidence, frame.confidence)
        self._put(frame.frame_id, "persons.png", images.encode_png, frame.persons)
        self._put(frame.frame_id, PROBABILITY, images.encode_probabilities, probabilities)
        self.write_labels(frame)

    def write_labels(self, frame: FrameLabels) -> None:
        """Replace a frame's parts, status, subject and notes; keep its other images.

        Raises FormatError for another scheme than the set's.
        """
        check_scheme(frame.frame_id, frame.scheme, self.path, self.scheme)
        encode = partial(images.encode_parts, scheme=self.scheme)
        self._put(frame.frame_id, "parts.png", encode, frame.parts)
        fields = {"status": frame.status, "subject": frame.subject, "notes": frame.notes}
        self._put(frame.frame_id, "json", encode_object, fields)

    def keep_original(self, frame_id: str) -> None:
        """Copy a frame's parts and JSON to ``original/``, once, before its first correction."""
        if not self.has_original(frame_id):
            (self.path / ORIGINAL).mkdir(exist_ok=True)
            for suffix in ("json", "parts.png"):
                data = self._file(frame_id, suffix).read_bytes()
                write_bytes(self._file(frame_id, suffix, ORIGINAL), data)

    def has_original(self, frame_id: str) -> bool:
        """Return whether a frame's labels before its first correction are stored."""
        return self._file(frame_id, "parts.png", ORIGINAL).is_file()

    def _file(self, frame_id: str, suffix: str, folder: str = FRAMES) -> Path:
        if not _FRAME_ID.fullmatch(frame_id):
            raise FormatError(f"frame id {frame_id!r} is unsafe; use letters, digits, '_', '-' and '.'")
        return self.path / folder / f"{frame_id}.{suffix}"

    def _put(self, frame_id: str, suffix: str, encode: Callable[[V], bytes], value: V | None) -> None:
        """Write one file of a frame; remove an earlier one if ``value`` is None."""
        if value is None:
            self._file(frame_id, suffix).unlink(missing_ok=True)
        else:
            write_bytes(self._file(frame_id, suffix), encode(value))

    def _optional_image(
        self, frame_id: str, suffix: str, decode: Decode[T], folder: str = FRAMES
    ) -> NDArray[T] | None:
        there = self._file(frame_id, suffix, folder).is_file()
        return self._image(frame_id, suffix, decode, folder) if there else None

    def _image(self, frame_id: str, suffix: str, decode: Decode[T], folder: str = FRAMES) -> NDArray[T]:
        file = self._file(frame_id, suffix, folder)
        image = images.read_image(file, decode)
        if image.shape != self.intrinsics.shape:
            raise FormatError(
                f"{file} has shape {image.shape}, its label set {self.intrinsics.shape}; restore it from "
                "a copy"
            )
        return image


def as_read(frame: FrameLabels) -> FrameLabels:
    """Return a frame's labels as they are read after writing, e.g. with rounded confidence."""
    confidence = None if frame.confidence is None else images.stored_confidence(frame.confidence)
    return replace(frame, confidence=confidence, notes=json.loads(json.dumps(frame.notes)))


def validate(labels: LabelSet) -> list[str]:
    """Return every problem of a label set, one line each."""
    problems = []
    for frame_id in labels.frame_ids:
        try:
            frame = labels.read(frame_id)
            labels.probabilities(frame_id)
        except CloudError as error:
            problems.append(str(error))
            continue
        on_nothing = int((frame.scheme.on_part(frame.parts) & (frame.depth_mm == 0)).sum())
        if on_nothing:
            problems.append(f"frame {frame_id}: {on_nothing} pixels carry a part without depth")
    if not labels.frame_ids:
        problems.append(f"{labels.path} holds no frames")
    return problems + journal_problems(labels)


def journal_problems(labels: LabelSet) -> list[str]:
    """Return problems of the journal: unreadable, or strokes that the labels lack."""
    try:
        journal = Journal.of(labels.path, labels.scheme)
        behind = [
            i
            for i in journal.frame_ids
            if i in labels and labels.notes(i).get("journal", 0) != len(journal.strokes(i))
        ]
    except CloudError as error:
        return [str(error)]
    return [f"frame {i}: labels lack strokes of {journal.path}; open the set once with fix" for i in behind]


def _settings(info: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest entries that determine the labels."""
    return {key: value for key, value in info.items() if key != RECORDING}


def _learnt_in(notes: object) -> str:
    """Return the fine-tuning step that a frame's notes name, or ""."""
    return str(notes.get(LEARNT) or "") if isinstance(notes, dict) else ""


def _of_step(step: object) -> str:
    """Return the file name of a fine-tuning step's confidence. Raises FormatError for an invalid name."""
    if not isinstance(step, str) or not _STEP.fullmatch(step):
        raise FormatError(
            f"{str(step)[:40]!r} is not a name of a fine-tuning step; restore the frame from a copy"
        )
    return f"{step}.confidence.png"


def _no_label_set(path: Path) -> str:
    """Return the reason and the remedy for a path without a label set."""
    if not path.exists():
        return f"{path} does not exist; check its name"
    if inside := paths_in_order(manifest.parent for manifest in path.glob(f"*/{MANIFEST}")):
        return f"{path} is a folder of label sets ({len(inside)} in all); give one, e.g. {inside[0]}"
    if own := own_file(path):
        return f"{path} {own.instead_of('a label set')}"
    return f"{path} is not a label set (it has no {MANIFEST}); give one that label wrote"
