"""Repairs of a wrong patch: every operation of the window that could correct it, with its effect.

Constants are untuned unless a source is given.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float64, Int32, Int64, UInt8
from annotate.cleanup import filled, neighbours, without_islands
from annotate.correction import select
from annotate.correction.edit import Editor
from annotate.correction.select import ScreenPoints, brush, grow, polygon, supervoxel
from annotate.effort import hand
from annotate.effort.agreement import Agreement
from annotate.effort.hand import CAREFUL, FINE, QUICK, Hand, drawn
from annotate.labelset.stroke import GestureKind, Operation
from annotate.scheme.limbs import limbs_of
from annotate.scheme.scheme import BACKGROUND, UNDEFINED

SCALE = 3.0  # screen pixels per pixel of the depth image: a person of 250 px fills the window's height
MOST_CLICKS = (1, 2, 4)  # pieces clicked before looking again
MOST_GROWING = 4  # clicks that grow a piece
NEAR_PX = 60  # largest extent of a patch for which zooming in is worth while


@dataclass(frozen=True)
class Patch:
    """Connected wrong pixels with one true part.

    mask: bool (h, w). part: the true part. was: most frequent label of the pixels. wrong: number of pixels
    outside the tolerance.
    """

    mask: Bool
    part: int
    was: int
    wrong: int


@dataclass(frozen=True)
class Move:
    """One action of the annotator in the window.

    part: part to assign, or None. corners: (k, 2) as (u, v), drawn by ``hand``. pixel: flat index under the
    pointer. only: the one part to replace. keep_outline: True if background stays. pairs: pairs of parts to
    swap. keys: number of keys for the operation itself.
    """

    operation: Operation
    kind: GestureKind
    part: int | None = None
    corners: Float64 | None = None
    hand: Hand = CAREFUL
    radius_px: float = 0.0
    pixel: int | None = None
    clicks: int = 0
    only: int | None = None
    keep_outline: bool = False
    pairs: tuple[tuple[int, int], ...] = ()
    keys: int = 0

    @property
    def identity(self) -> object:
        """Return the fields that distinguish the move from others, all except the hand."""
        drawn = b"" if self.corners is None else self.corners.tobytes()
        settings = (self.part, self.radius_px, self.only, self.keep_outline, self.pairs)
        return (self.operation, self.kind, *settings, self.pixel, self.clicks, drawn)


@dataclass(frozen=True)
class Repair:
    """Sequence of moves, and their intended result: flat pixels (n,) and their new parts (n,)."""

    moves: tuple[Move, ...]
    pixels: Int64
    parts: UInt8

    @property
    def identity(self) -> object:
        """Return the identities of the moves."""
        return tuple(move.identity for move in self.moves)


def in_one_go(several: Sequence[Repair]) -> Repair:
    """Join repairs of different patches with the same part to one repair."""
    pixels, first = np.unique(np.concatenate([repair.pixels for repair in several]), return_index=True)
    parts = np.concatenate([repair.parts for repair in several])[first]
    return Repair(tuple(move for repair in several for move in repair.moves), pixels, parts)


@dataclass(frozen=True)
class View:
    """Frame under correction, with the data from which repairs are computed.

    supervoxels: int32 (h, w), -1 = none. imagined: random generator of the hand's expected errors.
    """

    editor: Editor
    agreement: Agreement
    screen: ScreenPoints
    supervoxels: Int32
    imagined: np.random.Generator

    def chosen(self, move: Move, corners: Float64 | None) -> Int64:
        """Return the flat pixels (n,) that a move selects. corners: (k, 2) of its drawn line, or None."""
        parts = self.editor.parts
        if corners is not None:
            on_screen = (corners + 0.5) * SCALE
            if move.kind == "brush":
                return brush(self.screen, on_screen, move.radius_px * SCALE)
            return polygon(self.screen, on_screen)
        if move.pixel is None:
            return np.arange(parts.size)
        if move.kind == "key":
            return select.patch(parts, self.editor.depth_mm, move.pixel)
        pixels = supervoxel(self.supervoxels, parts, move.pixel)
        for _ in range(move.clicks - 1):
            pixels = grow(self.supervoxels, parts, self.editor.depth_mm, pixels)
        return pixels


def patches(parts: UInt8, agreement: Agreement) -> list[Patch]:
    """Return the wrong patches of labels (h, w), largest first; gaps of two pixels do not divide a patch."""
    wrong, truth = agreement.wrong(parts), agreement.truth
    found = []
    for part in np.unique(truth[wrong]).tolist():
        mask = (truth == part) & (parts != part)
        joined = cv2.dilate(mask.astype(np.uint8), hand.AROUND)
        _, labels = cv2.connectedComponents(joined, connectivity=8, ltype=cv2.CV_32S)
        number = np.bincount(labels[mask & wrong])
        for label in np.flatnonzero(number):
            own = mask & (labels == label)
            was = int(np.bincount(parts[own]).argmax())
            found.append(Patch(own, part, was, int(number[label])))
    return sorted(found, key=lambda patch: -patch.wrong)


def repairs(patch: Patch, view: View) -> Iterator[Repair]:
    """Yield every repair of one patch."""
    for move in (*_drawings(patch, view), *_growings(patch, view)):
        yield _painting(view, (move,))
    clicks = tuple(_clicks(patch, view))
    for count in MOST_CLICKS:
        if count <= len(clicks):
            yield _painting(view, clicks[:count])
    yield from _of_piece(patch, view)


def repairs_of_frame(view: View, wanted: set[int]) -> Iterator[Repair]:
    """Yield the repairs that act on the whole frame, not on one patch. wanted: parts that lack pixels."""
    parts, depth_mm = view.editor.parts, view.editor.depth_mm
    twins = view.editor.scheme.swap_left_right(parts)
    for pairs in (limb.pairs for limb in limbs_of(view.editor.scheme)):
        limbs = np.isin(parts, np.ravel(pairs))
        if limbs.any():
            move = Move("swap_left_right", "key", pixel=int(np.flatnonzero(limbs)[0]), pairs=pairs, keys=1)
            yield _difference(view, move, np.where(limbs, twins, parts))
    # Once to see the preview, once to apply, with Ctrl.
    yield _difference(view, Move("remove_islands", "key", keys=4), without_islands(parts, depth_mm))
    for part in wanted - {BACKGROUND}:
        yield _difference(view, Move("fill_holes", "key", part, keys=4), filled(parts, depth_mm, part))


def _drawings(patch: Patch, view: View) -> Iterator[Move]:
    """Yield lassos along the patch's border or loosely around it, and brush strokes."""
    parts, part = view.editor.parts, patch.part
    free = ~view.editor.valid | ((parts == part) & (view.agreement.truth == part)) | patch.mask
    careful = hand.outline(patch.mask, free, CAREFUL)
    quick = hand.loop(patch.mask, QUICK)
    small = max(np.ptp(axis) for axis in np.nonzero(patch.mask)) < NEAR_PX
    kept = part != BACKGROUND and patch.was != BACKGROUND
    lassos = [(CAREFUL, careful), (QUICK, quick)]
    if small:
        lassos.append((FINE, hand.outline(patch.mask, free, FINE)))
    for drawing, corners in lassos:
        yield Move("paint", "lasso", part, corners, drawing)
        yield Move("paint", "lasso", part, corners, drawing, only=patch.was)
        if kept:
            yield Move("paint", "lasso", part, corners, drawing, keep_outline=True)
    for radius_px in hand.BRUSHES_PX:
        for drawing in (CAREFUL, FINE) if small else (CAREFUL,):
            path = hand.along(patch.mask, radius_px / drawing.zoom)
            for only in (None, patch.was):
                yield Move("paint", "brush", part, path, drawing, radius_px / drawing.zoom, only=only)


