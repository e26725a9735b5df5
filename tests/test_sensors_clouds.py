"""Point clouds of other programs become depth and colour images, or are refused in one line."""

import json
import warnings
from itertools import product

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sensors.errors import CloudError, FormatError
from sensors.importers.clouds import cloud_source as pointcloud
from sensors.importers.clouds import pcd_file
from sensors.importers.clouds import projection as cloud_view
from sensors.importers.clouds.cloud_source import CloudFile
from sensors.importers.clouds.organised_camera import grid_camera
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.pixel_lattice import find_line
from sensors.importers.clouds.ply_file import read_ply
from sensors.importers.clouds.projection import KINECT_V2, project_cloud, shift_into_view
from sensors.importers.open_source import open_source
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics, project, unproject
from sensors.rig.rig_calibration import RigCalibration, quaternion_of
from tests.helpers import furnished_room
from tests.helpers.cloud_files import (
    CLOUD_FROM_CAMERA,
    camera_points,
    colored_pcd,
    pcd,
    ply,
    random_colors,
    room,
)
from tests.helpers.depth_files import CAMERA, assert_refused, write
from tests.helpers.samples import las

law = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
UNITS = {"metres": 1.0, "millimetres": 1000.0, "centimetres": 100.0, "inches": 1 / 0.0254}


