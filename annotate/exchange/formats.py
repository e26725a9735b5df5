"""All formats of label sets, what each carries, and the two ways through them: export and import."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from annotate.exchange.coco import is_coco, read_coco, write_coco
from annotate.exchange.companion import COMPANION, Companion
from annotate.exchange.cvat import is_cvat, read_cvat, write_cvat
from annotate.exchange.image_pairs import MMSEG, PAPER, Folders, is_pairs, read_pairs, write_pairs
from annotate.exchange.labelled_cloud import PCD, PLY, CloudFile, is_clouds, read_clouds, write_clouds
from annotate.exchange.parquet import is_parquet, read_parquet, write_parquet
from annotate.exchange.semantic_kitti import is_kitti, read_kitti, write_kitti
from annotate.frame_labels import FrameLabels
from annotate.labelset.appearing import appearing
from annotate.labelset.store import MANIFEST, LabelSet
from sensors.errors import FormatError

Writer = Callable[[Iterator[FrameLabels], Companion, Path], None]
Reader = Callable[[Path], tuple[Companion, Iterator[FrameLabels]]]


@dataclass(frozen=True)
class Format:
    """One format. lacks: what of a label set it cannot carry; the rest comes back to the bit.

    write: fills an empty folder and adds every frame to the companion. read: reads frames one by one.
    """

    write: Writer
    read: Reader
    recognise: Callable[[Path], bool]
    lacks: tuple[str, ...]


def _pairs(folders: Folders) -> Format:
    lacks = ("persons", "confidence")
    return Format(
        partial(write_pairs, folders), partial(read_pairs, folders), partial(is_pairs, folders), lacks
    )


def _clouds(kind: CloudFile) -> Format:
    return Format(partial(write_clouds, kind), partial(read_clouds, kind), partial(is_clouds, kind), ())


FORMATS = {
    "pairs": _pairs(PAPER),
    "mmseg": _pairs(MMSEG),
    "coco": Format(write_coco, read_coco, is_coco, ("confidence",)),
    "cvat": Format(write_cvat, read_cvat, is_cvat, ("confidence",)),
    "pcd": _clouds(PCD),
    "ply": _clouds(PLY),
    "semantic-kitti": Format(write_kitti, read_kitti, is_kitti, ("confidence",)),
    "parquet": Format(write_parquet, read_parquet, is_parquet, ()),
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
    chosen, had = FORMATS[name], set[str]()

    def frames() -> Iterator[FrameLabels]:
        for frame in labels:
            had.update(field for field in ("persons", "confidence") if getattr(frame, field) is not None)
            yield frame
            advance(1)

    with appearing(out, COMPANION, labels.path, overwrite=overwrite) as folder:
        companion = Companion(labels.intrinsics)
        chosen.write(frames(), companion, folder)
        companion.save(folder)
    return tuple(field for field in chosen.lacks if field in had)


def recognise(source: Path) -> str | None:
    """The name of the format that a folder is of, or None."""
    if not source.is_dir():
        return None
    return next((name for name, format_ in FORMATS.items() if format_.recognise(source)), None)


def import_labels(
    source: Path, out: Path, advance: Callable[[int], None], *, overwrite: bool = False
) -> tuple[LabelSet, str]:
    """Read another tool's folder into a new label set; returns it and the format's name.

    ``out`` appears when it is whole. Raises FormatError, CalibrationError, ExistsError.
    """
    name = recognise(source)
    if name is None:
        raise FormatError(
            f"{source} holds labels in no known format; give a folder of {', '.join(FORMATS)}, or name the "
            "result .mcap to import images"
        )
    companion, frames = FORMATS[name].read(source)
    info = {"source": source.resolve().name, "steps": {"import": {"format": name}}}
    with appearing(out, MANIFEST, source, overwrite=overwrite) as folder:
        labels = LabelSet.create(folder, companion.intrinsics, info)
        for frame in frames:
            if frame.frame_id in labels:
                raise FormatError(f"{source} has two frames called {frame.frame_id[:100]!r}; rename one")
            labels.write(frame)
            advance(1)
        if not len(labels):
            raise FormatError(f"{source} holds no frames; export it again")
    return LabelSet.open(out), name
