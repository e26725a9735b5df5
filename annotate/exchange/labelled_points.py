"""Labels for the points of the cloud file that was labelled, in the file's order and coordinates.

A cloud is labelled as a depth image. The field ``label`` of a point is the part of the pixel that shows it,
or UNDEFINED for hidden points. All other fields are copied.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import UInt8, UInt16
from annotate.exchange.companion import COMPANION, Companion
from annotate.exchange.labelled_cloud import PCD, PLY, CloudFile
from annotate.labelset.atomic_folder import appearing
from annotate.labelset.cast_note import cast_of
from annotate.labelset.label_set import LabelSet
from annotate.scheme.scheme import UNDEFINED
from sensors.errors import FormatError
from sensors.importers.clouds import cloud_source as pointcloud
from sensors.importers.clouds.axes import AXES
from sensors.importers.clouds.camera_place import STEPS_MM
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.turn import Turn

CLOUD_FORMATS = {"pcd": PCD, "ply": PLY}


class PointLabels(NamedTuple):
    """Result of an export. points: number of points of the cloud; labelled: number of visible ones."""

    points: int
    labelled: int


def export_points(
    labels: LabelSet, path: Path, name: str, out: Path, *, overwrite: bool = False
) -> PointLabels:
    """Write the points of the cloud at ``path`` with their labels into ``out``, a file per frame.

    name: format. ``out`` appears only when complete. Raises FormatError for labels of another cloud,
    ExistsError.
    """
    kind, companion, frames = CLOUD_FORMATS[name], Companion(labels.intrinsics), list(labels)
    companion.cast, companion.scheme = cast_of(labels.info), labels.scheme
    if not frames:
        raise FormatError(f"{labels.path} holds no frames; label the cloud first")
    cloud, turn = _as_labelled(path, frames[0].depth_mm)
    for frame in frames:
        if not np.array_equal(frame.depth_mm, frames[0].depth_mm):
            raise FormatError(
                f"{labels.path} shows several depth images, but {path} is one cloud; give that cloud's labels"
            )
    shape = cloud.cloud.grid or (1, len(cloud.cloud.records))
    with appearing(out, COMPANION, labels.path, overwrite=overwrite) as folder:
        for frame in frames:
            companion.add(frame)
            parts = _turned_back(frame.parts, turn)
            content = kind.write(_records(cloud, parts, kind), shape, cloud.cloud.viewpoint)
            (folder / f"{frame.frame_id}{kind.suffix}").write_bytes(content)
        companion.save(folder)
    return PointLabels(len(cloud.pixels), int(np.count_nonzero(cloud.pixels >= 0)))


def _as_labelled(path: Path, depth_mm: UInt16) -> tuple[pointcloud.CloudFile, Turn]:
    """Open the cloud with the import options under which it was labelled; return it with the rotation and
    mirroring of its depth image.
    """
    why: FormatError | None = None
    for options in _declarations():
        try:
            cloud = pointcloud.CloudFile(path, options)
        except FormatError as error:
            why = why or error
            continue
        image = cloud.frame(0).depth_mm
        for quarters in range(4):
            turn = Turn(quarters, options.mirror)
            if np.array_equal(turn.image(image), depth_mm):
                return cloud, turn
    raise why or FormatError(
        f"{path} shows another depth image than its labels; give the cloud that was labelled"
    )


def _declarations() -> Iterator[ImportOptions]:
    """Yield common import options of clouds; one of them may have been used for labelling."""
    yield AS_STATED
    yield ImportOptions(mirror=True)
    yield from (ImportOptions(axes=axes) for axes in AXES)
    yield from (ImportOptions(depth_unit_mm=unit) for unit in (*STEPS_MM.values(), 1000.0))


def _turned_back(parts: UInt8, turn: Turn) -> UInt8:
    back = np.rot90(parts, turn.quarters)
    return np.ascontiguousarray(back[:, ::-1] if turn.mirror else back)


def _records(cloud: pointcloud.CloudFile, parts: UInt8, kind: CloudFile) -> NDArray[Any]:
    old, pixels = cloud.cloud.records, cloud.pixels
    names = [name for name in old.dtype.names or () if name != "label"]
    layout: list[Any] = [(name, old.dtype[name]) for name in names]
    records = np.zeros(len(old), [*layout, ("label", kind.label_type)])
    for name in names:
        records[name] = old[name]
    records["label"] = np.where(pixels >= 0, parts.ravel()[pixels], UNDEFINED)
    return records