def organised(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Depth (24, 32) in mm and the organised cloud (24, 32, 3) that the camera sees of it."""
    depth = np.random.default_rng(seed).integers(500, 4500, (24, 32)).astype(np.uint16)
    depth[::5, ::3] = 0
    metres = np.where(depth > 0, depth / 1000, np.nan).astype(np.float32)
    return depth, unproject(CAMERA, metres)


def finite(points: np.ndarray) -> np.ndarray:
    flat = points.reshape(-1, 3)
    return flat[np.isfinite(flat).all(axis=1)]


def random_rotation(seed: int) -> np.ndarray:
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


def viewpoint(rotation: np.ndarray, origin: np.ndarray) -> str:
    x, y, z, w = quaternion_of(rotation)
    return " ".join(f"{number:.9g}" for number in (*origin, w, x, y, z))


def assert_is_the_room(source, depth_mm, colors=None):
    """The depth image has every reading of the room at its pixel but for a shift of whole pixels."""
    v, u = np.nonzero(depth_mm)
    pixels = np.stack(np.unravel_index(source.pixels, source.calibration.depth.shape)).T
    assert (source.pixels >= 0).all()
    shift = pixels - np.stack([v, u], axis=-1)
    assert (shift == shift[0]).all()
    frame = source.frame(0)
    np.testing.assert_array_equal(frame.depth_mm[tuple(pixels.T)], depth_mm[v, u])
    assert np.count_nonzero(frame.depth_mm) == len(v)
    camera, truth = source.calibration.depth, furnished_room.CAMERA
    row, column = shift[0]
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx - column, camera.cy - row],
        [truth.fx, truth.fy, truth.cx, truth.cy],
        atol=0.05,
    )
    if colors is not None:
        np.testing.assert_array_equal(frame.decode_color()[tuple(pixels.T)], colors)


# Which way, how large, from where


@pytest.mark.parametrize(
    ("axes", "unit"),
    # Axes and unit are found apart: all of each, not all pairs.
    [*product(CLOUD_FROM_CAMERA, ["millimetres"]), *(("camera", u) for u in UNITS if u != "millimetres")],
)
def test_a_camera_cloud_stays_in_place_in_any_axes_and_unit(tmp_path, axes, unit):
    """Unorganised points of a depth image give it back, bit for bit, and their colours; none is moved."""
    depth_mm = room()
    points = finite(camera_points(depth_mm)) @ CLOUD_FROM_CAMERA[axes].T * UNITS[unit]
    colors = random_colors(len(points))
    source = open_source(write(tmp_path / "x.ply", ply(points, colors)))
    assert_is_the_room(source, depth_mm, colors)
    assert f"cloud with {axes} axes left in place" in source.notes[0]
    assert any("a unit of the cloud" in note for note in source.notes) == (unit != "metres")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("grid", [True, False])
def test_a_viewpoint_turns_the_cloud(tmp_path, seed, grid):
    """A PCD's VIEWPOINT is the sensor's pose in the frame of the points."""
    depth_mm, turn = room(), random_rotation(seed)
    origin = np.random.default_rng(seed).uniform(-3, 3, 3)
    points = camera_points(depth_mm)
    points = points.reshape(-1, 3) if grid else finite(points)
    size = depth_mm.shape[::-1] if grid else (len(points), 1)
    content = pcd(points @ turn.T + origin, *size, VIEWPOINT=viewpoint(turn, origin))
    source = open_source(write(tmp_path / "x.pcd", content))
    if grid:
        np.testing.assert_array_equal(source.frame(0).depth_mm, depth_mm)
    else:
        assert_is_the_room(source, depth_mm)
        assert "at the file's VIEWPOINT" in source.notes[0]


def test_a_viewpoint_beside_points_of_the_sensors_own_frame_is_not_applied(tmp_path):
    depth_mm = room()
    points = finite(camera_points(depth_mm))
    content = pcd(points, len(points), 1, VIEWPOINT=viewpoint(np.eye(3), np.array([0.4, 0.1, 0.3])))
    source = open_source(write(tmp_path / "x.pcd", content))
    assert_is_the_room(source, depth_mm)
    assert "at the cloud's origin" in source.notes[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_grid_finds_its_camera_in_any_frame(tmp_path, seed):
    """By the direct linear transform, without a VIEWPOINT."""
    depth_mm, turn = room(), random_rotation(seed)
    points = camera_points(depth_mm).reshape(-1, 3) @ turn.T + [0.5, -2.0, 1.0]
    source = open_source(write(tmp_path / "x.pcd", pcd(points, *depth_mm.shape[::-1])))
    assert np.abs(source.frame(0).depth_mm.astype(int) - depth_mm).max() <= 1


@pytest.mark.parametrize("turn", [np.eye(3), random_rotation(1)])
def test_a_mirrored_grid_is_refused(tmp_path, turn):
    points = camera_points(room())[:, ::-1].reshape(-1, 3) @ turn.T
    content = pcd(points, *room().shape[::-1])
    path = write(tmp_path / "x.pcd", content)
    assert_refused(path, "mirror image of its coordinates; import it with --mirror", FormatError)
    source = CloudFile(path, ImportOptions(mirror=True))
    # As in the grid: who opens it mirrors image and camera back.
    assert np.abs(source.frame(0).depth_mm[:, ::-1].astype(int) - room()).max() <= 1
    camera = source.calibration.depth
    assert camera.width - 1 - camera.cx == pytest.approx(furnished_room.CAMERA.cx, abs=0.01)


@pytest.mark.parametrize("kind", ["ply", "las"])
def test_a_robots_cloud_is_seen_upright_from_in_front(tmp_path, kind):
    """ROS' base_link on the floor: x forward, z up. No camera stands there."""
    depth_mm = room(room=False, eye=(0.0, -2.4, 0.95))
    points = finite(camera_points(depth_mm)) @ CLOUD_FROM_CAMERA["ros"].T + [0, 0, 0.95]
    content = ply(points) if kind == "ply" else las(points, 0.0, False)
    source = open_source(write(tmp_path / f"x.{kind}", content))
    assert "ros axes" in source.notes[0] or "z-up axes" in source.notes[0]
    v, u = np.nonzero(source.frame(0).depth_mm)
    assert np.ptp(v) > 1.5 * np.ptp(u)


def test_a_las_of_a_cameras_cloud_is_no_map(tmp_path):
    depth_mm = room()
    points = finite(camera_points(depth_mm))
    source = open_source(write(tmp_path / "x.las", las(points, 0.0, False)))
    assert "camera axes left in place" in source.notes[0]
    found = source.frame(0).depth_mm
    assert np.count_nonzero(found) > 0.99 * len(points)
    assert np.median(found[found > 0]) == np.median(depth_mm[depth_mm > 0])


ROUGH = {
    "noise of 2 mm": lambda points, rng: points + rng.normal(0, 0.002, points.shape),
    "half of the points": lambda points, rng: points[rng.random(len(points)) < 0.5],
    "a tenth of them": lambda points, rng: points[rng.random(len(points)) < 0.1],
}


SHAPES = [("camera", False), ("kinect", False), ("ros", False), ("camera", True), ("kinect", True)]


@pytest.mark.parametrize(("axes", "upper"), SHAPES)
@pytest.mark.parametrize("name", ROUGH)
def test_rough_clouds_of_a_person_are_upright_and_whole(tmp_path, name, axes, upper):
    """Without floor, by the head; the depth image is that of the camera, within noise and spacing."""
    depth_mm = room(room=False)
    points = finite(camera_points(depth_mm))
    if upper:
        points = points[points[:, 1] < np.percentile(points[:, 1], 40)]
    points = ROUGH[name](points, np.random.default_rng(0))
    source = open_source(write(tmp_path / "x.ply", ply(points @ CLOUD_FROM_CAMERA[axes].T)))
    assert f"{axes} axes left in place" in source.notes[0]
    assert (source.pixels >= 0).mean() > 0.95
    camera, found = source.calibration.depth, source.frame(0).depth_mm
    v, u = np.nonzero(found)
    back = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], axis=-1)
    pixels = np.rint(project(furnished_room.CAMERA, back)).astype(int)
    inside = (pixels >= 0).all(axis=1) & (pixels < [320, 264]).all(axis=1)
    truth = depth_mm[pixels[inside, 1], pixels[inside, 0]]
    on = truth > 0
    assert on.mean() > 0.6  # its outline is wider by the points' spacing
    assert np.median(np.abs(found[v[inside], u[inside]][on].astype(int) - truth[on])) < 20


