"""All formats of label sets, what each carries, and the two ways through them: export and import."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from annotate.exchange import cvat
from annotate.exchange.coco import annotation_files, read_coco, write_coco
from annotate.exchange.companion import COMPANION, Companion, load_companion
from annotate.exchange.cvat import read_cvat, write_cvat
from annotate.exchange.image_pairs import MMSEG, PAPER, Folders, read_pairs, write_pairs
from annotate.exchange.labelled_cloud import PCD, PLY, CloudFile, read_clouds, write_clouds
from annotate.exchange.parquet import camera_of_parquet, is_parquet, read_parquet, write_parquet
from annotate.exchange.semantic_kitti import LABELS, SEQUENCE, read_kitti, write_kitti
from annotate.exchange.unpacked import unpacked
from annotate.frame_labels import FrameLabels
from annotate.labelset.atomic_folder import appearing
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.parts import BACKGROUND, BODY_PARTS
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics

Writer = Callable[[Iterator[FrameLabels], Intrinsics, Path], None]
Reader = Callable[[Path, Companion], Iterator[FrameLabels]]


@dataclass(frozen=True)
class Format:
    """One format. lacks: what it cannot carry of a label set; the rest comes back bit for bit.

    write: fills an empty folder with frames of one camera. read: frames one by one. companion: of a folder.
    """

    write: Writer
    read: Reader
    recognise: Callable[[Path], bool]
    lacks: tuple[str, ...]
    companion: Callable[[Path, Path | None], Companion] = load_companion


def _holds(*patterns: str) -> Callable[[Path], bool]:
    """Whether a folder holds something by every one of these glob patterns."""
    return lambda source: all(any(source.glob(pattern)) for pattern in patterns)


def _pairs(folders: Folders) -> Format:
    write, read = partial(write_pairs, folders), partial(read_pairs, folders)
    return Format(write, read, _holds(*folders), ("persons", "confidence"))


def _clouds(kind: CloudFile) -> Format:
    return Format(partial(write_clouds, kind), partial(read_clouds, kind), _holds(f"*{kind.suffix}"), ())


FORMATS = {
    "pairs": _pairs(PAPER),
    "mmseg": _pairs(MMSEG),
    "coco": Format(write_coco, read_coco, lambda source: bool(annotation_files(source)), ("confidence",)),
    "cvat": Format(write_cvat, read_cvat, _holds(cvat.ANNOTATIONS), ("confidence",)),
    "pcd": _clouds(PCD),
    "ply": _clouds(PLY),
    "semantic-kitti": Format(write_kitti, read_kitti, _holds(f"{SEQUENCE}/{LABELS}"), ("confidence",)),
    "parquet": Format(write_parquet, read_parquet, is_parquet, (), camera_of_parquet),
}
"""By the name for ``export --format``. None carries the journal of corrections or the labels before them."""


def export_labels(
    labels: LabelSet, out: Path, name: str, advance: Callable[[int], None], *, overwrite: bool = False
) -> tuple[str, ...]:
    """Write a label set as another tool's folder; returns what of it the format cannot carry.

    ``out`` appears when it is whole. Raises FormatError for an unknown format, an empty or a corrupt label
    set, ExistsError where ``out`` is there and was not made by an export, or ``overwrite`` is False.
    """
    if name not in FORMATS:
        raise FormatError(f"format {name[:40]!r} is unknown; use {', '.join(FORMATS)}")
    if not len(labels):
        raise FormatError(f"{labels.path} holds no frames; label some first")
    chosen, had, companion = FORMATS[name], set[str](), Companion(labels.intrinsics)

    def frames() -> Iterator[FrameLabels]:
        for frame in labels:
            had.update(field for field in ("persons", "confidence") if getattr(frame, field) is not None)
            companion.add(frame)
            yield frame
            advance(1)

    with appearing(out, COMPANION, labels.path, overwrite=overwrite) as folder:
        chosen.write(frames(), labels.intrinsics, folder)
        companion.save(folder)
    return tuple(field for field in chosen.lacks if field in had)


def recognise(source: Path) -> str | None:
    """The name of the format that a folder is of, or None."""
    if not source.is_dir():
        return None
    return next((name for name, format_ in FORMATS.items() if format_.recognise(source)), None)


def _by_annotations(file: Path | None) -> str | None:
    """Return the format of an annotation file that was given by itself, whatever its name."""
    return None if file is None else {".json": "coco", ".xml": "cvat"}[file.suffix.lower()]


class Imported(NamedTuple):
    """A new label set, the name of its format, and remarks on omissions and assumptions."""

    labels: LabelSet
    format: str
    remarks: tuple[str, ...]


def import_labels(
    source: Path,
    out: Path,
    advance: Callable[[int], None],
    *,
    overwrite: bool = False,
    intrinsics: Path | None = None,
) -> Imported:
    """Read another tool's folder, archive (.zip) or annotation file into a new label set.

    ``out`` appears when it is whole. intrinsics: the depth camera's, in JSON; None = the folder's. Raises
    FormatError, also where no frame has a body part, CalibrationError, ExistsError.
    """
    with unpacked(source) as (folder, annotations):
        name = _by_annotations(annotations) or recognise(folder)
        if name is None and (folder / MANIFEST).is_file():
            raise FormatError(f"{source} is a label set already; copy its folder, or export it")
        if name is None:
            raise FormatError(
                f"{source} holds labels in no known format; give a folder or archive of "
                f"{', '.join(FORMATS)}, or name the result .mcap to import images"
            )
        companion = FORMATS[name].companion(folder, intrinsics)
        companion.annotations = annotations
        info = {"source": source.resolve().name, "steps": {"import": {"format": name}}}
        with appearing(out, MANIFEST, source, overwrite=overwrite) as made:
            labels = LabelSet.create(made, companion.intrinsics, info)
            named = False
            for frame in FORMATS[name].read(folder, companion):
                if frame.frame_id in labels:
                    raise FormatError(f"{source} has two frames called {frame.frame_id[:100]!r}; rename one")
                labels.write(frame)
                named |= bool((frame.parts != BACKGROUND).any())
                advance(1)
            _check_named(source, labels, named or (folder / COMPANION).is_file())
    return Imported(LabelSet.open(out), name, _texts(companion))


def _check_named(source: Path, labels: LabelSet, named: bool) -> None:
    """Raise FormatError for an import without frames, or whose every pixel is background."""
    if not len(labels):
        raise FormatError(f"{source} holds no frames; export it again")
    if not named:
        raise FormatError(
            f"{source} labels no body part in {len(labels)} frames; give the labels the names of parts: "
            f"{', '.join(part.name for part in BODY_PARTS)}"
        )


def _texts(companion: Companion) -> tuple[str, ...]:
    return tuple(f"{text} ({count})" for text, count in companion.remarks.items())
