"""Images of the report: depth, labels, errors, joints and thermal clouds as uint8 RGB (h, w, 3).

Constants are untuned.
"""

import base64
from functools import lru_cache

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8, UInt16
from annotate.crop import SIZE, Crop
from annotate.scheme.regions import Region
from annotate.scheme.scheme import UNDEFINED, Scheme
from eval.network.body_state import BodyState
from eval.scores.confusion import Labels, error_flags, named
from eval.scores.joints import JOINT

Image = UInt8

SHARED = 256  # encoded images cached, because results of the same frames share clouds and depth; 35 MB
CANVAS = (24, 24, 28)
WHITE = (255, 255, 255)
THERMAL_RANGE_C = (18.0, 36.0)  # from black to yellow: a room to warm skin
SUBPIXELS = 8  # of a pixel in OpenCV's lines, a shift of 3 bits
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
"""Title and colour of the kinds in an error image, background first."""
ERROR_NAMES, ERROR_RGB = zip(*ERROR_KINDS.values(), strict=True)
_LIMBS = (
    ("neck", "shoulder", "chest"),
    ("shoulder", "elbow", "upper_arm"),
    ("elbow", "wrist", "forearm"),
    ("pelvis", "hip", "hip"),
    ("hip", "knee", "upper_leg"),
    ("knee", "ankle", "lower_leg"),
)
_REGIONS = {region.label: region for region in Region}
LINES = (
    ("head", "neck", Region.HEAD),
    ("neck", "pelvis", Region.CHEST),
    *(
        (
            a if a in JOINT else f"{side}_{a}",
            f"{side}_{b}",
            _REGIONS.get(region) or _REGIONS[f"{side}_{region}"],
        )
        for side in ("left", "right")
        for a, b, region in _LIMBS
    ),
)
"""Connected joints, and the region whose part has the line's colour."""


def colorize_depth(depth_mm: UInt16) -> Image:
    """Return depth (h, w) as grey, near bright; its 2nd to 98th percentile spans the greys."""
    valid = depth_mm > 0
    image = np.full((*depth_mm.shape, 3), CANVAS, np.uint8)
    if valid.any():
        near, far = np.percentile(depth_mm[valid], [2, 98])
        nearness = 1 - (depth_mm[valid] - near) / max(far - near, 1.0)
        image[valid] = (70 + 185 * np.clip(nearness, 0, 1)).astype(np.uint8)[:, None]
    return image


def colorize_parts(parts: Labels, scheme: Scheme) -> Image:
    """Return labels (h, w) in the colours of their scheme."""
    return scheme.palette_rgb()[parts]


def colorize_share(values: Float32) -> Image:
    """Return values (h, w) in [0, 1] from dark violet to yellow; NaN has the background's colour."""
    known = np.isfinite(values)
    levels = np.where(known, np.clip(values, 0, 1) * 255, 0).astype(np.uint8)
    image = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[..., ::-1], np.uint8).copy()
    image[~known] = CANVAS
    return image


def colorize_error(truth: Labels, predicted: Labels, scheme: Scheme) -> Image:
    """Return an image (h, w, 3) of the errors in the colours of `ERROR_KINDS`."""
    return np.array(ERROR_RGB, np.uint8)[error_kind_ids(truth, predicted, scheme)]


def error_kind_ids(truth: Labels, predicted: Labels, scheme: Scheme) -> Labels:
    """Return the index in `ERROR_KINDS` of each pixel (h, w)."""
    ids, table = {name: i for i, name in enumerate(ERROR_KINDS)}, np.zeros((256, 256), np.uint8)
    np.fill_diagonal(table[1:, 1:], ids["correct"])
    for name, flags in error_flags(scheme).items():
        table[: len(flags), : len(flags)][flags] = ids[name]
    table[UNDEFINED] = ids["undefined"]
    return table[truth, named(predicted)]