@pytest.mark.parametrize("axes", ["camera", "z-up"])
def test_stray_points_change_nothing(tmp_path, axes):
    """Flying pixels and broken numbers far outside move no camera."""
    points = finite(camera_points(room())) @ CLOUD_FROM_CAMERA[axes].T
    points = points if axes == "camera" else points - [0, 3, 0]  # the origin is within the room
    strays = np.array([[1e30, 0, 0], [0, -4e8, 1], [np.inf, 0, 0], [70.0, 80.0, 90.0]])
    options = AS_STATED if axes == "camera" else ImportOptions(axes=axes)
    plain = CloudFile(write(tmp_path / "a.ply", ply(points)), options)
    source = CloudFile(write(tmp_path / "b.ply", ply(np.concatenate([strays, points]))), options)
    np.testing.assert_array_equal(source.frame(0).depth_mm, plain.frame(0).depth_mm)
    np.testing.assert_array_equal(source.pixels, np.concatenate([[-1] * 4, plain.pixels]))


def test_what_shows_no_up_is_said(tmp_path):
    """A wall alone: y may point up as well."""
    u, v = np.meshgrid(np.arange(60), np.arange(50))
    wall = np.stack([(u - 30) * 0.013, (v - 25) * 0.017, 2.0 + 0.002 * u], axis=-1).reshape(-1, 3)
    source = open_source(write(tmp_path / "x.ply", ply(wall)))
    assert any("if the image is upside down: import it with --axes kinect" in note for note in source.notes)


def test_what_stays_open_is_asked_for(tmp_path):
    rng = np.random.default_rng(0)
    blob = write(tmp_path / "blob.ply", ply(rng.normal(0, 0.5, (4000, 3))))
    assert_refused(blob, r"import it with --axes: camera, y-up, ros, z-up, kinect", FormatError)
    assert "y-up axes" in CloudFile(blob, ImportOptions(axes="y-up")).notes[0]
    noise = np.array([0, 0, 150.0]) + rng.normal(0, 20, (4000, 3))
    cloud = write(tmp_path / "hand.ply", ply(noise))
    assert_refused(cloud, r"1\.5 m as centimetres.*import it with --depth-unit", FormatError)
    assert CloudFile(cloud, ImportOptions(depth_unit_mm=10)).frame(0).depth_mm.any()
    far = write(tmp_path / "far.ply", ply(finite(camera_points(room())) * 1000))
    with pytest.raises(FormatError, match=r"no point is within the 65\.534 m .* import it with --depth-unit"):
        CloudFile(far, ImportOptions(depth_unit_mm=1000))
    with pytest.raises(FormatError, match="axes 'up' are unknown; use camera"):
        CloudFile(blob, ImportOptions(axes="up"))


def test_a_declared_camera_is_used(tmp_path):
    depth_mm, camera = room(), furnished_room.CAMERA
    numbers = {
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "width": 320,
        "height": 264,
    }
    path = write(tmp_path / "i.json", json.dumps(numbers).encode())
    points = camera_points(depth_mm)
    for name, content in (
        ("x.ply", ply(finite(points))),
        ("x.pcd", pcd(points.reshape(-1, 3), 320, 264)),
    ):
        source = open_source(write(tmp_path / name, content), ImportOptions(intrinsics=path))
        assert source.calibration.depth == camera
        np.testing.assert_array_equal(source.frame(0).depth_mm, depth_mm)


@given(
    pinhole=st.tuples(st.floats(200, 700), st.floats(200, 700), st.floats(0, 1), st.floats(0, 1)),
    seed=st.integers(0, 99),
)
@law
def test_the_pixels_of_a_camera_are_found(pinhole, seed):
    """And noise of a millimetre at most does not hide them; noise alone has none."""
    fx, fy, cx, cy = pinhole
    rng = np.random.default_rng(seed)
    u, v, z = rng.integers(0, 300, 3000), rng.integers(0, 200, 3000), rng.uniform(1.5, 4, 3000)
    for focal, centre, pixel in ((fx, cx, u - 150), (fy, cy, v - 100)):
        line = find_line((pixel - centre) / focal)
        assert line.focal_px == pytest.approx(focal, rel=1e-6)
        assert (line.centre_px - centre + 0.5) % 1 == pytest.approx(0.5, abs=1e-4)
        rounded = find_line(np.round((pixel - centre) / focal * z, 3) / z)
        assert rounded is not None and rounded.focal_px == pytest.approx(focal, rel=1e-3)
    assert find_line(rng.uniform(-0.6, 0.6, 3000)) is None


# Fields, headers, comments


def padded(names: str, sizes: str, types: str, counts: str) -> dict[str, str]:
    return {"FIELDS": names, "SIZE": sizes, "TYPE": types, "COUNT": counts}


