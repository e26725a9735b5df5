"""Contact sheets of the frames with the worst scores of each set."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np

from annotate.array_types import Float64, UInt8, UInt16
from annotate.crop import Crop, crop_around
from annotate.labelset.labelled_frames import LabelledFrames
from annotate.parts import BACKGROUND, PAPER, on_body
from eval.compare.compare import Comparison
from eval.report.frame_images import CANVAS, WHITE, colorize_depth, colorize_parts
from eval.report.gallery import make_frame
from eval.scores.confusion import mean_recall
from eval.scores.joint_visibility import OUTSIDE
from sensors.files.atomic import write_bytes

COUNT, COLUMNS, MOST_BYTES = 10, 2, 150_000  # of a sheet: frames, frames in a row, size
SIDE_PX, LINE_PX, GAP_PX = 168, 18, 8  # of a picture, of the text below, between frames
MARGIN = 0.12  # free border of a real person, share of the larger extent
LABELS, JOINTS = ("Extracted depth", "Target labels", "Predicted labels"), ("Target labels", "Joints")
"""Columns of the report's frames: of labels, and of joints."""


class Tile(NamedTuple):
    """Pictures of a frame, uint8 (h, w, 3), and its score in words; a larger error is worse."""

    error: float
    text: str
    image: UInt8


Sheets: TypeAlias = Mapping[str, Sequence[Tile]]
"""Worst frames by set."""


def worst(tiles: Iterable[Tile]) -> list[Tile]:
    """Return the frames with the largest errors, largest first."""
    return sorted(tiles, key=lambda tile: -tile.error)[:COUNT]


def together(several: Iterable[Sheets]) -> dict[str, list[Tile]]:
    """Return the worst frames of sets that were measured in pieces."""
    found: dict[str, list[Tile]] = {}
    for sheets in several:
        for name, tiles in sheets.items():
            found[name] = worst([*found.get(name, []), *tiles])
    return found


def of_labels(compared: Comparison, predicted: LabelledFrames, truth: LabelledFrames) -> list[Tile]:
    """Return the frames with the lowest mean recall: depth, true parts, parts found."""
    recall = np.asarray(mean_recall(compared.matrices), np.float64)
    return _tiles(1 - recall, [f"mean recall {one:.2f}" for one in recall], (predicted, truth), LABELS)


def of_joints(compared: Comparison, predicted: LabelledFrames, truth: LabelledFrames) -> list[Tile]:
    """Return the frames with the largest mean error of the joints inside the image: true parts, joints."""
    if compared.joints_mm is None or compared.joints_seen is None:
        return []
    inside = compared.joints_seen != OUTSIDE
    mm = np.where(inside, compared.joints_mm, 0).sum(axis=1) / np.maximum(inside.sum(axis=1), 1)
    texts = [f"joints off by {one:.0f} mm" if np.isfinite(one) else "no joints" for one in mm]
    return _tiles(mm, texts, (predicted, truth), JOINTS)


def _tiles(
    errors: Float64,
    texts: list[str],
    sets: tuple[LabelledFrames, LabelledFrames],
    columns: tuple[str, ...],
) -> list[Tile]:
    """Return the worst of compared frames; errors, texts: (F,) in the order of the truth; NaN: no person."""
    (predicted, truth), tiles = sets, []
    found, entries = {entry.frame_id: entry for entry in predicted.entries()}, list(truth.entries())
    for i in np.argsort(-errors, kind="stable")[: min(COUNT, int((~np.isnan(errors)).sum()))].tolist():
        true = truth.load(entries[i], False)
        drawn = make_frame(true, predicted.load(found[true.frame_id], False)).columns
        blank = np.full_like(drawn[LABELS[0]], CANVAS)
        shown = [drawn.get(name, blank) for name in columns]
        small = [cv2.resize(image, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA) for image in shown]
        text = f"{texts[i]}, {true.subject or '-'}, {true.frame_id}"
        tiles.append(Tile(float(errors[i]), text, np.asarray(np.hstack(small), np.uint8)))
    return tiles


def of_real(images: tuple[UInt16, UInt8], joints_px: Float64, error: float, text: str) -> Tile:
    """Return a frame of real people: depth with a judge's joints, and the parts found.

    images: depth in millimetres and parts (h, w). joints_px: (n, 2), column and row.
    """
    depth_mm, parts = images
    shown = on_body(parts)
    at = np.rint(joints_px).astype(int).clip(0, np.array(parts.shape[::-1]) - 1)
    shown[at[:, 1], at[:, 0]] = True
    crop = crop_around(shown, MARGIN) if shown.any() else Crop(0, 0, max(parts.shape))
    depth = np.ascontiguousarray(colorize_depth(crop.cut(depth_mm, 0, SIDE_PX)))
    for u, v in ((joints_px - (crop.left, crop.top)) * SIDE_PX / crop.side).round().astype(int).tolist():
        cv2.circle(depth, (u, v), 2, WHITE, -1, cv2.LINE_AA)
    found = colorize_parts(crop.cut(parts, BACKGROUND, SIDE_PX), PAPER)
    return Tile(error, text, np.hstack([depth, np.asarray(found, np.uint8)]))


def drawn_sheet(tiles: Sequence[Tile]) -> UInt8:
    """Return the contact sheet of frames, with the score of each below, uint8 (h, w, 3) RGB."""
    height, width = SIDE_PX + LINE_PX + GAP_PX, max(tile.image.shape[1] for tile in tiles) + GAP_PX
    sheet = np.full((height * -(-len(tiles) // COLUMNS), width * COLUMNS, 3), CANVAS, np.uint8)
    for number, tile in enumerate(tiles):
        top, left = height * (number // COLUMNS), width * (number % COLUMNS)
        sheet[top : top + SIDE_PX, left : left + tile.image.shape[1]] = tile.image
        at = (left + 4, top + SIDE_PX + LINE_PX - 5)
        cv2.putText(sheet, tile.text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE, 1, cv2.LINE_AA)
    return sheet


def write_sheets(sheets: Sheets, folder: Path) -> list[Path]:
    """Write a sheet of each set into a folder, as WebP of at most ``MOST_BYTES``; return the files."""
    paths = []
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in ((name, drawn_sheet(tiles)[..., ::-1]) for name, tiles in sheets.items() if tiles):
        qualities = ([cv2.IMWRITE_WEBP_QUALITY, quality] for quality in range(90, 0, -10))
        made = [cv2.imencode(".webp", image, how)[1] for how in qualities]
        data = next((one for one in made if one.size <= MOST_BYTES), made[-1])
        paths.append(folder / f"worst-{name}.webp")
        write_bytes(paths[-1], data.tobytes())
    return paths
