"""One camera's numbers in text files of many programs: YAML, XML, JSON, ``key = value``, or plain numbers.

Files are scanned for keys and the numbers behind them. YAML parsers refuse OpenCV's YAML, and OpenCV's own
parser writes beyond its memory at corrupt files. The following files are read:

- OpenCV's FileStorage (YAML 1.0 or XML): ``camera_matrix``, ``distortion_coefficients``, ``image_width``.
- ROS: files of camera_calibration_parsers (``parse_yml.cpp``), and an echoed CameraInfo (``K D`` or ``k d``).
- ORB-SLAM's settings: ``Camera.fx``, ``Camera1.fx``, ``Camera.width``, ``DepthMapFactor``.
- Kalibr's camchain of one camera: ``intrinsics: [fu, fv, pu, pv]``, ``distortion_coeffs``, ``resolution``.
- nerfstudio's ``fl_x``, BOP's ``cam_K``, and JSON with a 3x3 matrix or more keys than ours.
- Text without keys: a 3x3, 3x4 or 4x4 matrix (ScanNet, SUN RGB-D, 3DMatch), ``fx fy cx cy`` (ETH3D),
  ``width height fx fy cx cy`` (ARKitScenes), or a line of COLMAP's cameras.txt.
"""

import math
import re
from dataclasses import replace

import numpy as np

from sensors.calibration_files.lens_models import intrinsics_from_opencv
from sensors.checks.camera_check import is_centred
from sensors.rig.camera import Intrinsics

Fields = dict[str, list[float]]

SKEW = 1e-3  # share of the focal length up to which skew is ignored; untuned
LENS_NUMBERS = (4, 5, 8, 12, 14)  # of OpenCV's lenses
NO_CAMERA = "it holds no camera: give fx, fy, cx, cy, width and height, or a 3x3 camera matrix"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_NUMBERS = re.compile(rf"(?<![\w.]){_NUMBER}(?![\w.])", re.IGNORECASE | re.ASCII)
_KEY = re.compile(r"""["']?([A-Za-z_][\w.]*)["']?[ \t]*[:=]""", re.ASCII)
_COLMAP = re.compile(r"^\s*\d+\s+PINHOLE\s+(.*)$", re.MULTILINE)
_SHAPES = ("rows", "cols", "dt", "type_id")  # of matrices, whose ``data`` belongs to the key above
_REGION = ("x_offset", "y_offset", "width", "height", "do_rectify")  # of a CameraInfo's region of interest
_MATRIX = (
    *("camera_matrix", "cameramatrix", "cam_k", "k"),
    *("intrinsic_matrix", "intrinsics", "intrinsic", "mtx"),
)
_FOCAL = (("fx", "fl_x"), ("fy", "fl_y"), ("cx", "ppx"), ("cy", "ppy"))
_SIZE = (("width", "image_width", "imagewidth", "w"), ("height", "image_height", "imageheight", "h"))
_PAIR = ("resolution", "image_size", "imagesize")
_LENS = (
    *("distortion_coefficients", "distortioncoefficients", "distortion_coeffs", "dist_coeffs"),
    *("distcoeffs", "distortion", "dist", "d", "coeffs"),
)
_SINGLE = ("k1", "k2", "p1", "p2", "k3")
_MODEL = ("distortion_model", "camera_model", "model", "type")
_NO_PINHOLE = ("fish", "equi", "omni", "kannala", "ftheta", "double", "ds", "eucm", "ucm", "fov", "inverse")
_STEPS = ("depthmapfactor", "depth_map_factor", "depth_factor")
_READ = frozenset((*_MATRIX, *_PAIR, *_LENS, *_SINGLE, *_STEPS, *sum((*_FOCAL, *_SIZE), ())))
_UNREAD = re.compile(  # keys of lenses and depth steps that are not read, and must not be ignored
    rf"^(?!(?:{'|'.join((*_LENS, *_SINGLE, *_STEPS, 'depth_unit_mm', 'depth_scale'))})$)"
    r"(?:.*(?:dist|coef).*|k[4-6]|.*depth.*(?:unit|scale|factor).*)$",
    re.ASCII,
)
_PREFIX = re.compile(r"^(?:camera1?|cam0?|rgbd)\.", re.ASCII)