def test_padding_of_pcl_is_skipped(tmp_path):
    """PointXYZRGB as PCL writes it (isl-org/Open3D#6437): two fields called "_", other fields counted."""
    depth, points = organised()
    layout = [("xyz", "<f4", 3), ("a", "u1", 4), ("rgb", "<u4"), ("b", "u1", 12), ("h", "<f4", 5)]
    records = np.zeros(points.size // 3, layout)
    records["xyz"], records["a"], records["b"] = points.reshape(-1, 3), 255, 255
    records["rgb"] = np.arange(len(records)) % 200 + 1
    header = padded("x y z _ rgb _ h", "4 4 4 1 4 1 4", "F F F U F U F", "1 1 1 4 1 12 5")
    source = open_source(write(tmp_path / "x.pcd", pcd(points, 32, 24, records.tobytes(), **header)))
    np.testing.assert_array_equal(source.frame(0).depth_mm, depth)
    expected = np.where(depth > 0, records["rgb"].reshape(24, 32), 0)
    np.testing.assert_array_equal(source.frame(0).decode_color()[..., 2], expected)


HEADERS = {
    "umlauts": lambda content: b"# Punktwolke f\xc3\xbcr M.\n" + content,
    "latin-1": lambda content: b"# Punktwolke f\xfcr M.\n" + content,
    "columns": lambda content: content.replace(b"FIELDS", b"COLUMNS").replace(b"0.7", b".5"),
    "no points": lambda content: content.replace(b"POINTS 768\n", b""),
    "no count": lambda content: content.replace(b"COUNT 1 1 1\n", b""),
    "no size or type": lambda content: content.replace(b"SIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n", b""),
    "no viewpoint": lambda content: content.replace(b"VIEWPOINT 0 0 0 1 0 0 0\n", b""),
    "capitals": lambda content: content.replace(b"DATA binary", b"DATA BINARY"),
    "carriage returns": lambda content: (
        content[: content.index(b"DATA")].replace(b"\n", b"\r\n")
        + content[content.index(b"DATA") :].replace(b"binary\n", b"binary\r\n", 1)
    ),
}


@pytest.mark.parametrize("name", HEADERS)
def test_headers_that_pcl_accepts_are_read(tmp_path, name):
    depth, points = organised()
    source = open_source(write(tmp_path / "x.pcd", HEADERS[name](pcd(points, 32, 24))))
    np.testing.assert_array_equal(source.frame(0).depth_mm, depth)


@pytest.mark.parametrize("word", ["ascii", "ASCII"])
def test_a_text_cloud_with_nan_is_read(tmp_path, word):
    depth, points = organised()
    text = "\n".join(" ".join(f"{number:.6f}" for number in point) for point in points.reshape(-1, 3))
    assert "nan" in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        source = open_source(write(tmp_path / "x.pcd", pcd(points, 32, 24, text.encode(), DATA=word)))
        np.testing.assert_array_equal(source.frame(0).depth_mm, depth)
        spoilt = text.replace("nan", "none", 1).encode()
        assert_refused(write(tmp_path / "y.pcd", pcd(points, 32, 24, spoilt, DATA=word)), "not a number")


@pytest.mark.parametrize("kind", ["float", "unsigned", "rgba", "text"])
def test_packed_colours_are_those_of_pcl(tmp_path, kind):
    depth_mm = room()
    points = finite(camera_points(depth_mm)).astype(np.float32)
    colors = random_colors(len(points))
    header = {
        "float": {},
        "unsigned": {"TYPE": "F F F U"},
        "rgba": {"FIELDS": "x y z rgba", "TYPE": "F F F U"},
    }
    if kind == "text":
        red, green, blue = colors.astype(np.uint32).T
        packed = (red << 16 | green << 8 | blue).view(np.float32)
        lines = (f"{x:.9g} {y:.9g} {z:.9g} {c:.9g}" for (x, y, z), c in zip(points, packed, strict=True))
        text = "\n".join(lines).encode()
        fields = padded("x y z rgb", "4 4 4 4", "F F F F", "1 1 1 1")
        content = pcd(points, len(points), 1, text, DATA="ascii", **fields)
    else:
        content = colored_pcd(points, colors, **header[kind])
    assert_is_the_room(open_source(write(tmp_path / "x.pcd", content)), depth_mm, colors)


@pytest.mark.parametrize("bits", [8, 16])
def test_colours_of_las_have_8_or_16_bits(tmp_path, bits):
    laspy = pytest.importorskip("laspy")
    points = finite(camera_points(room()))
    colors = random_colors(len(points))
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, 1e-6)
    cloud = laspy.LasData(header)
    cloud.xyz = points
    cloud.red, cloud.green, cloud.blue = colors.astype(np.uint16).T * (257 if bits == 16 else 1)
    cloud.write(str(tmp_path / "x.las"))
    assert_is_the_room(open_source(tmp_path / "x.las"), room(), colors)


