"""Pictures for the report: depth, labels and errors as uint8 RGB images, cropped and embedded."""

import base64
from functools import lru_cache

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8, UInt16
from annotate.crop import SIZE
from annotate.parts import BACKGROUND, TWIN_PARTS, UNDEFINED, palette_rgb
from eval.scores.confusion import NEIGHBOUR, Labels, named

Image = UInt8

SHARED = 256
"""Encoded pictures kept, 35 MB: results of the same frames show the same clouds and depth. Untuned."""

CANVAS = (24, 24, 28)
"""Colour of nothing, as in the palette of parts; untuned."""

THERMAL_RANGE_C = (18.0, 36.0)
"""Temperatures drawn from black to yellow: a room to warm skin (the paper extracts 25 to 35)."""

ERROR_KINDS = {
    "background": ("Background", CANVAS),
    "correct": ("Correct", (92, 99, 112)),
    "undefined": ("Undefined", (52, 52, 58)),
    "missed_person": ("Missed person", (79, 151, 255)),
    "invented_person": ("Invented person", (247, 201, 72)),
    "left_right_swap": ("Left-right swap", (236, 96, 204)),
    "neighbour_part": ("Neighbouring part", (240, 132, 74)),
    "other_part": ("Other part", (214, 48, 49)),
}
"""Title and colour of what an error picture shows: the kinds of `eval.scores.confusion.error_kinds`, and
where there is none; the background is first."""
ERROR_NAMES, ERROR_RGB = zip(*ERROR_KINDS.values(), strict=True)


def colorize_depth(depth_mm: UInt16) -> Image:
    """Return depth (h, w) as grey RGB (h, w, 3), near bright; the 2nd to 98th percentile span the greys."""
    valid = depth_mm > 0
    image = np.full((*depth_mm.shape, 3), CANVAS, np.uint8)
    if valid.any():
        near, far = np.percentile(depth_mm[valid], [2, 98])
        nearness = 1 - (depth_mm[valid] - near) / max(far - near, 1.0)
        image[valid] = (70 + 185 * np.clip(nearness, 0, 1)).astype(np.uint8)[:, None]
    return image


def colorize_parts(parts: Labels) -> Image:
    """Return labels (h, w) in the part colours of `annotate.parts` (h, w, 3)."""
    return palette_rgb()[parts]


def colorize_share(values: Float32) -> Image:
    """Return colours (h, w, 3) of values (h, w) in [0, 1], from dark violet to yellow.

    NaN gets the background colour.
    """
    known = np.isfinite(values)
    levels = np.where(known, np.clip(values, 0, 1) * 255, 0).astype(np.uint8)
    image = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[..., ::-1], np.uint8).copy()
    image[~known] = CANVAS
    return image


def colorize_error(truth: Labels, predicted: Labels) -> Image:
    """Return a picture (h, w, 3) of the errors: grey where the part is right, else in `ERROR_KINDS`
    colours.
    """
    return np.array(ERROR_RGB, np.uint8)[error_kind_ids(truth, predicted)]


def error_kind_ids(truth: Labels, predicted: Labels) -> Labels:
    """Return the kind of error at each pixel (h, w), as an index into `ERROR_NAMES` and `ERROR_RGB`."""
    guess = named(predicted)
    person, seen = truth != BACKGROUND, guess != BACKGROUND
    wrong = (truth != guess) & person & seen
    part = np.where(truth == UNDEFINED, BACKGROUND, truth)
    masks = {
        "correct": person & (truth == guess),
        "other_part": wrong,
        "neighbour_part": wrong & NEIGHBOUR[part, guess],
        "left_right_swap": wrong & (TWIN_PARTS[part] == guess),
        "missed_person": person & ~seen,
        "invented_person": ~person & seen,
        "undefined": truth == UNDEFINED,
    }
    kinds = np.zeros(truth.shape, np.uint8)
    for name, mask in masks.items():
        kinds[mask] = list(ERROR_KINDS).index(name)
    return kinds


