"""Depth images of unorganised clouds: a camera, and the point that each pixel shows.

Constants are untuned unless a source is given.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.importers.clouds.axes import WIDEST
from sensors.importers.clouds.pixel_lattice import Line, find_line
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FARTHEST_MM

Float64 = NDArray[np.float64]

KINECT_V2 = Intrinsics(512, 424, 365.15, 365.15, 253.98, 211.09)  # a typical one, without its lens
NEAREST_M = 0.5  # nearest depth of a Kinect v2
MARGIN = 0.05  # share of the image kept free at each side of a cloud moved into view
SPLAT = 0.6  # half-width of a point in spacings; 0.53 at least hides the far side of Kinect fusion scans
OPEN_M = 0.1  # a pixel that is farther than most neighbours by this looks through a surface
MOST = 5  # neighbours, of eight, that count as most of them
LEAST_FIELD = (1.40, 1.16)  # size over focal length, at least: a Kinect v2's, as in the training data
FILLED = 0.6  # least share of pixels beside a point that have points; thinned-out clouds have fewer
BESIDE_M = 0.05  # largest distance of a point from the one whose pixel it shares: less than an arm
VISIBLE_M = 0.03  # largest distance along z of a point from its pixel's depth: steep surfaces gain this
_STEPS = sorted(product((-1, 0, 1), repeat=2), key=lambda step: abs(step[0]) + abs(step[1]))


def find_camera(points_m: Float64) -> tuple[Intrinsics, float]:
    """Return a camera at the origin for camera-frame points (n, 3), and the points' spacing in metres.

    For points on pixel rays, it is the recording camera, and the spacing is 0. For other points it is a
    Kinect v2, or a camera of its focal length with a wider field. Points that no depth image can show are
    left out.
    """
    with np.errstate(invalid="ignore"):
        z = points_m[:, 2]
        kept = (z > 0) & (z * 1000 <= FARTHEST_MM) & (np.abs(points_m[:, :2]).max(axis=1) < WIDEST * z)
    ahead = points_m[kept]
    if not len(ahead):
        return KINECT_V2, 0.0
    x, y = ahead[:, 0] / ahead[:, 2], ahead[:, 1] / ahead[:, 2]
    across, down = find_line(x), find_line(y)
    if across is not None and down is not None:
        camera = _holding(across, down, x, y)
        if _filled(camera, x, y) >= FILLED:
            return camera, 0.0
    spacing = spacing_m(ahead)
    u, v = KINECT_V2.fx * x + KINECT_V2.cx, KINECT_V2.fy * y + KINECT_V2.cy
    height, width = KINECT_V2.shape
    if min(u.min(), v.min()) >= 0 and u.max() <= width - 1 and v.max() <= height - 1:
        return KINECT_V2, spacing
    line = Line(KINECT_V2.fx, 0.0)
    return _holding(line, line, x, y), spacing


def _holding(across: Line, down: Line, x: Float64, y: Float64) -> Intrinsics:
    """Return intrinsics with these pixel grids and an image, around the optical axis, that contains all
    directions.
    """
    sizes, centres = [], []
    for line, directions, least in zip((across, down), (x, y), LEAST_FIELD, strict=True):
        reach = line.focal_px * max(np.abs(directions).max(), least / 2)
        whole = int(np.ceil(reach)) + 1
        centres.append(whole + line.centre_px)
        sizes.append(min(2 * whole + (2 if line.centre_px > 0 else 1), MAX_IMAGE_SIDE))
    return Intrinsics(sizes[0], sizes[1], across.focal_px, down.focal_px, centres[0], centres[1])


def _filled(camera: Intrinsics, x: Float64, y: Float64) -> float:
    """Return the share of filled neighbours, to the right and below, of pixels with points."""
    seen = np.zeros(camera.shape, bool)
    u, v = np.rint(camera.fx * x + camera.cx).astype(int), np.rint(camera.fy * y + camera.cy).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    seen[v[inside], u[inside]] = True
    beside = (seen[:-1, :-1] & seen[1:, :-1]).sum() + (seen[:-1, :-1] & seen[:-1, 1:]).sum()
    return float(beside / max(1, 2 * seen[:-1, :-1].sum()))


def project_cloud(points_m: Float64, camera: Intrinsics, spacing: float) -> NDArray[np.intp]:
    """Return the index (h, w) of the point that each pixel shows, -1 = none, of camera-frame points (n, 3).

    The nearest point wins. A point covers the pixels within SPLAT * ``spacing`` metres, at least its own, so
    that a surface sampled at that spacing shows no holes. Points that are not finite show nothing.
    """
    with np.errstate(invalid="ignore"):
        order = np.flatnonzero(np.isfinite(points_m).all(axis=1) & (points_m[:, 2] > 0))
    order = order[np.argsort(-points_m[order, 2], kind="stable")]
    x, y, z = points_m[order].T
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    radius = np.clip(camera.fx * SPLAT * spacing / z, 0.5, 8.0)
    shown = np.full(camera.shape, -1, np.intp)
    depth = np.full(camera.shape, np.inf)
    reach = int(np.ceil(radius.max(initial=0.5))) if spacing > 0 else 0
    for dv, du in product(range(-reach, reach + 1), repeat=2):
        column, row = np.rint(u) + du, np.rint(v) + dv
        hit = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        if du or dv:
            hit &= (np.abs(column - u) <= radius) & (np.abs(row - v) <= radius)
        # Farthest first: of several points in a pixel the last, the nearest, stays.
        here = np.full(camera.shape, -1, np.intp)
        here[row[hit].astype(int), column[hit].astype(int)] = np.flatnonzero(hit)
        nearer = here >= 0
        nearer[nearer] = z[here[nearer]] < depth[nearer]
        depth[nearer] = z[here[nearer]]
        shown[nearer] = order[here[nearer]]
    return _closed(shown, depth) if spacing > 0 else shown


def _closed(shown: NDArray[np.intp], depth: Float64) -> NDArray[np.intp]:
    """Return ``shown`` with a neighbour's point at pixels that look through gaps of a nearer surface.

    depth: (h, w) in metres.
    """
    padded = np.pad(shown, 1, constant_values=-1)
    far = np.pad(depth, 1, constant_values=np.inf)
    height, width = shown.shape
    places = [(dv, du) for dv, du in product((0, 1, 2), repeat=2) if (dv, du) != (1, 1)]
    nearer = [far[dv : dv + height, du : du + width] < depth - OPEN_M for dv, du in places]
    through = np.sum(nearer, axis=0) >= MOST
    closed = shown.copy()
    for (dv, du), there in zip(places, nearer, strict=True):
        fill = through & there
        closed[fill] = padded[dv : dv + height, du : du + width][fill]
    return closed


def shift_into_view(points_m: Float64, camera: Intrinsics) -> Float64:
    """Return the translation (3,) in metres that moves all of the points (n, 3) into the camera's view.

    The cloud is centred and moved back until it fills the image up to a margin.
    """
    shift = np.asarray(-(points_m.min(axis=0) + points_m.max(axis=0)) / 2, np.float64)
    # The camera's field is not symmetric about its axis: its narrower half counts.
    center, size = np.array([camera.cx, camera.cy]), np.array([camera.width, camera.height])
    half = np.minimum(center, size - 1 - center) * (1 - 2 * MARGIN)
    needed = np.abs(points_m[:, :2] + shift[:2]) * (camera.fx, camera.fy) / half - points_m[:, 2:]
    shift[2] = max(needed.max(), NEAREST_M - points_m[:, 2].min())
    return shift


def pixels_of(points_m: Float64, camera: Intrinsics, depth_m: Float64) -> NDArray[np.intp]:
    """Return the flat index (n,) of the pixel that shows each camera-frame point, -1 without such a pixel.

    depth_m: (h, w), NaN = no reading. The point's own pixel where its depth is within VISIBLE_M, else the one
    of its eight neighbours whose depth is nearest, within VISIBLE_M.
    """
    found = np.full(len(points_m), -1, np.intp)
    with np.errstate(invalid="ignore"):
        ahead = np.flatnonzero(np.isfinite(points_m).all(axis=1) & (points_m[:, 2] > 0))
    x, y, z = points_m[ahead].T
    with np.errstate(over="ignore"):
        u, v = np.rint(camera.fx * x / z + camera.cx), np.rint(camera.fy * y / z + camera.cy)
    least = np.full(len(ahead), VISIBLE_M)
    for du, dv in _STEPS:
        column, row = u + du, v + dv
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        pixel = np.where(inside, row * camera.width + column, 0).astype(np.intp)
        away = np.where(inside, np.abs(depth_m.ravel()[pixel] - z), np.inf)
        better = (away <= least) & ((found[ahead] < 0) | (away < least))
        found[ahead[better]] = pixel[better]
        # A point's own pixel, if it shows the point, is final.
        least[better] = -1.0 if du == 0 and dv == 0 else away[better]
    return found


def fill_from_nearest(points_m: Float64, pixels: NDArray[np.intp], within_m: float) -> NDArray[np.intp]:
    """Return ``pixels`` (n,) with hidden points (-1) assigned to the pixel of the nearest visible point.

    within_m: largest distance of that point; surfaces at a glancing angle lose points between pixels.
    """
    lost = np.flatnonzero((pixels < 0) & np.isfinite(points_m).all(axis=1))
    shown = np.flatnonzero(pixels >= 0)
    if not len(lost) or not len(shown):
        return pixels
    _, nearest = cKDTree(points_m[shown]).query(points_m[lost], distance_upper_bound=min(within_m, BESIDE_M))
    found = nearest < len(shown)
    filled = pixels.copy()
    filled[lost[found]] = pixels[shown[nearest[found]]]
    return filled


def spacing_m(points_m: Float64) -> float:
    """Return the distance of neighbouring points of a surface: 95th percentile of the distance to the fourth
    neighbour.

    The fourth is used because it also bridges the gaps between randomly scattered points; in a lattice it
    equals the step.
    """
    points = _distinct(points_m)
    if len(points) < 6:
        return 0.0
    sample = points[:: max(1, len(points) // 5000)]
    distances, _ = cKDTree(points).query(sample, k=5)
    return float(np.percentile(distances[:, 4], 95))


def _distinct(points_m: Float64) -> Float64:
    """Return the points without repetitions (compared in float32), which would make the neighbour search
    slow.
    """
    rows = points_m.astype(np.float32)
    order = np.lexsort(rows.T)
    first = np.ones(len(rows), bool)
    first[order[1:]] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    return points_m[first]
