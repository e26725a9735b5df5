"""Blanket over the legs: cloth as a height field that rests on the highest points below."""

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, Int64
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.rig.locations import Location
from synth.rig.objects_nearby import Thing, ThingPose
from synth.surface.furniture import Surface
from synth.surface.rasterize import grid_faces, tagged

CELL_M = 0.03  # distance of the cloth's nodes; untuned
THICK_M = 0.015  # of fleece
HALF_WIDTH_M, BEFORE_KNEES_M, LAP_M = 0.48, 0.42, (0.05, 0.2)  # a throw: reach in front of knees and hips
HEM_M = (0.12, 0.32)  # height of the throw's hem over the floor
BED_TOP_Y_M, OVER_EDGE_M, BED_HANG_M = (-0.35, 0.1), 0.05, 0.3  # a bed's blanket: upper end, overhang
CARRIED_M = 0.06  # height over the hem of supported cloth
STIFF_CELLS = 5  # width of hollows that the cloth spans
_SIDES = ("left", "right")
_LEGS = tuple(Region.on(side, name) for side in _SIDES for name in ("upper_leg", "lower_leg"))


def lap_blanket(location: Location, body: Body, rng: np.random.Generator) -> Thing:
    """Return a blanket over a sitting person's lap, which follows the legs and hangs down in front of
    them.
    """
    hem, short, height = rng.uniform(*HEM_M), rng.uniform(*LAP_M), location.furniture.height
    width = location.furniture.top.half_width_m
    half = min(HALF_WIDTH_M, width)
    n, m = (round(length / CELL_M) for length in (2 * half, 0.9))
    legs = _vertices_of(body, _LEGS)

    def where(person_m: Float32, joints_m: Float64) -> Float32:
        hips, knees = (joints_m[[JOINT_ID[f"{s}_{name}"] for s in _SIDES]] for name in ("hip", "knee"))
        middle = float(np.clip(hips[:, 0].mean(), half - width, width - half))
        x = middle + np.linspace(-half, half, n)
        y = np.linspace(knees[:, 1].min() - BEFORE_KNEES_M, hips[:, 1].mean() - short, m)
        base = np.broadcast_to(np.where(y >= 0, height, hem), (n, m))
        return _hang(_drape(person_m[legs], x, y, base), hem).reshape(-1, 3)

    return _thing(n, m, where)


def bed_blanket(location: Location, body: Body, rng: np.random.Generator) -> Thing:
    """Return a blanket over the lower end of a bed and the person in it."""
    height, (half, front_y, _) = location.furniture.height, location.furniture.top
    x = np.arange(-half - OVER_EDGE_M, half + OVER_EDGE_M + CELL_M, CELL_M)
    y = np.arange(front_y - OVER_EDGE_M, rng.uniform(*BED_TOP_Y_M), CELL_M)
    on_bed = (np.abs(x)[:, None] <= half) & (y >= front_y)
    below = np.where(on_bed, height, height - BED_HANG_M)
    covered = _vertices_of(body, (*_LEGS, Region.CHEST, Region.HIP))

    def where(person_m: Float32, joints_m: Float64) -> Float32:
        return _drape(person_m[covered], x, y, below).reshape(-1, 3)

    return _thing(len(x), len(y), where)


def _vertices_of(body: Body, regions: tuple[Region, ...]) -> Int64:
    """Return the vertices of the paper's parts that hold a region of ``regions``."""
    own = np.isin(body.face_parts, PAPER.ids_of(regions))
    return np.unique(body.faces[own]).astype(np.int64)


def _drape(under_m: Float32, x: Float64, y: Float64, base_m: Float64) -> Float32:
    """Return the grid's vertices (n, m, 3), which lie over points (N, 3) and, elsewhere, at a base height (n,
    m).
    """
    i = np.rint((under_m[:, 0] - x[0]) / (x[1] - x[0])).astype(np.intp)
    j = np.rint((under_m[:, 1] - y[0]) / (y[1] - y[0])).astype(np.intp)
    inside = (i >= 0) & (i < len(x)) & (j >= 0) & (j < len(y))
    top = base_m.astype(np.float32)
    np.maximum.at(top, (i[inside], j[inside]), under_m[inside, 2])
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    stiff = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (STIFF_CELLS, STIFF_CELLS))
    spanned = cv2.dilate(cv2.morphologyEx(top, cv2.MORPH_CLOSE, stiff), around)
    height = np.maximum(cv2.GaussianBlur(spanned, (0, 0), 1.0), cv2.dilate(top, around)) + THICK_M
    gx, gy = np.meshgrid(x, y, indexing="ij")
    return np.stack([gx, gy, height], axis=-1).astype(np.float32)


def _hang(cloth_m: Float32, hem_m: float) -> Float32:
    """Return cloth (n, m, 3) that hangs straight down from the foremost support to the height ``hem_m``."""
    n, m = cloth_m.shape[:2]
    carried = cloth_m[..., 2] > hem_m + THICK_M + CARRIED_M
    first = np.where(carried.any(axis=1), carried.argmax(axis=1), m - 1)
    edge = cv2.blur(cloth_m[np.arange(n), first, 1][:, None], (1, 5))[:, 0]
    edge = np.minimum(edge, cloth_m[np.arange(n), first, 1])
    columns = np.arange(m)
    hanging = columns < first[:, None]
    share = columns / np.maximum(first[:, None], 1)
    top = cloth_m[np.arange(n), first, 2][:, None]
    hung = cloth_m.copy()
    hung[..., 2] = np.where(hanging, hem_m + share * (top - hem_m), cloth_m[..., 2])
    hung[..., 1] = np.where(hanging, edge[:, None] - THICK_M, cloth_m[..., 1])
    return hung


def _thing(rows: int, columns: int, where: ThingPose) -> Thing:
    still = np.zeros((rows * columns, 3), np.float32)
    return Thing("blanket", tagged(still, grid_faces(rows, columns), Surface.BLANKET), where)