def render_thermal_cloud(
    points_m: Float32, temperature_c: Float32, yaw_deg: float = 22.0, pitch_deg: float = 10.0
) -> Image:
    """Return a picture (212, 212, 3) of an organised cloud from a turned viewpoint, coloured by temperature.

    points_m: (h, w, 3), depth-camera frame, NaN = not drawn. temperature_c: (h, w), NaN is drawn grey. The
    viewer moves around the cloud's middle by yaw to its right and by pitch upwards. Points are drawn far to
    near as squares without gaps between them.
    """
    drawn = np.asarray(np.isfinite(points_m).all(-1))
    image = np.full((SIZE, SIZE, 3), CANVAS, np.uint8)
    if not drawn.any():
        return image
    turned = _orbit(points_m, drawn, yaw_deg, pitch_deg)
    color = (_thermal_colors(temperature_c) * _shade(turned)[..., None]).astype(np.uint8)[drawn]
    flat = turned[..., :2] / turned[..., 2:]
    low, high = np.percentile(flat[drawn], [0.5, 99.5], axis=0)
    scale = 0.94 * SIZE / max(float((high - low).max()), 1e-3)
    flat = (flat - (low + high) / 2) * scale + SIZE / 2
    width = _splat_px(flat)
    u, v = flat[drawn].T
    z = turned[drawn][:, 2]
    order = np.argsort(-z, kind="stable")
    rows, columns, color = v[order].astype(int), u[order].astype(int), color[order]
    # One splat is painted whole before the next nearer one: offsets vary fastest.
    dy, dx = (offset.ravel() for offset in np.indices((width, width)) - width // 2)
    rows, columns = (rows[:, None] + dy).ravel(), (columns[:, None] + dx).ravel()
    inside = (rows >= 0) & (rows < SIZE) & (columns >= 0) & (columns < SIZE)
    image[rows[inside], columns[inside]] = np.repeat(color, width * width, axis=0)[inside]
    return image


def _orbit(points_m: Float32, drawn: Bool, yaw_deg: float, pitch_deg: float) -> Float64:
    """Return points (h, w, 3) in the frame of a viewer who moved around the cloud's middle."""
    low, high = np.percentile(points_m[drawn], [2, 98], axis=0)
    middle = (low + high) / 2
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    distance_m = max(float(np.linalg.norm(middle)), 2.0 * float((high - low).max()))
    turned: Float64 = (points_m - middle) @ (about_x @ about_y).T + [0.0, 0.0, distance_m]
    turned[..., 2] = np.maximum(turned[..., 2], 0.1)
    return turned


def _thermal_colors(temperature_c: Float32) -> Float64:
    low, high = THERMAL_RANGE_C
    share = np.clip((np.nan_to_num(temperature_c, nan=low) - low) / (high - low), 0, 1)
    inferno = cv2.applyColorMap((40 + 215 * share).astype(np.uint8), cv2.COLORMAP_INFERNO)[..., ::-1]
    return np.where(np.isnan(temperature_c)[..., None], 110.0, inferno)


def _shade(points: Float64) -> Float64:
    """Return the brightness (h, w) for light from the viewer: 1 facing it, 0.55 at a grazing angle or without
    normal.
    """
    across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1)
    facing = np.divide(np.abs(normal[..., 2]), length, out=np.zeros_like(length), where=length > 0)
    light: Float64 = 0.55 + 0.45 * facing
    return light


def _splat_px(flat: Float64) -> int:
    """Return the side of a point's square in pixels: a little more than the median gap of points (h, w,
    2).
    """
    gap = np.linalg.norm(np.diff(flat, axis=1), axis=-1)
    gap = gap[np.isfinite(gap)]
    return int(np.clip(np.ceil(np.median(gap) * 1.3), 1, 8)) if gap.size else 3


def data_uri(image: Image) -> str:
    """Return an RGB image as a data URI: PNG for images with few colours such as labels, else WebP."""
    return _data_uri(image.tobytes(), image.shape)


@lru_cache(maxsize=SHARED)
def _data_uri(pixels: bytes, shape: tuple[int, ...]) -> str:
    image = np.frombuffer(pixels, np.uint8).reshape(shape)
    flat = image.reshape(-1, 3).astype(np.int32)
    few = np.unique(flat @ np.array([65536, 256, 1])).size <= 64
    bgr = np.ascontiguousarray(image[..., ::-1])
    if few:
        # Unfiltered: a seventh smaller than OpenCV's choice at level 9, in a sixth of the time.
        how = [cv2.IMWRITE_PNG_COMPRESSION, 6, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
        kind, (_, data) = "png", cv2.imencode(".png", bgr, how)
    else:
        kind, (_, data) = "webp", cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, 85])
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
