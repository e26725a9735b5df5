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

from annotate.exchange.class_names import PERSON_ID, check_names, class_list, color_list
from annotate.exchange.companion import MAX_TEXT_BYTES, Companion, frame_files
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import decode_depth, decode_parts, encode_parts, encode_png, read_image
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

Folders = tuple[str, str]
"""Names of the folders of depth images and of label images."""
PAPER: Folders = ("depth", "label")
MMSEG: Folders = ("img_dir", "ann_dir")
METAINFO = "metainfo.json"


def write_pairs(folders: Folders, frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write frames as image pairs into an empty folder."""
    for name in folders:
        (out / name).mkdir()
    for frame in frames:
        (out / folders[0] / f"{frame.frame_id}.png").write_bytes(encode_png(frame.depth_mm))
        (out / folders[1] / f"{frame.frame_id}.png").write_bytes(encode_parts(frame.parts, frame.scheme))
    if folders == MMSEG:
        metainfo = {"classes": class_list(companion.scheme), "palette": color_list(companion.scheme)}
        (out / METAINFO).write_text(json.dumps(metainfo) + "\n", encoding="ascii")


def read_pairs(folders: Folders, source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of image pairs; splits (train, val, ...) become one set. Raises FormatError for a
    missing or broken image, and for class names of other programs that are unknown.
    """
    classes = [] if companion.is_ours or folders != MMSEG else _class_names(source, companion)
    splits = natsorted(folder.name for folder in (source / folders[1]).iterdir() if folder.is_dir()) or [""]
    for split in splits:
        labelled = list(frame_files(source / folders[1] / split, ".png"))
        images = {file.name for file in (source / folders[0] / split).glob("*.png")}
        for _ in images - {file.name for _, file in labelled}:
            companion.remark(f"images in {folders[0]}/ without a label image in {folders[1]}/ are left out")
        for frame_id, file in labelled:
            depth_mm = read_image(source / folders[0] / split / file.name, decode_depth)
            parts = companion.own_ids(read_image(file, decode_parts), classes)
            yield companion.labels(frame_id, depth_mm, parts)


def _class_names(source: Path, companion: Companion) -> list[str]:
    """Return the class names of ``metainfo.json`` by id; [] without the file."""
    file = source / METAINFO
    if not file.is_file():
        return []
    try:
        classes = json.loads(read_bounded(file, MAX_TEXT_BYTES))["classes"]
        names = [str(name) for name in classes] if isinstance(classes, list) else []
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise FormatError(f"{file} lacks the list 'classes' ({str(error)[:80]}); export it again") from error
    known = {name: part for name, part in companion.ids_by_name.items() if part != PERSON_ID}
    check_names(names, known, companion.scheme, file)
    return names
