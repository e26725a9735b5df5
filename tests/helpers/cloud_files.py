"""Clouds of a furnished room as files of other programs, and the frames these programs may use."""

from functools import cache

import numpy as np

from sensors.rig.camera import unproject
from tests.helpers.furnished_room import CAMERA, seen

CLOUD_FROM_CAMERA = {
    "camera": np.eye(3),
    "y-up": np.diag([1.0, -1.0, -1.0]),
    "z-up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "ros": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    "kinect": np.diag([-1.0, -1.0, 1.0]),
}
"""Coordinates by hand: a camera's right, down, forward as each convention names them."""


def pcd(points: np.ndarray, width: int, height: int, body: bytes | None = None, **header: str) -> bytes:
    """A PCD of points (n, 3), or of another ``body``."""
    fields = {"VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1"}
    fields |= {"WIDTH": str(width), "HEIGHT": str(height), "VIEWPOINT": "0 0 0 1 0 0 0"}
    fields |= {"POINTS": str(width * height), "DATA": "binary", **header}
    text = "".join(f"{key} {value}\n" for key, value in fields.items())
    return text.encode() + (points.astype("<f4").tobytes() if body is None else body)


def colored_pcd(points: np.ndarray, rgb: np.ndarray, **header: str) -> bytes:
    """An unorganised PCD of points (n, 3) with colours (n, 3) as PCL packs them."""
    records = np.zeros(len(points), [("xyz", "<f4", 3), ("rgb", "<u4")])
    red, green, blue = rgb.astype(np.uint32).T
    records["xyz"], records["rgb"] = points, red << 16 | green << 8 | blue
    fields = {"FIELDS": "x y z rgb", "SIZE": "4 4 4 4", "TYPE": "F F F F", "COUNT": "1 1 1 1"}
    return pcd(points, len(points), 1, records.tobytes(), **(fields | header))


def ply(points: np.ndarray, rgb: np.ndarray | None = None, kind: str = "float", extra: str = "") -> bytes:
    """A binary PLY of points (n, 3), colours (n, 3) beside them."""
    width = {"float": "<f4", "double": "<f8"}[kind]
    layout = [("xyz", width, 3)] + ([("rgb", "u1", 3)] if rgb is not None else [])
    records = np.zeros(len(points), layout)
    records["xyz"] = points
    names = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    if rgb is not None:
        records["rgb"] = rgb
        names += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat binary_little_endian 1.0\n{extra}element vertex {len(points)}\n{names}end_header\n"
    return head.encode() + records.tobytes()


@cache
def room(people: bool = True, room: bool = True, eye: tuple[float, ...] = (0.3, -2.4, 1.4)) -> np.ndarray:
    """Depth (h, w) in whole millimetres, 0 = none, of a person in a furnished room."""
    depth_m, _ = seen([(1, 0.0)] if people else [], room=room, eye=eye)
    return np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)


def camera_points(depth_mm: np.ndarray) -> np.ndarray:
    """Organised cloud (h, w, 3) in metres in the camera's frame, NaN = none."""
    return unproject(CAMERA, np.where(depth_mm > 0, depth_mm / 1000, np.nan)).astype(np.float64)


def random_colors(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(1, 256, (count, 3), dtype=np.uint8)


def finite(points: np.ndarray) -> np.ndarray:
    flat = points.reshape(-1, 3)
    return flat[np.isfinite(flat).all(axis=1)]


def assert_is_the_room(source, depth_mm: np.ndarray, colors: np.ndarray | None = None) -> None:
    """The depth image has every reading of the room at its pixel, moved by whole pixels."""
    v, u = np.nonzero(depth_mm)
    pixels = np.stack(np.unravel_index(source.pixels, source.calibration.depth.shape)).T
    assert (source.pixels >= 0).all()
    shift = pixels - np.stack([v, u], axis=-1)
    assert (shift == shift[0]).all()
    frame = source.frame(0)
    np.testing.assert_array_equal(frame.depth_mm[tuple(pixels.T)], depth_mm[v, u])
    assert np.count_nonzero(frame.depth_mm) == len(v)
    camera, (row, column) = source.calibration.depth, shift[0]
    found = [camera.fx, camera.fy, camera.cx - column, camera.cy - row]
    np.testing.assert_allclose(found, [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], atol=0.05)
    if colors is not None:
        np.testing.assert_array_equal(frame.decode_color()[tuple(pixels.T)], colors)


def ball(n: int = 20_000) -> np.ndarray:
    """A ball of 0.3 m radius about (0.1, 0.2, 2) in camera axes."""
    directions = np.random.default_rng(0).normal(size=(n, 3))
    return 0.3 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [0.1, 0.2, 2.0]