def draw_body_state(image: Image, crop: Crop, state: BodyState, scheme: Scheme) -> Image:
    """Return a crop's image (n, n, 3) with the skeleton in the scheme's colours, the facing and the posture.

    The circle shows the person from above, with the camera at the bottom and a line for the facing.
    """
    drawn, side = np.ascontiguousarray(image), image.shape[0]
    at = (state.joints_px[:, :2] + 0.5 - (crop.left, crop.top)) * side / crop.side - 0.5
    steps = np.rint(at.clip(-side, 2 * side) * SUBPIXELS).astype(int)
    palette = scheme.palette_rgb()
    for a, b, region in LINES:
        first, last = steps[JOINT[a]].tolist(), steps[JOINT[b]].tolist()
        cv2.line(drawn, first, last, palette[scheme.table[region]].tolist(), 2, cv2.LINE_AA, 3)
    for joint in steps.tolist():
        cv2.circle(drawn, joint, 2 * SUBPIXELS, WHITE, -1, cv2.LINE_AA, 3)
    middle, radius = np.array([side - 18, side - 18]), 12
    cv2.circle(drawn, middle.tolist(), radius, WHITE, 1, cv2.LINE_AA)
    # Positive angles, with the camera on the person's left, point left in the image.
    facing = np.radians(state.facing_deg)
    tip = np.rint(middle + radius * state.facing_sure * np.array([-np.sin(facing), np.cos(facing)]))
    cv2.line(drawn, middle.tolist(), tip.astype(int).tolist(), WHITE, 2, cv2.LINE_AA)
    cv2.putText(drawn, state.name, (4, side - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE, 1, cv2.LINE_AA)
    return drawn


def render_thermal_cloud(
    points_m: Float32, temperature_c: Float32, yaw_deg: float = 22.0, pitch_deg: float = 10.0
) -> Image:
    """Return an image (SIZE, SIZE, 3) of an organised cloud seen obliquely, coloured by temperature.

    points_m: (h, w, 3), depth-camera frame, NaN if not drawn. temperature_c: (h, w), NaN is grey. yaw_deg,
    pitch_deg: orbit of the viewpoint around the cloud's middle, from the depth camera to its right and up.
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
    # Points are squares that close the gaps, drawn far to near.
    gap = np.linalg.norm(np.diff(flat, axis=1), axis=-1)
    gap = gap[np.isfinite(gap)]
    width = int(np.clip(np.ceil(np.median(gap) * 1.3), 1, 8)) if gap.size else 3
    order = np.argsort(-turned[drawn][:, 2], kind="stable")
    columns, rows = flat[drawn][order].astype(int).T
    # A square is drawn whole before the next nearer one: offsets vary fastest.
    dy, dx = (offset.ravel() for offset in np.indices((width, width)) - width // 2)
    rows, columns = (rows[:, None] + dy).ravel(), (columns[:, None] + dx).ravel()
    inside = (rows >= 0) & (rows < SIZE) & (columns >= 0) & (columns < SIZE)
    image[rows[inside], columns[inside]] = np.repeat(color[order], width * width, axis=0)[inside]
    return image


def _orbit(points_m: Float32, drawn: Bool, yaw_deg: float, pitch_deg: float) -> Float64:
    """Return points (h, w, 3) in the viewer's frame."""
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
    """Return brightness (h, w): 1 facing the viewer, 0.55 at a grazing angle or without a normal."""
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    length = np.linalg.norm(normal, axis=-1)
    facing = np.divide(np.abs(normal[..., 2]), length, out=np.zeros_like(length), where=length > 0)
    return np.asarray(0.55 + 0.45 * facing)


def data_uri(image: Image) -> str:
    """Return an RGB image as a data URI: PNG of few colours, as labels have, else WebP."""
    return _data_uri(image.tobytes(), image.shape)


@lru_cache(maxsize=SHARED)
def _data_uri(pixels: bytes, shape: tuple[int, ...]) -> str:
    image = np.frombuffer(pixels, np.uint8).reshape(shape)
    few = np.unique(image.reshape(-1, 3).astype(np.int32) @ np.array([65536, 256, 1])).size <= 64
    kind, how = ("png", [cv2.IMWRITE_PNG_COMPRESSION, 6]) if few else ("webp", [cv2.IMWRITE_WEBP_QUALITY, 85])
    data = cv2.imencode(f".{kind}", np.ascontiguousarray(image[..., ::-1]), how)[1]
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