def test_a_mesh_gives_its_corners_and_says_so(tmp_path):
    depth_mm = room()
    points = finite(camera_points(depth_mm))
    face = b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    faces = "element face 2\nproperty list uchar int vertex_indices\n"
    before = ply(points, extra=faces).replace(b"end_header\n", b"end_header\n" + face * 2)
    after = ply(points).replace(b"end_header", faces.encode() + b"end_header") + face * 2
    for content in (before, after):
        source = open_source(write(tmp_path / "x.ply", content))
        assert_is_the_room(source, depth_mm)
        assert "a mesh: of its 2 faces only the corners are read" in source.notes


def test_lists_of_any_length_are_passed_over(tmp_path):
    points = np.random.default_rng(0).uniform(1, 2, (5, 3))
    for order, byte_order in (("<", "little"), (">", "big")):
        rows = b""
        for number, point in enumerate(points):
            extra = np.arange(number, dtype=f"{order}i2").tobytes()
            rows += point.astype(f"{order}f8").tobytes() + bytes([number]) + extra
        head = f"ply\nformat binary_{byte_order}_endian 1.0\nelement vertex 5\n"
        head += (
            "".join(f"property double {axis}\n" for axis in "xyz")
            + "property list uchar short k\nend_header\n"
        )
        cloud = read_ply(write(tmp_path / "x.ply", head.encode() + rows))
        np.testing.assert_array_equal(cloud.points(), points)
        with pytest.raises(FormatError, match="cut off"):
            read_ply(write(tmp_path / "x.ply", head.encode() + rows[:-1]))
    text = "".join(f"{x!r} {y!r} {z!r} {n} {'7 ' * n}\n" for n, (x, y, z) in enumerate(points.tolist()))
    head = head.replace("binary_big_endian", "ascii")
    np.testing.assert_array_equal(
        read_ply(write(tmp_path / "x.ply", (head + text).encode())).points(), points
    )


def test_open3d_writes_what_is_read(tmp_path):
    o3d = pytest.importorskip("open3d")
    _, points = organised()
    flat = points.reshape(-1, 3)
    cloud = o3d.t.geometry.PointCloud(flat)
    cloud.point.colors = o3d.core.Tensor(random_colors(len(flat)))
    for suffix, options in product(("pcd", "ply"), ({}, {"write_ascii": True}, {"compressed": True})):
        path = tmp_path / f"x.{suffix}"
        o3d.t.io.write_point_cloud(str(path), cloud, **options)
        found = (read_pcd if suffix == "pcd" else read_ply)(path)
        np.testing.assert_allclose(found.points(), flat, atol=1e-5)
        np.testing.assert_array_equal(found.colors(), cloud.point.colors.numpy())


def test_a_compressed_cloud_is_read_and_refused_where_it_is_damaged(tmp_path):
    o3d = pytest.importorskip("open3d")
    path, cloud = tmp_path / "x.pcd", o3d.t.geometry.PointCloud(ball(500).astype(np.float32))
    o3d.t.io.write_point_cloud(str(path), cloud, compressed=True)
    assert next(iter(open_source(path))).depth_mm.any()
    content = path.read_bytes()
    assert_refused(write(path, content[:-1000]), "is cut off", FormatError)
    rng, at = np.random.default_rng(0), content.index(b"compressed\n") + 19
    for _ in range(25):
        spoilt = bytearray(content)
        spoilt[rng.integers(at, len(content))] ^= rng.integers(1, 256)
        try:
            read_pcd(write(path, bytes(spoilt)))
        except FormatError as error:
            assert "\n" not in str(error)


# Organised clouds and projection


def test_an_organised_cloud_is_its_depth_image(tmp_path):
    depth, points = organised()
    source = open_source(write(tmp_path / "grid.pcd", pcd(points, 32, 24)))
    np.testing.assert_array_equal(source.frame(0).depth_mm, depth)
    np.testing.assert_allclose(source.calibration.depth.matrix, CAMERA.matrix, atol=1e-3)
    assert any("residual" in note for note in source.notes)
    assert {"no colour images", "no thermal images"} <= set(source.notes)
    np.testing.assert_array_equal(source.pixels, np.where(depth.ravel() > 0, np.arange(depth.size), -1))


@given(
    pinhole=st.tuples(st.floats(20, 60), st.floats(20, 60), st.floats(5, 25), st.floats(5, 20)),
    seed=st.integers(0, 99),
)
@law
def test_the_fit_finds_the_camera(pinhole, seed):
    camera = Intrinsics(32, 24, *pinhole)
    depth = np.random.default_rng(seed).uniform(0.5, 4.5, camera.shape)
    found = grid_camera("cloud", unproject(camera, depth).astype(np.float64), None)
    np.testing.assert_allclose(found.intrinsics.matrix, camera.matrix, rtol=1e-4, atol=1e-4)
    assert found.residual_px < 1e-3 and found.how == "camera axes"


def test_a_grid_that_is_no_image_is_refused(tmp_path):
    content = pcd(np.random.default_rng(0).uniform(1, 2, (24, 32, 3)), 32, 24)
    assert_refused(write(tmp_path / "grid.pcd", content), "not a pinhole image|fits no camera", FormatError)


