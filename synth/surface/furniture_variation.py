"""Variation of the training cast's furniture: other sizes, legs, boards, and bars around it.

World frame, metres. Constants are untuned.
"""

import numpy as np

from synth.surface.furniture import Bed, Chair, Sofa, Solid, Surface
from synth.surface.varied_furniture import Bars, SlattedChair, VariedBed, VariedChair, VariedSofa

PLAIN = 0.3  # share of furniture without additions
TAGS = (Surface.TABLE, Surface.WOOD)  # of frames
HEAD, FOOT, SIDE = 0.8, 0.5, 0.45  # shares of beds with a fence there
BOARD, ARM_RESTS, SLATTED = 0.35, 0.3, 0.3  # shares of fences that are boards, and of chairs
CUSHIONS, BESIDE_BACK, STOOL = 0.4, 0.25, 0.2  # shares of sofas
BED_HEIGHT_M, BED_WIDTH_M = (0.22, 0.95), (0.75, 2.0)
ARM_HEIGHT_M, ARM_WIDTH_M = (0.02, 0.35), (0.05, 0.4)  # of sofas; the height is above the seat
SITTER_M = 0.35  # from the middle of a sofa, kept free for one sitter
CUSHION_M = 0.4  # width of a cushion


def vary_bed(bed: Bed, rng: np.random.Generator) -> Bed:
    """Draw another size, mattress, pillow, legs, and fences at ends and sides; some beds stay as they are."""
    if rng.random() < PLAIN:
        return bed
    height, width = rng.uniform(*BED_HEIGHT_M), rng.uniform(*BED_WIDTH_M)
    x, y, top = width / 2, bed.length / 2, height
    is_open, tag = rng.random() < 0.5, _tag(rng)
    from_z = height - rng.uniform(0.08, 0.2) if is_open else rng.uniform(0.0, 0.15)
    around = _legs(rng, (x, -y, y), from_z, tag) if is_open else []
    for share, end in ((HEAD, y + 0.02), (FOOT, -y - 0.02)):
        if rng.random() < share:
            high = top + rng.uniform(-0.05, 0.6 if end > 0 else 0.4)
            around.append(_fence(rng, ((-x, end), (x, end)), (rng.uniform(0.0, 0.3), high), tag))
    for side in (-x - 0.02, x + 0.02):
        if rng.random() < SIDE:
            first, last = sorted(rng.uniform(-y, y, 2)) if rng.random() < 0.6 else (-y, y)
            first = min(first, y - 0.3)
            last = max(last, first + 0.3)
            heights = (max(0.0, top - rng.uniform(0.0, 0.3)), top + rng.uniform(0.05, 0.45))
            around.append(_fence(rng, ((side, first), (side, last)), heights, tag))
    sizes = {name: getattr(bed, name) for name in ("length", "pillow_height", "board_height", "give_m")}
    half = rng.uniform(0.2, max(x, 0.3))
    return VariedBed(height=height, width=width, from_z=from_z, pillow_half=half, around=(*around,), **sizes)


def vary_sofa(sofa: Sofa, rng: np.random.Generator) -> Sofa:
    """Draw other arms, legs, cushions, fences beside the back, a stool; some sofas stay as they are."""
    if rng.random() < PLAIN:
        return sofa
    height, tag = sofa.height, _tag(rng)
    arm_height, arm_width = rng.uniform(*ARM_HEIGHT_M), rng.uniform(*ARM_WIDTH_M)
    half = sofa.width / 2
    from_z = height - rng.uniform(0.12, 0.25) if rng.random() < 0.5 else rng.uniform(0.0, 0.1)
    around = _legs(rng, (half, 0.02, sofa.depth + 0.1), from_z, tag) if from_z > 0.1 else []
    if rng.random() < BESIDE_BACK:
        heights = (height + arm_height, height + sofa.back_height * rng.uniform(0.7, 1.1))
        ends = sofa.depth - rng.uniform(0.1, 0.3), sofa.depth + 0.15
        for x in (-half - arm_width / 2, half + arm_width / 2):
            around.append(_fence(rng, ((x, ends[0]), (x, ends[1])), heights, Surface.SOFA))
    sizes = {**vars(sofa), "arm_height": arm_height, "arm_width": arm_width}
    return VariedSofa(**sizes, from_z=from_z, around=(*around,), beside=_beside_sitter(sofa, rng))


