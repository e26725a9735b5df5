"""Formats of label sets, with export and import.

To add a format, write a module with a writer and a reader of frames; ``image_pairs`` is the shortest example.
Then add its line to ``FORMATS``, from which commands, tests and the GUI take it. Name it in the help of
``export`` and in ``docs/formats.md``. Each format also stores depth. The file ``annotate-cloud.json`` beside
the format's own files holds the camera, and each frame's subject, status and notes.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from annotate.exchange import cvat
from annotate.exchange.coco import annotation_files, read_coco, write_coco
from annotate.exchange.companion import COMPANION, Companion, load_companion
from annotate.exchange.image_pairs import MMSEG, PAPER, Folders, read_pairs, write_pairs
from annotate.exchange.labelled_cloud import PCD, PLY, CloudFile, read_clouds, write_clouds
from annotate.exchange.parquet import camera_of_parquet, is_parquet, read_parquet, write_parquet
from annotate.exchange.semantic_kitti import LABELS, SEQUENCE, read_kitti, write_kitti
from annotate.exchange.unpacked import unpacked
from annotate.frame_labels import FrameLabels
from annotate.labelset.atomic_folder import appearing, check_outside
from annotate.labelset.cast_note import cast_note, cast_of
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.scheme.scheme import BACKGROUND, Scheme
from sensors.errors import FormatError, Setting


@dataclass(frozen=True)
class Format:
    """Format of label sets.

    title: name in the GUI. write: function that writes frames of one camera and scheme, the companion's, into
    an empty folder.
    read: function that yields the frames of a folder, built by ``companion.labels``.
    recognise: function that returns whether a folder has this format.
    lacks: fields of FrameLabels that the format cannot hold; all others must round-trip bit for bit.
    companion: function that returns camera and notes of a folder; by default from ``annotate-cloud.json``.
    """

    title: str
    write: Callable[[Iterator[FrameLabels], Companion, Path], None]
    read: Callable[[Path, Companion], Iterator[FrameLabels]]
    recognise: Callable[[Path], bool]
    lacks: tuple[str, ...]
    companion: Callable[[Path, Path | None], Companion] = load_companion


def _holds(*patterns: str) -> Callable[[Path], bool]:
    """Return a test for folders with a match of every glob pattern."""
    return lambda source: all(any(source.glob(pattern)) for pattern in patterns)


def _pairs(title: str, folders: Folders) -> Format:
    write, read = partial(write_pairs, folders), partial(read_pairs, folders)
    return Format(title, write, read, _holds(*folders), ("persons", "confidence"))


def _clouds(title: str, kind: CloudFile) -> Format:
    write, read = partial(write_clouds, kind), partial(read_clouds, kind)
    return Format(title, write, read, _holds(f"*{kind.suffix}"), ())


FORMATS = {
    "pairs": _pairs("Image pairs (PNG)", PAPER),
    "mmseg": _pairs("MMSegmentation", MMSEG),
    "coco": Format("COCO", write_coco, read_coco, lambda of: bool(annotation_files(of)), ("confidence",)),
    "cvat": Format("CVAT", cvat.write_cvat, cvat.read_cvat, _holds(cvat.ANNOTATIONS), ("confidence",)),
    "pcd": _clouds("Point clouds (PCD)", PCD),
    "ply": _clouds("Point clouds (PLY)", PLY),
    "semantic-kitti": Format(
        "SemanticKITTI", write_kitti, read_kitti, _holds(f"{SEQUENCE}/{LABELS}"), ("confidence",)
    ),
    "parquet": Format("Parquet", write_parquet, read_parquet, is_parquet, (), camera_of_parquet),
}
"""By the name for ``export --format``. The first that recognises a folder reads it."""


def export_labels(
    labels: LabelSet, out: Path, name: str, advance: Callable[[int], None], *, overwrite: bool = False
) -> tuple[str, ...]:
    """Write a label set in a format; return the names of the fields that are lost.

    ``out`` appears only when complete. advance: called with 1 for each frame. Raises FormatError for an
    unknown format or an invalid label set, ExistsError where ``out`` exists, unless an export made it and
    ``overwrite`` is True.
    """
    if name not in FORMATS:
        raise FormatError(f"format {name[:40]!r} is unknown; use {', '.join(FORMATS)}")
    if not len(labels):
        raise FormatError(f"{labels.path} holds no frames; label some first")
    check_outside(out, labels.path)
    chosen, had, companion = FORMATS[name], set[str](), Companion(labels.intrinsics)
    companion.cast, companion.scheme = cast_of(labels.info), labels.scheme

    def frames() -> Iterator[FrameLabels]:
        for frame in labels:
            had.update(field for field in ("persons", "confidence") if getattr(frame, field) is not None)
            companion.add(frame)
            yield frame
            advance(1)

    with appearing(out, COMPANION, labels.path, overwrite=overwrite) as folder:
        chosen.write(frames(), companion, folder)
        companion.save(folder)
    return tuple(field for field in chosen.lacks if field in had)


def recognise(source: Path) -> str | None:
    """Return the name of a folder's format, or None."""
    if not source.is_dir():
        return None
    return next((name for name, format_ in FORMATS.items() if format_.recognise(source)), None)


