"""Palettes fitted to corrected frames of a session, or to a photograph of the cloths."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from annotate.array_types import UInt8
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.suit.color_model import evenly, readable
from annotate.suit.palette import MIN_CHROMA_DISTANCE, Suit, body_parts, chromaticity, may_be_bare
from sensors.errors import CloudError, Setting
from sensors.rig.frame import FrameSource

SEAM_PX = 2  # distance from another part from which a colour counts
LEAST_COLORS = 30  # readable points of a part that a swatch needs
LEAST_SECOND_SHARE = 0.15  # of a part that a second colour, its skin, covers
CONTRAST = 12.0  # CIELAB distance of a patch from the paper; 2.3 is just noticeable (Sharma 2003)
LEAST_PATCH = 0.002  # share of the photograph below which a spot is noise
# All untuned.


def corrected_frames(labels: LabelSet) -> list[str]:
    """Return the ids of the frames with corrected labels. Raises CloudError without any."""
    ids = [i for i in labels.frame_ids if labels.read(i).status != "auto"]
    if not ids:
        raise CloudError(
            f"{labels.path} holds no corrected frame; correct a frame with fix, or name frames with right "
            "labels",
            Setting.FRAME,
        )
    return ids


def clouds_with(
    labels: LabelSet, frame_ids: list[str], source: FrameSource
) -> Iterator[tuple[ThermalCloud, FrameLabels]]:
    """Yield the cloud and labels of each frame in ``frame_ids``, sorted by id.

    Raises CloudError when the source or the labels lack a frame.
    """
    wanted = set(frame_ids)
    if missing := sorted(wanted - set(labels.frame_ids)):
        raise CloudError(f"{labels.path} has no frame {missing[0]!r}; give one of its ids")
    fuser = Fuser(source.calibration)
    for frame_id in sorted(wanted):
        if not frame_id.isdigit() or int(frame_id) >= len(source):
            raise CloudError(
                f"{source.name} has no frame {frame_id}; give the session the labels were made from"
            )
        yield fuser.fuse_frame(source.frame(int(frame_id))), labels.read(frame_id)


def suit_from_labels(
    frames: Iterable[tuple[ThermalCloud, FrameLabels]], name: str, scheme: Scheme = PAPER
) -> Suit:
    """Fit the palette of a suit, one or two main colours a part, to clouds with correct labels in a scheme.

    A hand or foot that is a part and hardly shows stays without a colour. Raises CloudError when labels are
    of another depth image, or no frame shows enough of another part.
    """
    beside = np.ones((2 * SEAM_PX + 1,) * 2, np.uint8)
    seen: dict[int, list[UInt8]] = {part.id: [] for part in body_parts(scheme)}
    for cloud, labels in frames:
        if not np.array_equal(cloud.depth_mm, labels.depth_mm):
            raise CloudError(
                f"frame {labels.frame_id} of the labels shows another depth image than the session's; "
                "give the session they were made from"
            )
        inner = cv2.dilate(labels.parts, beside) == cv2.erode(labels.parts, beside)
        for part in body_parts(scheme):
            here = labels.parts == part.id
            here = here & inner if (here & inner).sum() >= LEAST_COLORS else here
            rgb = cloud.color_rgb[here]
            seen[part.id].append(rgb[readable(rgb, cloud.color_valid[here])])
    return _suit({part: np.concatenate(colors) for part, colors in seen.items() if colors}, name, scheme)


def suit_from_photo(path: Path, name: str, scheme: Scheme = PAPER) -> Suit:
    """Fit a palette to a photograph (PNG or JPEG) of patches of cloth on plain paper, one for each part.

    The patches lie apart, row by row in the order of the scheme's parts of the body; those that may be bare
    are all there, or none. Raises CloudError for an unreadable picture or another number of patches.
    """
    rgb = _read(path)
    lab = cv2.cvtColor(rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    paper = np.median(np.concatenate([lab[0], lab[-1], lab[:, 0], lab[:, -1]]), axis=0)
    away = np.linalg.norm(lab - paper, axis=2)
    spots = cv2.morphologyEx((away > CONTRAST).astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(spots)
    patches = [i for i in range(1, len(stats)) if stats[i, cv2.CC_STAT_AREA] >= LEAST_PATCH * spots.size]
    covered = [part for part in body_parts(scheme) if not may_be_bare(part)]
    cloths = body_parts(scheme) if len(patches) > len(covered) else covered
    if len(patches) != len(cloths):
        raise CloudError(
            f"swatches {path} show {len(patches)} patches; lay {len(cloths)} apart on plain paper, "
            f"row by row in this order: {', '.join(part.name for part in cloths)}"
        )
    inner = cv2.erode(spots, np.ones((5, 5), np.uint8), borderValue=0) > 0
    ordered = _row_by_row(stats[patches])
    found = {}
    for part, i in zip(cloths, ordered, strict=True):
        colors = rgb[inner & (labels == patches[i])]
        found[part.id] = colors[readable(colors, np.ones(len(colors), np.bool_))]
    return _suit(found, name, scheme)


def _suit(colors: dict[int, UInt8], name: str, scheme: Scheme) -> Suit:
    swatches = []
    for part in body_parts(scheme):
        own = colors.get(part.id, np.zeros((0, 3), np.uint8))
        if len(own) >= LEAST_COLORS:
            swatches += [(rgb, part.id) for rgb in _main_colors(own)]
        elif not may_be_bare(part):
            raise CloudError(
                f"{part.name} shows {len(own)} readable colours, {LEAST_COLORS} are needed; "
                "add a frame that shows it in even light"
            )
    colors_rgb, parts = (np.array(column, np.uint8) for column in zip(*swatches, strict=True))
    return Suit(name, colors_rgb, parts, scheme)


def _main_colors(rgb: UInt8) -> list[tuple[int, ...]]:
    """Return one or two typical sRGB colours of a part's colours (n, 3), the commoner first."""
    rgb = rgb[evenly(len(rgb))]
    chroma = chromaticity(rgb)
    # Starts from the median and the point farthest from it: the same points give the same swatches.
    middle = np.median(chroma, axis=0)
    far = chroma[np.linalg.norm(chroma - middle, axis=1).argmax()]
    centres = np.stack([middle, far])
    for _ in range(20):
        side = np.linalg.norm(chroma[:, None] - centres, axis=2).argmin(axis=1)
        if min((side == 0).mean(), (side == 1).mean()) < LEAST_SECOND_SHARE:
            return [_typical(rgb)]
        centres = np.stack([np.median(chroma[side == i], axis=0) for i in (0, 1)])
    if np.linalg.norm(centres[0] - centres[1]) < MIN_CHROMA_DISTANCE:
        return [_typical(rgb)]
    order = (0, 1) if (side == 0).mean() >= 0.5 else (1, 0)
    return [_typical(rgb[side == i]) for i in order]