def read_camera_text(text: str, shape: tuple[int, int]) -> tuple[Intrinsics, float | None]:
    """Return the camera in ``text``, and the millimetres of a depth step if stated.

    shape: (h, w) of the images, for files without a size. Raises ValueError, which names the fault, for text
    with no camera, with two, or without a pinhole.
    """
    lines = (re.sub(r"(?:^|\s)(?:#|//).*|^%.*", "", line) for line in text.splitlines())
    body = re.sub(r"</[^>]*>", "\n", "\n".join(lines))
    body = re.sub(r"<\??([A-Za-z_][\w.]*)[^>]*>", r"\n\1: ", body)
    fields, words = scan(body)
    if not fields:
        return _plain(text, shape), None
    unread = [key for key, numbers in fields.items() if _UNREAD.search(key) and any(numbers)]
    if unread:
        raise ValueError(f"{unread[0][:40]} is not read: give k1, k2, p1, p2, k3, depth_unit_mm")
    size = _size(fields, shape)
    for key in _MODEL:
        model = words.get(key, "")
        if any(re.search(rf"(?<![a-z]){name}", model) for name in _NO_PINHOLE):
            raise ValueError(f"{key} {model[:40]} is not a pinhole with OpenCV's lens; give rectified images")
    stated = any(key in fields for key in (*_SIZE[0], *_PAIR))
    pinhole = _camera(_pinhole(fields), size, stated=stated)
    return _with_lens(pinhole, fields), _unit_mm(fields)


def scan(text: str) -> tuple[Fields, dict[str, str]]:
    """Return numbers and words behind each key, in small letters. Raises ValueError for repeated keys."""
    fields: Fields = {}
    words: dict[str, str] = {}
    matches, owner = list(_KEY.finditer(text)), ""
    ends = [*(match.start() for match in matches[1:]), len(text)]
    for match, end in zip(matches, ends, strict=False):
        value = text[match.end() : end]
        key = _PREFIX.sub("", match[1].lower())
        key = owner if key == "data" else key
        if key in _SHAPES or (owner == "roi" and key in _REGION):
            continue
        owner = key
        numbers = [float(number) for number in _NUMBERS.findall(value)]
        wrong = re.search(r"(?<![\w.])[-+.]*(?:nan|inf)\b", value, re.IGNORECASE)
        if wrong or not all(map(math.isfinite, numbers)):
            raise ValueError(f"{key} holds numbers that are not finite")
        if not numbers:
            words.setdefault(key, value.strip(" \t\r\n\"',;{}[]").lower())
        elif fields.setdefault(key, numbers) != numbers and key in _READ:
            raise ValueError(f"{key} is there twice: keep the depth camera alone")
    return fields, words


def _first(fields: Fields, keys: tuple[str, ...], *counts: int) -> list[float] | None:
    return next((fields[key] for key in keys if len(fields.get(key, ())) in counts), None)


def _pinhole(fields: Fields) -> tuple[float, ...]:
    """Return fx, fy, cx, cy of the fields. Raises ValueError where they are missing."""
    singles = [_first(fields, keys, 1) for keys in _FOCAL]
    if all(singles):
        return tuple(single[0] for single in singles if single)
    matrix = _first(fields, _MATRIX, 4, 9, 12, 16)
    if matrix is None:
        raise ValueError(NO_CAMERA)
    return pinhole_of(matrix)