def ball(n: int = 20_000) -> np.ndarray:
    """A ball of 0.3 m radius about (0.1, 0.2, 2) in camera axes."""
    directions = np.random.default_rng(0).normal(size=(n, 3))
    return 0.3 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [0.1, 0.2, 2.0]


@pytest.mark.parametrize("axes", CLOUD_FROM_CAMERA)
def test_a_cloud_without_pixels_is_the_same_in_any_axes(tmp_path, axes):
    points = ball()
    path = write(tmp_path / "ball.pcd", pcd(points @ CLOUD_FROM_CAMERA[axes].T, len(points), 1))
    depth_mm = CloudFile(path, ImportOptions(axes=axes)).frame(0).depth_mm
    v, u = np.unravel_index(np.where(depth_mm > 0, depth_mm, 9999).argmin(), depth_mm.shape)
    expected = project(KINECT_V2, np.array([0.1, 0.2, 2.0]) * (1 - 0.3 / np.linalg.norm([0.1, 0.2, 2.0])))
    assert depth_mm[v, u] == pytest.approx(1700, abs=4)
    np.testing.assert_allclose([u, v], expected, atol=12)
    if axes != "kinect":  # a ball has no feet
        np.testing.assert_array_equal(CloudFile(path).frame(0).depth_mm, depth_mm)


def test_a_ball_hides_its_far_side_and_has_no_holes():
    points = ball(60_000)
    shown = project_cloud(points, KINECT_V2, 0.01)
    depth = np.where(shown >= 0, points[shown, 2], np.nan)
    assert np.nanmax(depth) < 2.06
    centre = project(KINECT_V2, np.array([0.1, 0.2, 2.0]))
    inside = np.hypot(*(np.indices(depth.shape)[::-1] - centre[:, None, None])) < 0.95 * 365.15 * 0.3 / 2
    assert np.isfinite(depth[inside]).all()
    assert np.isfinite(depth).sum() < 1.15 * np.pi * (365.15 * 0.3 / 2) ** 2


def test_the_nearest_point_is_shown_wherever_it_stands_in_the_file():
    """Against the naive loop."""
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 3], (3000, 3))
    camera = Intrinsics(20, 20, 10.0, 10.0, 9.5, 9.5)
    depth = np.full(camera.shape, np.inf)
    for x, y, z in points:
        u, v = round(10 * x / z + 9.5), round(10 * y / z + 9.5)
        if 0 <= u < 20 and 0 <= v < 20:
            depth[v, u] = min(depth[v, u], z)
    shown = project_cloud(points, camera, 0.0)
    np.testing.assert_array_equal(np.where(shown >= 0, points[shown, 2], np.inf), depth)


def test_points_behind_what_is_seen_have_no_pixel():
    points = np.array([[0, 0, 2.0], [0, 0, 2.02], [0, 0, 2.2], [0, 0, -1.0], [9, 9, 1.0], [np.nan, 0, 1]])
    depth = np.full(KINECT_V2.shape, np.nan)
    depth[211, 254] = 2.0
    pixels = cloud_view.pixels_of(points, KINECT_V2, depth)
    np.testing.assert_array_equal(pixels >= 0, [True, True, False, False, False, False])


