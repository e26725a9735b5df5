"""Companion file ``annotate-cloud.json``: camera, subjects, statuses and notes beside exported images.

Other tools ignore the file. A folder without the file needs ``intrinsics.json``.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from unicodedata import combining, normalize
from urllib.parse import unquote

from annotate.array_types import Float32, UInt8, UInt16
from annotate.exchange.class_names import id_table, ids_by_name
from annotate.frame_labels import FrameLabels
from annotate.labelset.cast_note import TRAINING, cast_note, cast_of
from annotate.labelset.scheme_note import scheme_in, scheme_note
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import CalibrationError, FormatError, Setting, fault_of
from sensors.files.bounded import read_bounded
from sensors.files.natural_order import paths_in_order
from sensors.rig.camera import Intrinsics

COMPANION = "annotate-cloud.json"
INTRINSICS = "intrinsics.json"
SCHEMA = 1
LONGEST_ID = 100  # letters, as in a label set
MAX_TEXT_BYTES = 1_000_000_000  # largest JSON or XML file of an export; a frame takes up to 10 kB (CVAT)


@dataclass
class Companion:
    """Camera of a folder, and by frame id the fields that its images cannot hold.

    remarks: omissions and assumptions of a reader, with counts. annotations: the one annotation file to read;
    None = the folder's. cast: name of the set of synthetic people. scheme: of the labels. is_ours: whether an
    export states the scheme. theirs: our names of parts by others' plain names.
    """

    intrinsics: Intrinsics
    frames: dict[str, dict[str, Any]] = field(default_factory=dict)
    remarks: Counter[str] = field(default_factory=Counter)
    annotations: Path | None = None
    cast: str = TRAINING
    scheme: Scheme = PAPER
    is_ours: bool = False
    theirs: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def ids_by_name(self) -> dict[str, int]:
        """Return our part ids by the other tool's names. Raises FormatError for a wrong ``theirs``."""
        return ids_by_name(self.scheme, self.theirs)

    def own_ids(self, labels: UInt8, classes: Sequence[str] = ()) -> UInt8:
        """Return label images (any shape) of others in the scheme's ids. classes: others' names by id.

        Raises FormatError for a wrong ``theirs``.
        """
        return id_table(self.scheme, self.theirs, classes)[labels] if self.theirs or classes else labels

    def remark(self, text: str) -> None:
        self.remarks[text] += 1

    def add(self, frame: FrameLabels) -> None:
        """Store a frame's subject, status and notes."""
        self.frames[frame.frame_id] = {
            "subject": frame.subject,
            "status": frame.status,
            "notes": frame.notes,
            "persons": frame.persons is not None,
        }

    def save(self, folder: Path) -> None:
        """Write the companion file, and the camera alone as ``intrinsics.json``."""
        content = {"schema": SCHEMA, **cast_note(self.cast), "intrinsics": asdict(self.intrinsics)}
        content |= scheme_note(self.scheme)
        content["frames"] = self.frames
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
        """Return a frame with its stored subject, status and notes. Raises FormatError where a field or an
        image is malformed.
        """
        fields = self.frames.get(frame_id, {})
        # A persons image of zeros is kept only where the label set had one.
        present = persons is not None and bool(fields.get("persons", persons.any()))
        try:
            kept = persons if present else None
            frame = FrameLabels(frame_id, depth_mm, parts, confidence, persons=kept, scheme=self.scheme)
            known = {name: fields[name] for name in ("subject", "status", "notes") if name in fields}
            return replace(frame, **known)
        except TypeError as error:
            raise FormatError(
                f"{COMPANION}: frame {frame_id[:100]!r} is malformed ({fault_of(error)}); export it again"
            ) from error


def load_companion(folder: Path, intrinsics: Path | None = None) -> Companion:
    """Read the companion file of exported images in a folder; without it, the folder's intrinsics.json.

    intrinsics: file of the camera that is read instead. Raises FormatError, CalibrationError.
    """
    file = folder / COMPANION
    if intrinsics is not None:
        camera = read_intrinsics(intrinsics).depth
        return replace(_stored(file), intrinsics=camera) if file.exists() else Companion(camera)
    if not file.exists():
        if not (folder / INTRINSICS).exists():
            raise CalibrationError(
                f"{folder} has neither {COMPANION} nor {INTRINSICS}; give a file holding "
                '{"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": W, "height": H} of the depth camera',
                Setting.INTRINSICS,
            )
        return Companion(read_intrinsics(folder / INTRINSICS).depth)
    return _stored(file)


def _stored(file: Path) -> Companion:
    try:
        content = json.loads(read_bounded(file, MAX_TEXT_BYTES))
        if content["schema"] != SCHEMA:
            raise FormatError(f"{file} is not of schema {SCHEMA}; export it again")
        frames = content["frames"]
        if not isinstance(frames, dict) or not all(isinstance(entry, dict) for entry in frames.values()):
            raise ValueError("field 'frames' is not an object of objects")
        scheme = scheme_in(content, file)
        camera = Intrinsics(**content["intrinsics"])
        return Companion(camera, frames, cast=cast_of(content), scheme=scheme, is_ours=True)
    except (CalibrationError, ValueError, LookupError, TypeError, RecursionError, OverflowError) as error:
        raise FormatError(f"{file} is corrupt ({fault_of(error)[:80]}); export it again") from error


def frame_files(folder: Path, suffix: str) -> Iterator[tuple[str, Path]]:
    """Yield (frame id, file) of a folder's visible files of a suffix, in natural order.

    Raises FormatError without any.
    """
    found = (file for file in folder.glob(f"*{suffix}") if not file.name.startswith("."))
    files = paths_in_order(file for file in found if file.is_file())
    if not files:
        raise FormatError(f"{folder} holds no *{suffix}; give the folder of an export")
    return ((safe_id(file.name.removesuffix(suffix)), file) for file in files)


def safe_id(stem: str) -> str:
    """Return a name as a valid frame id: "Bän k 1" is "Ban_k_1"."""
    plain = normalize("NFKD", unquote(stem))
    kept = "".join(letter for letter in plain if not combining(letter))
    return re.sub(r"[^A-Za-z0-9_.-]", "_", kept).lstrip(".-")[:LONGEST_ID] or "_"
