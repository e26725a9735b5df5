"""Labels back on the points of the cloud that was labelled: in the file's own order and coordinates.

A cloud is labelled as a depth image. Each of its points gets the part of the pixel that shows it in the field
``label``; UNDEFINED where none does, since it is hidden or out of view. All other fields stay as they are.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.exchange.companion import COMPANION, Companion
from annotate.exchange.labelled_cloud import PCD, PLY, CloudFile
from annotate.frame_labels import FrameLabels
from annotate.labelset.appearing import appearing
from annotate.labelset.store import LabelSet
from annotate.parts import UNDEFINED
from sensors.errors import FormatError
from sensors.importers import pointcloud

KINDS = {"pcd": PCD, "ply": PLY}
"""File formats by name."""


class PointLabels(NamedTuple):
    """What was written. points: of the cloud; labelled: how many of them a pixel shows."""

    points: int
    labelled: int


def export_points(
    labels: LabelSet, cloud: pointcloud.CloudFile, name: str, out: Path, *, overwrite: bool = False
) -> PointLabels:
    """Write the points of ``cloud`` with their labels into the folder ``out``, a file per frame.

    ``out`` appears when it is whole. Raises FormatError for labels of another cloud, ExistsError.
    """
    kind, companion, frames = KINDS[name], Companion(labels.intrinsics), list(labels)
    for frame in frames:
        if not np.array_equal(frame.depth_mm, cloud.frame(0).depth_mm):
            raise FormatError(
                f"{cloud.path} shows another depth image than frame {frame.frame_id[:40]} of {labels.path}; "
                "give the cloud that was labelled, as it was imported"
            )
    if not frames:
        raise FormatError(f"{labels.path} holds no frames; label the cloud first")
    shape = cloud.cloud.grid or (1, len(cloud.cloud.records))
    with appearing(out, COMPANION, labels.path, overwrite=overwrite) as folder:
        for frame in frames:
            companion.add(frame)
            content = kind.write(_records(cloud, frame, kind), shape, cloud.cloud.viewpoint)
            (folder / f"{frame.frame_id}{kind.suffix}").write_bytes(content)
        companion.save(folder)
    return PointLabels(len(cloud.pixels), int(np.count_nonzero(cloud.pixels >= 0)))


def _records(cloud: pointcloud.CloudFile, frame: FrameLabels, kind: CloudFile) -> NDArray[Any]:
    """The cloud's records with the field ``label``."""
    old, pixels = cloud.cloud.records, cloud.pixels
    names = [name for name in old.dtype.names or () if name != "label"]
    layout: list[Any] = [(name, old.dtype[name]) for name in names]
    records = np.zeros(len(old), [*layout, ("label", kind.label_type)])
    for name in names:
        records[name] = old[name]
    records["label"] = np.where(pixels >= 0, frame.parts.ravel()[pixels], UNDEFINED)
    return records