def _clicks(patch: Patch, view: View) -> Iterator[Move]:
    """Yield clicks on supervoxels that touch the patch, the largest gain in right pixels first."""
    parts, ids = view.editor.parts, view.supervoxels
    key = np.where(ids >= 0, ids * 256 + parts.astype(np.int32), -1).ravel()
    inside = np.flatnonzero(patch.mask & (ids >= 0))
    touched, first = np.unique(key[inside], return_index=True)
    pixels = np.flatnonzero(np.isin(key, touched))
    gains = view.agreement.gains(parts, pixels, np.full(len(pixels), patch.part, np.uint8))
    total = np.bincount(np.searchsorted(touched, key[pixels]), gains.ravel()[pixels], len(touched))
    for best in np.argsort(-total, kind="stable")[: MOST_CLICKS[-1]]:
        if total[best] > 0:
            yield Move("paint", "supervoxel", patch.part, pixel=int(inside[first[best]]), clicks=1)


def _growings(patch: Patch, view: View) -> Iterator[Move]:
    """Yield clicks on the best supervoxel, followed by one to four clicks that grow the selection."""
    for start in list(_clicks(patch, view))[:1]:
        for clicks in range(2, 2 + MOST_GROWING):
            yield Move("paint", "grow", patch.part, pixel=start.pixel, clicks=clicks)


def _of_piece(patch: Patch, view: View) -> Iterator[Repair]:
    """Yield repairs of the whole connected piece that holds the patch.

    The piece is assigned to its neighbour, or its whole part is turned into the true part.
    """
    parts, at = view.editor.parts, int(np.flatnonzero(patch.mask & (view.editor.parts == patch.was))[0])
    if patch.was in (BACKGROUND, UNDEFINED):
        return
    pixels = select.patch(parts, view.editor.depth_mm, at)
    if patch.part in neighbours(parts, pixels, view.editor.scheme)[:1]:
        move = Move("to_neighbour", "key", pixel=at, keys=1)
        yield Repair((move,), pixels, np.full(len(pixels), patch.part, np.uint8))
    if patch.part != BACKGROUND:
        move = Move("merge", "key", patch.part, pixel=at, keys=2)
        yield _difference(view, move, np.where(parts == patch.was, np.uint8(patch.part), parts))


def _painting(view: View, moves: tuple[Move, ...]) -> Repair:
    """Return the repair that paints with these moves, whose lines have the hand's expected errors."""
    lines = [m.corners if m.corners is None else drawn(m.corners, m.hand, view.imagined) for m in moves]
    pixels = np.unique(np.concatenate([view.chosen(*each) for each in zip(moves, lines, strict=True)]))
    editor, move = view.editor, moves[0]
    assert move.part is not None
    old = editor.parts.ravel()[pixels]
    allowed = editor.valid.ravel()[pixels]
    if move.only is not None:
        allowed = allowed & (old == move.only)
    if move.keep_outline:
        allowed = allowed & (old != BACKGROUND)
    pixels = pixels[allowed]
    return Repair(moves, pixels, np.full(len(pixels), move.part, np.uint8))


def _difference(view: View, move: Move, parts: UInt8) -> Repair:
    pixels = view.editor.preview(parts)
    return Repair((move,), pixels, parts.ravel()[pixels])
