"""Pairs of depth and label images: layouts of Nishi & Miura 2017 and of MMSegmentation, with other names.

    depth/ID.png      img_dir/ID.png     16-bit depth in millimetres
    label/ID.png      ann_dir/ID.png     8-bit palette PNG of part ids, 255 = undefined (mmseg's ignore_index)

MMSegmentation: docs, "Add new dataset by reorganising data to folders"; load 16-bit images with
``LoadImageFromFile(color_type="unchanged")``. The class names and palette are in ``metainfo.json``.
"""

import json
from collections.abc import Iterator
from pathlib import Path

from natsort import natsorted

from annotate.exchange.companion import Companion, frame_files
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import decode_depth, decode_parts, encode_parts, encode_png, read_image
from annotate.parts import PARTS
from sensors.rig.camera import Intrinsics

Folders = tuple[str, str]
"""Names of the folders of depth images and of label images."""
PAPER: Folders = ("depth", "label")
MMSEG: Folders = ("img_dir", "ann_dir")


def write_pairs(folders: Folders, frames: Iterator[FrameLabels], camera: Intrinsics, out: Path) -> None:
    """Write frames as image pairs into an empty folder."""
    for name in folders:
        (out / name).mkdir()
    for frame in frames:
        (out / folders[0] / f"{frame.frame_id}.png").write_bytes(encode_png(frame.depth_mm))
        (out / folders[1] / f"{frame.frame_id}.png").write_bytes(encode_parts(frame.parts))
    if folders == MMSEG:
        metainfo = {"classes": [part.name for part in PARTS], "palette": [part.rgb for part in PARTS]}
        (out / "metainfo.json").write_text(json.dumps(metainfo) + "\n", encoding="ascii")


def read_pairs(folders: Folders, source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of image pairs; splits (train, val, ...) become one set. Raises FormatError for a
    missing or broken image.
    """
    splits = natsorted(folder.name for folder in (source / folders[1]).iterdir() if folder.is_dir()) or [""]
    for split in splits:
        labelled = list(frame_files(source / folders[1] / split, ".png"))
        images = {file.name for file in (source / folders[0] / split).glob("*.png")}
        for _ in images - {file.name for _, file in labelled}:
            companion.remark(f"images in {folders[0]}/ without a label image in {folders[1]}/ are left out")
        for frame_id, file in labelled:
            depth_mm = read_image(source / folders[0] / split / file.name, decode_depth)
            yield companion.labels(frame_id, depth_mm, read_image(file, decode_parts))