def _typical(rgb: UInt8) -> tuple[int, ...]:
    """Return the sRGB colour with the median chromaticity and upper brightness of colours (n, 3)."""
    x, y = np.median(chromaticity(rgb), axis=0)
    shares = np.maximum([x, y, 1 - x - y], 0)
    level = np.quantile(rgb.max(axis=1), 0.9)
    return tuple(int(c) for c in np.rint(level * (shares / shares.max()) ** (1 / 2.2)))


def _row_by_row(stats: NDArray[Any]) -> list[int]:
    """Return patch indices in reading order; a row ends where the next patch starts below its middle. stats:
    (n, 5), OpenCV's.
    """
    top, height = stats[:, cv2.CC_STAT_TOP], stats[:, cv2.CC_STAT_HEIGHT]
    middle, row = top + height / 2, np.zeros(len(stats), int)
    order = np.argsort(middle)
    row[order[1:]] = np.cumsum(np.diff(middle[order]) > np.median(height) / 2)
    return [int(i) for i in np.lexsort((stats[:, cv2.CC_STAT_LEFT], row))]


def _read(path: Path) -> UInt8:
    """Read a photograph uint8 (h, w, 3), reduced to at most 1,000 pixels a side, turned by its EXIF
    orientation.
    """
    try:
        with Image.open(path, formats=("JPEG", "PNG")) as image:
            image.thumbnail((1000, 1000))
            return np.array(ImageOps.exif_transpose(image).convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise CloudError(f"swatches {path} cannot be read ({error}); give a PNG or JPEG") from error
