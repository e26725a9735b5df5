"""Companion file: what image formats cannot hold, as JSON beside them (camera, subjects, statuses, notes).

Every exported folder has ``annotate-cloud.json``, which other tools ignore. A folder without it, written by
another tool, is read too, given ``intrinsics.json``.
"""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from annotate.array_types import Float32, UInt8, UInt16
from annotate.exchange.image_names import safe_id
from annotate.frame_labels import FrameLabels
from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import read_bounded
from sensors.files.natural_order import paths_in_order
from sensors.rig.camera import Intrinsics

COMPANION = "annotate-cloud.json"
INTRINSICS = "intrinsics.json"
SCHEMA = 1
MAX_TEXT_BYTES = 1_000_000_000
"""Largest JSON or XML file of an export that is read, in bytes: a frame takes up to 10 kB (CVAT)."""


@dataclass
class Companion:
    """The camera of a folder, and by frame id what its images lack, in the order of the frames.

    remarks: omissions and assumptions of a reader, each with its number. annotations: the one file of
    annotations to read; None = those of the folder.
    """

    intrinsics: Intrinsics
    frames: dict[str, dict[str, Any]] = field(default_factory=dict)
    remarks: Counter[str] = field(default_factory=Counter)
    annotations: Path | None = None

    def remark(self, text: str) -> None:
        """Count an omission or assumption."""
        self.remarks[text] += 1

    def add(self, frame: FrameLabels) -> None:
        """Note a frame's subject, status and notes."""
        self.frames[frame.frame_id] = {
            "subject": frame.subject,
            "status": frame.status,
            "notes": frame.notes,
            "persons": frame.persons is not None,
        }

    def save(self, folder: Path) -> None:
        """Write the file, and beside it the intrinsics alone, for ``import`` and for people."""
        content = {"schema": SCHEMA, "intrinsics": asdict(self.intrinsics), "frames": self.frames}
        (folder / COMPANION).write_text(json.dumps(content, indent=1) + "\n", encoding="ascii")
        (folder / INTRINSICS).write_text(json.dumps(asdict(self.intrinsics)) + "\n", encoding="ascii")

    def labels(
        self,
        frame_id: str,
        depth_mm: UInt16,
        parts: UInt8,
        persons: UInt8 | None = None,
        confidence: Float32 | None = None,
    ) -> FrameLabels:
        """A frame of these images with its subject, status and notes, as far as known. Raises FormatError."""
        fields = self.frames.get(frame_id, {})
        # A persons image of zeros is kept only where the label set had one.
        present = persons is not None and bool(fields.get("persons", persons.any()))
        try:
            frame = FrameLabels(frame_id, depth_mm, parts, confidence, persons=persons if present else None)
            known = {name: fields[name] for name in ("subject", "status", "notes") if name in fields}
            return replace(frame, **known)
        except TypeError as error:
            raise FormatError(f"{COMPANION}: frame {frame_id[:100]!r} is malformed ({error})") from error


def load_companion(folder: Path, intrinsics: Path | None = None) -> Companion:
    """Read a folder's companion, or intrinsics alone: a file that is given, or the folder's.

    Raises FormatError, CalibrationError.
    """
    file = folder / COMPANION
    if intrinsics is not None:
        return Companion(read_intrinsics(intrinsics).depth)
    if not file.is_file():
        if not (folder / INTRINSICS).is_file():
            raise CalibrationError(
                f"{folder} has neither {COMPANION} nor {INTRINSICS}; give --intrinsics FILE holding "
                '{"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": W, "height": H} of the depth camera'
            )
        return Companion(read_intrinsics(folder / INTRINSICS).depth)
    try:
        content = json.loads(read_bounded(file, MAX_TEXT_BYTES))
        if content["schema"] != SCHEMA:
            raise FormatError(f"{file} is not of schema {SCHEMA}; export it again")
        frames = content["frames"]
        if not isinstance(frames, dict) or not all(isinstance(entry, dict) for entry in frames.values()):
            raise TypeError("frames")
        return Companion(Intrinsics(**content["intrinsics"]), frames)
    except (CalibrationError, ValueError, LookupError, TypeError, RecursionError, OverflowError) as error:
        raise FormatError(f"{file} is corrupt ({str(error)[:80]!r}); export it again") from error


def frame_files(folder: Path, suffix: str) -> Iterator[tuple[str, Path]]:
    """Yield (frame id, file) of a folder's files with this suffix, in natural order, without hidden ones.

    Raises FormatError without any.
    """
    found = (file for file in folder.glob(f"*{suffix}") if not file.name.startswith("."))
    files = paths_in_order(file for file in found if file.is_file())
    if not files:
        raise FormatError(f"{folder} holds no *{suffix}; give the folder of an export")
    return ((safe_id(file.name.removesuffix(suffix)), file) for file in files)