def _beside_sitter(sofa: Sofa, rng: np.random.Generator) -> tuple[Solid, ...]:
    """Draw cushions at the back of a sofa, and a stool in front of it, beside the sitter."""
    half, height, solids, wide = sofa.width / 2, sofa.height, list[Solid](), CUSHION_M / 2
    for side in (-1, 1):
        if half > SITTER_M + CUSHION_M and rng.random() < CUSHIONS:
            middle, tall = side * rng.uniform(SITTER_M + wide, half - wide), rng.uniform(0.2, 0.45)
            low = (middle - wide, sofa.depth - rng.uniform(0.12, 0.3), height)
            solids.append(Solid(low, (middle + wide, sofa.depth, height + tall), 0.05, Surface.PILLOW))
    if half > SITTER_M + 0.3 and rng.random() < STOOL:
        a, b = sorted(rng.choice((-1, 1)) * np.array([SITTER_M + 0.05, half]))
        low = (a, -rng.uniform(0.5, 1.0), 0.0)
        high = (b, -rng.uniform(0.02, 0.3), height - rng.uniform(0, 0.1))
        solids.append(Solid(low, high, 0.02, Surface.SOFA))
    return (*solids,)


def vary_chair(chair: Chair, rng: np.random.Generator) -> Chair:
    """Draw another back, other legs and arm rests; some chairs stay as they are."""
    if rng.random() < PLAIN:
        return chair
    half, top, tag = chair.width / 2, chair.height - 0.05, _tag(rng)
    around = _legs(rng, (half, 0.0, chair.depth), top, tag)
    if rng.random() < ARM_RESTS:
        heights = (chair.height, chair.height + rng.uniform(0.12, 0.3))
        around += [
            _fence(rng, ((x, 0.05), (x, chair.depth)), heights, tag) for x in (-half - 0.04, half + 0.04)
        ]
    if rng.random() < SLATTED:
        return SlattedChair(**vars(chair), around=(*around,), slats=int(rng.integers(2, 7)))
    return VariedChair(**vars(chair), around=(*around,))


def _tag(rng: np.random.Generator) -> Surface:
    return TAGS[int(rng.integers(len(TAGS)))]


def _fence(
    rng: np.random.Generator,
    ends: tuple[tuple[float, float], tuple[float, float]],
    heights: tuple[float, float],
    tag: Surface,
) -> Solid:
    """Draw a board or bars between two points (x, y) on a line along x or y, and between two heights."""
    thick = rng.uniform(0.015, 0.06)
    (x0, y0), (x1, y1) = ends
    low = (min(x0, x1), min(y0, y1), heights[0])
    high = (max(x0, x1), max(y0, y1), max(heights[1], heights[0] + 0.05))
    along = 0 if high[0] - low[0] > high[1] - low[1] else 1
    spread = [thick / 2 if axis != along else 0.0 for axis in (0, 1)]
    low = (low[0] - spread[0], low[1] - spread[1], low[2])
    high = (high[0] + spread[0], high[1] + spread[1], high[2])
    if rng.random() < BOARD:
        return Solid(low, high, 0.0, tag)
    long_m = high[along] - low[along]
    upright = 2 + int(long_m / rng.uniform(0.08, 0.9))
    return Bars(
        low, high, 0.0, tag, along=along, horizontal=int(rng.integers(1, 5)), upright=upright, thick_m=thick
    )


def _legs(
    rng: np.random.Generator, floor: tuple[float, float, float], top: float, tag: Surface
) -> list[Solid]:
    """Draw legs, a column on a plate, or fences as legs. floor: half the width, front and back y."""
    half, front, back = floor
    kind, thick = int(rng.integers(4)), rng.uniform(0.02, 0.09)
    if kind == 0:
        x, y, deep = 0.7 * half, (front + back) / 2, 0.35 * (back - front)
        foot = Solid((-x, y - deep, 0.0), (x, y + deep, 0.05), 0.0, tag)
        return [Solid((-thick, y - thick, 0.0), (thick, y + thick, top), 0.0, tag), foot]
    if kind == 1:
        return [_fence(rng, ((x, front), (x, back)), (0.0, top), tag) for x in (-half, half)]
    inset = rng.uniform(0.0, 0.3)
    ys = (front + inset * (back - front) / 2, back - inset * (back - front) / 2)
    return [
        Solid((x - thick / 2, y - thick / 2, 0.0), (x + thick / 2, y + thick / 2, top), 0.0, tag)
        for x in (-half + thick / 2, half - thick / 2)
        for y in ys
    ]