@given(points=arrays(np.float64, (30, 3), elements=st.floats(-50, 50)))
@law
def test_any_cloud_is_moved_into_view(points):
    pixels = project(KINECT_V2, points + shift_into_view(points, KINECT_V2))
    assert (pixels >= -1e-6).all()
    assert (pixels <= np.array([KINECT_V2.width, KINECT_V2.height]) - 1 + 1e-6).all()


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_that_is_cut_off_is_refused(tmp_path, kind):
    points = np.c_[ball(500), np.ones((500, 3))]
    names = "".join(f"property float {a}\n" for a in ("x", "y", "z", "nx", "ny", "nz"))
    head = f"ply\nformat {kind} 1.0\nelement vertex 500\n{names}end_header\n".encode()
    text = "\n".join(" ".join(f"{x:.6f}" for x in p) for p in points)
    body = text.encode() if kind == "ascii" else points.astype("<f4" if "little" in kind else ">f4").tobytes()
    path = write(tmp_path / "x.ply", head + body)
    np.testing.assert_allclose(read_ply(path).points(), points[:, :3], atol=1e-6)
    for cut in (9, len(body) // 3):
        assert_refused(write(path, head + body[: -cut - 1]), "500 points", FormatError)


def test_clouds_are_read_up_to_their_bound(tmp_path, monkeypatch):
    path = write(tmp_path / "x.pcd", pcd(GRID, 32, 24))
    monkeypatch.setattr(pcd_file, "MAX_POINTS", 32 * 24)
    assert read_pcd(path).grid == (24, 32)
    monkeypatch.setattr(pcd_file, "MAX_POINTS", 32 * 24 - 1)
    with pytest.raises(FormatError, match="768 points; 1 to 767 are read"):
        read_pcd(path)


def test_equal_points_change_no_spacing(monkeypatch):
    """A tree looks at all of many equal points, for every point."""
    points = ball(500)
    spacing = cloud_view.spacing_m(points)
    assert cloud_view.spacing_m(np.repeat(points, 7, axis=0)) == spacing
    np.testing.assert_array_equal(cloud_view._distinct(np.concatenate([points, points[::-1]])), points)
    monkeypatch.setattr(cloud_view, "Nearest", lambda _: pytest.fail("nothing to look for"))
    assert cloud_view.spacing_m(np.ones((9, 3)) + 1e-12 * np.arange(9)[:, None]) == 0


GRID = organised()[1]
BROKEN = {
    "empty": b"",
    "no header's end": b"VERSION 0.7\nFIELDS x y z",
    "too many points": pcd(GRID, 10**5, 10**4),
    "more points than bytes": pcd(GRID, 33, 24),
    "sizes contradict": pcd(GRID, 32, 24, POINTS="7"),
    "negative": pcd(GRID, -32, -24),
    "no points": pcd(GRID[:0], 0, 1),
    "text as size": pcd(GRID, 32, 24, SIZE="4 4 x"),
    "odd fields": pcd(GRID, 32, 24, FIELDS="x y"),
    "no z": pcd(GRID, 32, 24, FIELDS="x y w"),
    "integers": pcd(GRID, 32, 24, TYPE="I I I"),
    "huge count": pcd(GRID, 32, 24, COUNT="1 1 999999999"),
    "bomb": pcd(GRID, 32, 24, DATA="binary_compressed"),
    "unknown data": pcd(GRID, 32, 24, DATA="../../etc/passwd"),
    "all NaN": pcd(GRID * np.nan, 32, 24),
    "long line": b"#" * 10_000,
    "many lines": b"# x\n" * 10_000,
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_clouds_are_refused(tmp_path, name):
    assert_refused(write(tmp_path / "x.pcd", BROKEN[name]), kind=FormatError)


@given(data=st.data())
@law
def test_a_flipped_cloud_is_an_error_or_a_frame(tmp_path, data):
    suffix, content = data.draw(st.sampled_from([("pcd", pcd(GRID, 32, 24)), ("ply", ply(finite(GRID)))]))
    spoilt = bytearray(content)
    for _ in range(data.draw(st.integers(1, 3))):
        spoilt[data.draw(st.integers(0, 250))] = data.draw(st.integers(0, 255))
    path = write(tmp_path / f"x.{suffix}", bytes(spoilt))
    try:
        frames = list(open_source(path))
    except CloudError as error:
        assert "\n" not in str(error)
    else:
        assert len(frames) == 1


# Real recordings, and files as other programs write them


def test_the_real_organised_cloud(shared_data):
    source = open_source(shared_data / "pcl_person" / "person.pcd")
    camera = source.calibration.depth
    assert camera.shape == (480, 640)
    pinhole = [camera.fx, camera.fy, camera.cx, camera.cy]
    np.testing.assert_allclose(pinhole, [525, 525, 319.5, 239.5], atol=1e-3)
    depth = source.frame(0).depth_mm
    assert depth[depth > 0].min() == 607
    assert depth.max() == 3779


def test_the_real_camera_is_found_without_its_grid(shared_data, tmp_path):
    points = read_pcd(shared_data / "pcl_person" / "person.pcd").points()
    kept = finite(points)
    source = open_source(write(tmp_path / "x.ply", ply(kept)))
    camera = source.calibration.depth
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx % 1, camera.cy % 1], [525, 525, 0.5, 0.5], atol=1e-3
    )
    assert (source.pixels >= 0).all() and np.count_nonzero(source.frame(0).depth_mm) == len(kept)


@pytest.mark.parametrize("name", ["20190823_020756", "20190823_030127"])
def test_the_real_standing_person(shared_data, name):
    source = open_source(shared_data / "kinect2_standing" / f"{name}.pcd")
    assert source.calibration.depth.fx == KINECT_V2.fx and "y-up axes left in place" in source.notes[0]
    depth = source.frame(0).depth_mm
    v, u = np.nonzero(depth)
    assert 0 < v.min() < v.max() < depth.shape[0]
    assert 0 < u.min() < u.max() < depth.shape[1]
    assert np.ptp(v) > 1.5 * np.ptp(u)  # upright
    nearest = -read_pcd(source.path).points()[:, 2].max()
    assert depth[v, u].min() == pytest.approx(1000 * nearest, abs=2)


def test_files_of_others_are_read(shared_data):
    for name in ("pcd_padding_twice", "pcd_utf8_comment", "pcd_viewpoint_world_unorganised"):
        depth = open_source(shared_data / "others_files" / f"{name}.pcd").frame(0).depth_mm
        assert np.count_nonzero(depth) == 48 * 64 and 1700 <= depth[depth > 0].min() < depth.max() <= 2300
    source = open_source(shared_data / "others_files" / "ply_millimetres.ply")
    depth = source.frame(0).depth_mm
    assert np.count_nonzero(depth) == 48 * 64 and 1700 <= depth[depth > 0].min() < depth.max() <= 2300