@dataclass(frozen=True)
class Declared:
    """Statements of the user about labels of other programs.

    intrinsics: file of the depth camera; None = the folder's. scheme: of the labels; None = the folder's,
    else the paper's. theirs: our names of parts by others' plain names or ids. by_hand: True if a person
    corrected all labels, which no format of other programs states.
    """

    intrinsics: Path | None = None
    scheme: Scheme | None = None
    theirs: Mapping[str, str] = field(default_factory=dict)
    by_hand: bool = False

    @property
    def origin(self) -> dict[str, str]:
        """Return the manifest's entry about the labels' maker; empty without one."""
        return {"labels": "imported by hand"} if self.by_hand else {}

    def stated(self, frame: FrameLabels) -> FrameLabels:
        """Return a frame, as corrected if its labels are automatic and the user states a person's work."""
        return replace(frame, status="corrected") if self.by_hand and frame.status == "auto" else frame


NOTHING_DECLARED = Declared()


class Imported(NamedTuple):
    """New label set, the name of its format, and remarks on omissions and assumptions."""

    labels: LabelSet
    format: str
    remarks: tuple[str, ...]


def import_labels(
    source: Path,
    out: Path,
    advance: Callable[[int], None],
    declared: Declared = NOTHING_DECLARED,
    *,
    overwrite: bool = False,
) -> Imported:
    """Read another tool's folder, archive (.zip) or annotation file into a new label set.

    ``out`` appears only when complete. Raises FormatError, also where no frame has a part and for unknown
    names of parts, CalibrationError, ExistsError.
    """
    with unpacked(source) as (folder, annotations):
        by_suffix = {".json": "coco", ".xml": "cvat"}
        name = by_suffix[annotations.suffix.lower()] if annotations else recognise(folder)
        if name is None and (folder / MANIFEST).is_file():
            raise FormatError(f"{source} is a label set already; copy its folder, or export it")
        if name is None:
            raise FormatError(
                f"{source} holds labels in no known format; give a folder or archive of "
                f"{', '.join(FORMATS)}, or name the result .mcap to import images"
            )
        companion = _companion(source, FORMATS[name].companion(folder, declared.intrinsics), declared)
        companion.annotations = annotations
        info = {"source": source.resolve().name, "steps": {"import": {"format": name, **declared.origin}}}
        info |= cast_note(companion.cast) | scheme_note(companion.scheme)
        with appearing(out, MANIFEST, source, overwrite=overwrite) as made:
            labels = LabelSet.create(made, companion.intrinsics, info)
            has_part = False
            for frame in FORMATS[name].read(folder, companion):
                if frame.frame_id in labels:
                    raise FormatError(f"{source} has two frames called {frame.frame_id[:100]!r}; rename one")
                labels.write(declared.stated(frame))
                has_part |= bool((frame.parts != BACKGROUND).any())
                advance(1)
            _check_parts(source, labels, has_part or (folder / COMPANION).is_file())
    remarks = tuple(f"{text} ({count})" for text, count in companion.remarks.items())
    return Imported(LabelSet.open(out), name, remarks)


def _companion(source: Path, found: Companion, declared: Declared) -> Companion:
    """Return the folder's companion with declared scheme and names. Raises FormatError where both differ."""
    scheme = declared.scheme or found.scheme
    if found.is_ours and scheme != found.scheme:
        raise FormatError(
            f"{source} has scheme {found.scheme.name!r}; leave the scheme out, then convert "
            f"the label set to {scheme.name!r}"
        )
    return replace(found, scheme=scheme, theirs=declared.theirs)


def _check_parts(source: Path, labels: LabelSet, has_part: bool) -> None:
    if not len(labels):
        raise FormatError(f"{source} holds no frames; export it again")
    if not has_part:
        raise FormatError(
            f"none of the {len(labels)} frames of {source} has a body part; name other programs' labels by "
            f"a map or a scheme, or as parts: {', '.join(part.name for part in labels.scheme.parts)}",
            Setting.MAP,
            Setting.SCHEME,
        )