def pinhole_of(numbers: list[float]) -> tuple[float, ...]:
    """Return fx, fy, cx, cy from these four numbers, or from a 3x3, 3x4 or 4x4 matrix by rows.

    Matrices by columns, as MATLAB and Open3D write them, are recognised. Raises ValueError for other numbers.
    """
    if len(numbers) == 4:
        return tuple(numbers)
    if len(numbers) not in (9, 12, 16):
        raise ValueError(f"it holds {len(numbers)} numbers: give fx fy cx cy, or a 3x3 or 4x4 camera matrix")
    rows = 4 if len(numbers) == 16 else 3
    matrix = np.array(numbers).reshape(rows, -1)[:3, :3]
    if matrix[0, 2] == 0 and matrix[2, 0] != 0:
        matrix = matrix.T
    last_row, corner = matrix[2].tolist(), float(matrix[1, 0])
    if last_row != [0, 0, 1] or corner != 0 or abs(matrix[0, 1]) > SKEW * abs(matrix[0, 0]):
        raise ValueError("its matrix is not a camera's: give fx 0 cx, 0 fy cy, 0 0 1")
    return tuple(matrix[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2)))


def _size(fields: Fields, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the stated (h, w), or else ``shape`` of the images."""
    if (pair := _first(fields, _PAIR, 2)) is not None:
        return int(pair[1]), int(pair[0])
    width, height = (_first(fields, keys, 1) for keys in _SIZE)
    return (int(height[0]), int(width[0])) if width and height else shape


def _camera(pinhole: tuple[float, ...], size: tuple[int, int], *, stated: bool) -> Intrinsics:
    fx, fy, cx, cy = map(float, pinhole)
    height, width = size
    if not (height and width):
        raise ValueError("it states no size: add width and height")
    if not stated and not is_centred((cx, cy), size):
        raise ValueError(
            f"it states no size, and its centre ({cx:g}, {cy:g}) is not the middle of images of "
            f"{width}x{height}: give the depth camera's numbers, with width and height"
        )
    return Intrinsics(width, height, fx, fy, cx, cy)


def _with_lens(pinhole: Intrinsics, fields: Fields) -> Intrinsics:
    lens = next((fields[key] for key in _LENS if key in fields), None)
    if lens is None:
        lens = [fields.get(key, [0.0])[0] for key in _SINGLE]
    lens = lens[: len(lens) - next((n for n, number in enumerate(reversed(lens)) if number), len(lens))]
    count = next((count for count in LENS_NUMBERS if len(lens) <= count), None)
    if count is None:
        raise ValueError(f"its lens has {len(lens)} numbers: give k1, k2, p1, p2, k3")
    if count <= len(_SINGLE):
        return replace(pinhole, **dict(zip(_SINGLE, lens, strict=False)))  # type: ignore[arg-type]
    return intrinsics_from_opencv(pinhole, np.array([*lens, *[0.0] * (count - len(lens))]), "the file")


def _unit_mm(fields: Fields) -> float | None:
    """Return the millimetres of a depth step.

    ORB-SLAM states steps per metre, BOP millimetres, librealsense metres.
    """
    if (steps := _first(fields, _STEPS, 1)) is not None:
        return 1000 / steps[0] if steps[0] > 1 else None
    if (stated := fields.get("depth_unit_mm")) is not None:
        return stated[0]
    scale = fields.get("depth_scale", [0.0])[0]
    if scale <= 0:
        return None
    if scale >= 100:
        return 1000 / scale
    return 1000 * scale if scale < 0.02 else scale


def _plain(text: str, shape: tuple[int, int]) -> Intrinsics:
    """Return the camera of a text that has numbers without keys. shape: (h, w) of the images."""
    colmap = _COLMAP.findall(text)
    if len(colmap) > 1:
        raise ValueError("it holds several cameras: keep the depth camera alone")
    body = colmap[0] if colmap else "\n".join(line.split("#")[0] for line in text.splitlines())
    if re.search(r"[a-z]{2,}", body, re.IGNORECASE):
        raise ValueError(NO_CAMERA)
    numbers = [float(number) for number in _NUMBERS.findall(body)]
    if len(numbers) == 6:
        width, height, *pinhole = numbers
        return _camera(tuple(pinhole), (int(height), int(width)), stated=True)
    return _camera(pinhole_of(numbers), shape, stated=False)
