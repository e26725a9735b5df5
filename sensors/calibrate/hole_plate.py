"""The calibration target: a plate with holes in front of a warm matt backing, visible to all three cameras.

In infrared and colour the holes are darker or brighter than the plate, in the thermal image warm. Constants
are untuned unless a source is given.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError

Array = NDArray[np.float64]

FINE_PX = 640  # narrower images are enlarged before the search, because OpenCV's blobs need some pixels
FAINT = 1e-6  # least range of an image's values, in their own unit
SMALL_PX = 28.0  # between neighbouring holes up to which their centres are refined
LENS_PX = 0.7  # standard deviation of the blur of lens and pixel
MARGIN_MM = 12.0  # about the drawn plate, for the text and the line to measure


@dataclass(frozen=True)
class HolePlate:
    """Plate with an asymmetric grid of holes: ``rows`` rows of ``columns``; every second row is shifted by a
    pitch.

    pitch_m: distance of neighbouring rows, and half the distance of two holes of one row. hole_m: diameter.
    Raises CalibrationError for impossible dimensions.
    """

    columns: int = 4
    rows: int = 11
    pitch_m: float = 0.035
    hole_m: float = 0.022

    def __post_init__(self) -> None:
        if not (2 <= self.columns <= 50 and 3 <= self.rows <= 100 and self.rows % 2):
            raise CalibrationError(
                f"a plate of {self.columns} x {self.rows} holes is impossible; give 2 columns or more and an "
                "odd number of rows (an even one looks the same upside down)"
            )
        if not 0 < self.hole_m < np.sqrt(2) * self.pitch_m < np.inf:
            raise CalibrationError(
                f"holes of {self.hole_m} m at a pitch of {self.pitch_m} m overlap or never end; measure again"
            )

    @property
    def centers_m(self) -> Array:
        """Return the hole centres (rows * columns, 2) in the plate's plane, in the order of
        ``find_holes``.
        """
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        return np.stack([2 * column + row % 2, row], axis=1) * self.pitch_m

    @property
    def size_m(self) -> Array:
        """Return the lower and upper corner (2, 2) of the plate, a pitch and a half beyond the outermost
        centres.
        """
        reach = self.centers_m.max(axis=0)
        return np.stack([np.full(2, -1.5 * self.pitch_m), reach + 1.5 * self.pitch_m])


def plate_svg(plate: HolePlate) -> str:
    """Return a drawing to scale, to print, drill or cut by laser, with a line of 100 mm for checking."""
    low, high = 1000 * plate.size_m
    width, height = high - low
    hole, row = 1000 * plate.hole_m, 1000 * plate.pitch_m
    holes = "\n".join(
        f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{hole / 2:.2f}"/>'
        f'<path d="M{x - 2:.2f} {y:.2f}h4M{x:.2f} {y - 2:.2f}v4"/>'
        for x, y in 1000 * plate.centers_m - low
    )
    text = (
        f"annotate-cloud: {plate.columns} x {plate.rows} holes of {hole:g} mm, rows {row:g} mm apart; "
        "the line is 100 mm"
    )
    view = f"{-MARGIN_MM:g} {-MARGIN_MM:g} {width + 2 * MARGIN_MM:g} {height + 2 * MARGIN_MM:g}"
    size = f'width="{width + 2 * MARGIN_MM:g}mm" height="{height + 2 * MARGIN_MM:g}mm"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="{view}">\n'
        '<g fill="none" stroke="black" stroke-width="0.2">\n'
        f'<rect width="{width:g}" height="{height:g}"/>\n{holes}\n'
        f'<path stroke-width="0.4" d="M0 {height + 8:g}h100m0-2v4m-100 0v-4"/>\n</g>\n'
        f'<text x="0" y="-4" font-size="5" font-family="sans-serif">{text}</text>\n</svg>\n'
    )


def find_holes(image: NDArray[np.generic], plate: HolePlate) -> Array | None:
    """Return the centres (n, 2) of all holes as (u, v) in an image (h, w), row by row, or None.

    The image may be of any brightness scale (amplitude, grey, Celsius); NaN counts as dark.
    """
    grey = _stretched(np.asarray(image, np.float32))
    if grey is None:
        return None
    scale = max(1, -(-FINE_PX // grey.shape[1]))
    if scale > 1:
        fine = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        grey = np.asarray(fine, np.uint8)
    size, flags = (plate.columns, plate.rows), cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    for bright in (255, 0):
        blobs = _blobs(bright, grey.shape[1])
        found, centers = cv2.findCirclesGrid(grey, size, flags=flags, blobDetector=blobs)
        if found and centers is not None:
            coarse = np.asarray((centers.reshape(-1, 2) + 0.5) / scale - 0.5, np.float64)
            return _refined(np.asarray(image, np.float64), coarse, plate)
    return None


def _refined(image: Array, coarse: Array, plate: HolePlate) -> Array:
    """Return the centres (n, 2) of small holes: means of the contrast, weighted by a Gaussian of its size.

    Moments with a matched weight (Bernstein & Jarvis 2002, section 3), because OpenCV's blobs are several
    times noisier where holes are a few pixels wide.
    """
    gaps = np.linalg.norm(coarse[:, None] - coarse[None], axis=2)
    gap = np.sort(gaps, axis=1)[:, 1]
    if np.median(gap) > SMALL_PX:
        return coarse
    radius = gap * plate.hole_m / 2 / (np.sqrt(2) * plate.pitch_m)
    sigma = np.sqrt(np.square(radius / 2) + np.square(LENS_PX))
    return np.stack([_moment(image, *one) for one in zip(coarse, gap, sigma, strict=True)])


def _moment(image: Array, start: Array, gap: float, sigma: float) -> Array:
    center, reach = start, min(0.7 * gap, 4 * sigma)
    for _ in range(6):
        (left, top), (right, bottom) = np.floor(center - reach), np.ceil(center + reach) + 1
        u, v = np.meshgrid(np.arange(max(left, 0), right), np.arange(max(top, 0), bottom))
        patch = image[int(v[0, 0]) : int(bottom), int(u[0, 0]) : int(right)]
        if patch.shape != u.shape or not np.isfinite(patch).all():
            return start
        away = np.hypot(u - center[0], v - center[1])
        around = np.median(patch[np.abs(away - gap / 2) < 1])
        weight = np.exp(-0.5 * np.square(away / sigma)) * (patch - around)
        mean = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        center = center + 2 * (mean - center)  # because the weight pulls the mean half way back
        if not np.linalg.norm(center - start) < gap / 8:
            return start
    return center


def _stretched(image: NDArray[np.float32]) -> NDArray[np.uint8] | None:
    if not np.isfinite(image).any():
        return None
    low, high = np.nanpercentile(image, (1, 99))
    if not high - low > FAINT:
        return None
    return np.asarray(255 * np.clip(np.nan_to_num((image - low) / (high - low)), 0, 1), np.uint8)


@lru_cache(maxsize=8)
def _blobs(bright: int, width: int) -> cv2.SimpleBlobDetector:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.blobColor = bright
    parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 20, 235, 8
    parameters.minArea, parameters.maxArea = (width / 200) ** 2, (width / 12) ** 2
    parameters.minDistBetweenBlobs = width / 200
    parameters.minCircularity, parameters.filterByCircularity = 0.5, True
    parameters.minConvexity, parameters.filterByConvexity = 0.8, True
    parameters.minInertiaRatio, parameters.filterByInertia = 0.2, True
    return cv2.SimpleBlobDetector.create(parameters)