def test_the_calibration_has_a_colour_camera_only_where_there_is_colour(tmp_path):
    points = finite(camera_points(room()))
    plain = open_source(write(tmp_path / "a.ply", ply(points)))
    assert (
        plain.calibration == RigCalibration(plain.calibration.depth) and plain.frame(0).color_encoded is None
    )
    black = open_source(write(tmp_path / "b.ply", ply(points, np.zeros_like(points, np.uint8))))
    assert "no colour images" in black.notes
    colored = open_source(write(tmp_path / "c.ply", ply(points, random_colors(len(points)))))
    assert colored.calibration.color == colored.calibration.depth
    assert pointcloud.CloudFile is type(colored)


def person(seed: int) -> np.ndarray:
    """A seated or standing person cut out of a room, camera axes (n, 3)."""
    depth_mm = room(room=False)
    points = finite(camera_points(depth_mm))
    if seed == 0:  # upright, whole
        return points
    if seed == 1:  # one leg in view: the lower end is narrower than the head
        low = points[:, 1] > np.percentile(points[:, 1], 55)
        return points[~low | (points[:, 0] > np.median(points[low, 0]) + 0.02)]
    if seed == 2:  # an arm held up beside the head: the upper end is broad
        top = points[:, 1].min()
        arm = np.stack(np.meshgrid(np.linspace(0.25, 0.35, 20), np.linspace(top, top + 0.6, 80)), -1)
        return np.concatenate([points, np.insert(arm.reshape(-1, 2), 2, np.median(points[:, 2]), axis=1)])
    return points @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # lying


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gone", [1.0, 0.3])
def test_a_person_alone_is_not_turned_upside_down(tmp_path, seed, gone):
    """Cameras' axes stand, unless a head with shoulders is at the lower end."""
    points = person(seed)
    points = points[np.random.default_rng(0).random(len(points)) < gone]
    source = open_source(write(tmp_path / "x.ply", ply(points)))
    assert "camera axes left in place" in source.notes[0]


def test_what_a_head_turned_is_said_and_can_be_taken_back(tmp_path):
    path = write(tmp_path / "x.ply", ply(person(0) @ CLOUD_FROM_CAMERA["kinect"].T))
    notes = open_source(path).notes
    assert any("upside down: import it with --axes camera" in note for note in notes)
    assert any(
        "where it points right (Unity), left and right are mirrored: import it with --mirror" in note
        for note in notes
    )
    assert "camera axes" in CloudFile(path, ImportOptions(axes="camera")).notes[0]


@pytest.mark.parametrize("axes", ["y-up", "z-up"])
def test_a_lying_person_above_the_origin_is_seen_by_no_camera_there(tmp_path, axes):
    """A body on its own floor: its axes stay open, or are right where they are declared."""
    lying = person(3)
    level = (lying - np.median(lying, axis=0)) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) - [0, 0.8, 0]
    path = write(tmp_path / "x.ply", ply(level @ CLOUD_FROM_CAMERA[axes].T))
    assert_refused(path, r"import it with --axes: camera, y-up", FormatError)
    assert CloudFile(path, ImportOptions(axes=axes)).frame(0).depth_mm.any()


@pytest.mark.parametrize("kind", ["float", "double"])
def test_coordinates_far_away_are_those_of_a_map(tmp_path, kind):
    """UTM: z is up in any format; floats are too coarse, which a note states."""
    origin = np.array([612345.5, 5412345.25, 432.1])
    points = finite(camera_points(room())) @ CLOUD_FROM_CAMERA["z-up"].T + [0, 0, 1.4]
    notes = open_source(write(tmp_path / "x.ply", ply(points + origin, kind=kind))).notes
    assert "z-up axes" in notes[0]
    assert any("32-bit coordinates are 0.5 m apart" in note for note in notes) == (kind == "float")


def test_names_of_colours_and_splats(tmp_path):
    points = finite(camera_points(room()))
    rgb = random_colors(len(points))
    content = ply(points, rgb)
    for name in (b"red", b"green", b"blue"):
        content = content.replace(b" " + name + b"\n", b" " + name.capitalize() + b"\n")
    path = write(tmp_path / "x.ply", content)
    np.testing.assert_array_equal(read_ply(path).colors(), rgb)
    splats = ply(points, rgb)
    for name, field in ((b"red", b"opacity"), (b"green", b"scale_0"), (b"blue", b"rot_0")):
        splats = splats.replace(b" " + name + b"\n", b" " + field + b"\n")
    notes = open_source(write(tmp_path / "y.ply", splats)).notes
    assert "Gaussian splats: only their centres are read, without colours" in notes
