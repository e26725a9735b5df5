"""Folders and point clouds become frames, say what they lack, and are refused in one line when broken."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sensors.errors import CalibrationError, CloudError, FormatError
from sensors.files.flir_jpeg import read_flir
from sensors.importers import cloud_header, pointcloud
from sensors.importers.cloud_header import read_header
from sensors.importers.open_source import open_source
from sensors.importers.pointcloud import KINECT_V2, CloudFile, fit_intrinsics, project_cloud, shift_into_view
from sensors.rig.camera import Intrinsics, project, unproject
from sensors.rig.rig_calibration import Pose, RigCalibration, save_calibration
from sensors.session.messages import thermal_from_uint16
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from tests.helpers.depth_files import CAMERA, NUMBERS, assert_refused, depth_image, png, write

law = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def folder(tmp_path) -> Path:
    path = tmp_path / "person"
    for i in range(3):
        write(path / "depth" / f"{i:03}.png", png(depth_image(i)))
    (path / "intrinsics.json").write_text(json.dumps(NUMBERS))
    return path


# Folders


def test_a_folder_of_depth_is_a_source(folder):
    source = open_source(folder)
    assert (source.name, len(source), source.calibration) == ("person", 3, RigCalibration(CAMERA))
    for i, frame in enumerate(source):
        assert frame.index == i
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        assert frame.color_encoded is None
        assert frame.thermal_c is None
    assert {"no colour images", "no thermal images"} <= set(source.notes)


def test_a_flir_jpeg_gives_temperatures(folder, monkeypatch):
    """By the calls of flyr that its documentation names; no camera's file has been read."""
    write(folder / "thermal" / "001.jpg", b"a FLIR camera's")
    source = open_source(folder)
    monkeypatch.setitem(sys.modules, "flyr", None)
    with pytest.raises(FormatError, match=r"001\.jpg needs flyr"):
        list(source)

    def unpack(file):
        if file.read() != b"a FLIR camera's":
            raise ValueError("no FFF chunk")
        return SimpleNamespace(celsius=np.full((6, 8), 31.5), optical=None)

    monkeypatch.setitem(sys.modules, "flyr", SimpleNamespace(unpack=unpack))
    thermal = list(source)[1].thermal_c
    assert thermal.dtype == np.float32 and (thermal == 31.5).all()
    with pytest.raises(FormatError, match="holds no temperatures"):
        read_flir(b"holiday", "001.jpg")


def test_colour_and_thermal_belong_by_name(folder):
    values = np.arange(48, dtype=np.uint16).reshape(6, 8) * 700
    write(folder / "thermal" / "001.png", png(values))
    write(folder / "color" / "002.png", png(np.zeros((4, 4, 3), np.uint8)))
    (folder / "color" / "notes.txt").write_text("not an image")
    (folder / "intrinsics.json").unlink()
    small, pose = Intrinsics(8, 6, 9, 9, 3.5, 2.5), Pose.identity()
    rig = RigCalibration(CAMERA, thermal=small, thermal_from_depth=pose)
    save_calibration(folder / "calibration.json", rig)
    source = open_source(folder)
    first, second, third = source
    assert (first.thermal_c, first.color_encoded, second.color_encoded) == (None, None, None)
    np.testing.assert_array_equal(second.thermal_c, thermal_from_uint16(values))
    assert third.color_encoded == (folder / "color" / "002.png").read_bytes()
    assert "2 of 3 frames have no colour image" in source.notes
    assert any("no calibration of the colour camera" in note for note in source.notes)


@pytest.mark.parametrize("name", ["{:03}.depth.png", "{:03}.png"])
def test_depth_may_lie_in_the_folder_itself(tmp_path, name):
    for i in range(2):
        write(tmp_path / name.format(i), png(depth_image(i)))
    (tmp_path / "intrinsics.json").write_text(json.dumps(NUMBERS))
    assert [f.depth_mm.sum() for f in open_source(tmp_path)] == [depth_image(i).sum() for i in range(2)]


def test_depth_steps_become_millimetres(folder):
    (folder / "intrinsics.json").write_text(json.dumps({**NUMBERS, "depth_unit_mm": 20}))
    frame = next(iter(open_source(folder)))
    expected = depth_image(0).astype(int) * 20
    np.testing.assert_array_equal(frame.depth_mm, np.where(expected > 65535, 0, expected))


def test_missing_intrinsics_say_what_to_add(folder):
    (folder / "intrinsics.json").unlink()
    needed = '"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": 32, "height": 24'
    assert_refused(folder, f"{folder / 'intrinsics.json'} holding {{{needed}", CalibrationError)


WRONG = [
    *({"fx": "30"}, {"fx": True}, {"fx": -1}, {"cx": float("nan")}, {"width": 10**9}, {"rolling": 1}),
    *({"depth_unit_mm": 0}, {"width": 33}),
]


@pytest.mark.parametrize(
    "content",
    ["{", "[" * 100_000, "[]", "{}", " " * 1_000_001, *(json.dumps({**NUMBERS, **w}) for w in WRONG)],
)
def test_bad_intrinsics_are_refused(folder, content):
    (folder / "intrinsics.json").write_text(content)
    assert_refused(folder)


def test_bad_images_are_refused(folder):
    good = (folder / "depth" / "000.png").read_bytes()
    for image, match in (
        (b"", "not a PNG"),
        (good[:60], "nothing readable|cut off"),
        (png(depth_image().astype(np.uint8)), "uint8"),
        (png(np.zeros((24, 32, 3), np.uint16)), r"\(24, 32, 3\)"),
        (good[:16] + (10**6).to_bytes(4, "big") + good[20:], "1000000x24"),
    ):
        write(folder / "depth" / "000.png", image)
        assert_refused(folder, match, FormatError)
    write(folder / "color" / "frame7.png", png(np.zeros((4, 4, 3), np.uint8)))
    assert_refused(folder, "named like a depth image", FormatError)


def test_what_is_no_source_is_refused(tmp_path):
    write(tmp_path / "a.txt", b"hello")
    (tmp_path / "empty").mkdir()
    for name, match in (
        ("a.txt", "no known kind"),
        ("b.mcap", "does not exist"),
        ("empty", "no depth images"),
    ):
        assert_refused(tmp_path / name, match, FormatError)


def test_whatever_is_imported_can_be_recorded(folder, tmp_path):
    source = open_source(folder)
    with SessionWriter(tmp_path / "x.mcap", source.calibration, source.name) as writer:
        for frame in source:
            writer.write(frame)
    session = open_source(tmp_path / "x.mcap")
    assert isinstance(session, Session)
    for a, b in zip(source, session, strict=True):
        assert (a.index, a.stamp_ns) == (b.index, b.stamp_ns)
        np.testing.assert_array_equal(a.depth_mm, b.depth_mm)


# Point clouds


def pcd(points: np.ndarray, width: int, height: int, **header: str) -> bytes:
    fields = {"VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1"}
    fields |= {"WIDTH": str(width), "HEIGHT": str(height), "VIEWPOINT": "0 0 0 1 0 0 0"}
    fields |= {"POINTS": str(width * height), "DATA": "binary", **header}
    text = "".join(f"{key} {value}\n" for key, value in fields.items())
    return text.encode() + points.astype("<f4").tobytes()


def organised(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Depth (24, 32) in mm and the organised cloud (24, 32, 3) that the camera sees of it."""
    depth = np.random.default_rng(seed).integers(500, 4500, (24, 32)).astype(np.uint16)
    depth[::5, ::3] = 0
    metres = np.where(depth > 0, depth / 1000, np.nan).astype(np.float32)
    return depth, unproject(CAMERA, metres)


def test_an_organised_cloud_is_its_depth_image(tmp_path):
    depth, points = organised()
    source = open_source(write(tmp_path / "grid.pcd", pcd(points, 32, 24)))
    frame = next(iter(source))
    np.testing.assert_array_equal(frame.depth_mm, depth)
    fitted = source.calibration.depth
    np.testing.assert_allclose(fitted.matrix, CAMERA.matrix, atol=1e-3)
    assert any("residual" in note for note in source.notes)
    assert {"no colour images", "no thermal images"} <= set(source.notes)


@given(
    pinhole=st.tuples(st.floats(20, 60), st.floats(20, 60), st.floats(5, 25), st.floats(5, 20)),
    seed=st.integers(0, 99),
)
@law
def test_the_fit_finds_the_camera(pinhole, seed):
    camera = Intrinsics(32, 24, *pinhole)
    depth = np.random.default_rng(seed).uniform(0.5, 4.5, camera.shape)
    fitted, residual = fit_intrinsics(unproject(camera, depth).astype(np.float64))
    np.testing.assert_allclose(fitted.matrix, camera.matrix, rtol=1e-4, atol=1e-4)
    assert residual < 1e-3


def test_a_grid_that_is_no_image_is_refused(tmp_path):
    content = pcd(np.random.default_rng(0).uniform(1, 2, (24, 32, 3)), 32, 24)
    assert_refused(write(tmp_path / "grid.pcd", content), "not a pinhole image|fits no camera", FormatError)


def ball(n: int = 20_000) -> np.ndarray:
    """A ball of 0.3 m radius about (0.1, 0.2, 2) in camera axes."""
    directions = np.random.default_rng(0).normal(size=(n, 3))
    return 0.3 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [0.1, 0.2, 2.0]


AXES = {
    "camera": np.eye(3),
    "y-up": np.diag([1.0, -1.0, -1.0]),
    "z-up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


@pytest.mark.parametrize("axes", AXES)
def test_a_cloud_is_the_same_in_any_axes(tmp_path, axes):
    points = ball()
    path = write(tmp_path / "ball.pcd", pcd(points @ AXES[axes].T, len(points), 1))
    depth_mm = next(iter(CloudFile(path, axes))).depth_mm  # type: ignore[arg-type]
    v, u = np.unravel_index(np.where(depth_mm > 0, depth_mm, 9999).argmin(), depth_mm.shape)
    expected = project(KINECT_V2, np.array([0.1, 0.2, 2.0]) * (1 - 0.3 / np.linalg.norm([0.1, 0.2, 2.0])))
    assert depth_mm[v, u] == pytest.approx(1700, abs=4)
    np.testing.assert_allclose([u, v], expected, atol=12)
    if axes != "z-up":  # the others are recognised
        np.testing.assert_array_equal(next(iter(CloudFile(path))).depth_mm, depth_mm)


def test_a_ball_hides_its_far_side_and_has_no_holes():
    depth = project_cloud(ball(60_000), KINECT_V2, spacing_m=0.01)
    assert np.nanmax(depth) < 2.06
    centre = project(KINECT_V2, np.array([0.1, 0.2, 2.0]))
    inside = np.hypot(*(np.indices(depth.shape)[::-1] - centre[:, None, None])) < 0.95 * 365.15 * 0.3 / 2
    assert np.isfinite(depth[inside]).all()
    assert np.isfinite(depth).sum() < 1.15 * np.pi * (365.15 * 0.3 / 2) ** 2


@given(points=arrays(np.float64, (30, 3), elements=st.floats(-50, 50)))
@law
def test_any_cloud_is_moved_into_view(points):
    pixels = project(KINECT_V2, points + shift_into_view(points, KINECT_V2))
    assert (pixels >= -1e-6).all()
    assert (pixels <= np.array([KINECT_V2.width, KINECT_V2.height]) - 1 + 1e-6).all()


def test_a_cloud_in_view_is_not_moved():
    assert not shift_into_view(ball(), KINECT_V2).any()
    assert shift_into_view(ball() * [9, 1, 1], KINECT_V2).any()


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_ply_is_read(tmp_path, kind):
    points = ball(500)
    path = tmp_path / "ball.ply"
    head = f"ply\nformat {kind} 1.0\nelement vertex 500\n" + "".join(f"property float {a}\n" for a in "xyz")
    text = "\n".join(" ".join(f"{x:.6f}" for x in p) for p in points) + "\n"
    body = text.encode() if kind == "ascii" else points.astype("<f4").tobytes()
    frame = next(iter(open_source(write(path, head.encode() + b"end_header\n" + body))))
    assert frame.depth_mm.shape == KINECT_V2.shape
    assert frame.depth_mm[frame.depth_mm > 0].min() == pytest.approx(1700, abs=20)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_that_is_cut_off_is_refused(tmp_path, kind):
    points = np.c_[ball(500), np.ones((500, 3))]
    names = "".join(f"property float {a}\n" for a in ("x", "y", "z", "nx", "ny", "nz"))
    head = f"ply\nformat {kind} 1.0\nelement vertex 500\n{names}end_header\n".encode()
    text = "\n".join(" ".join(f"{x:.0f}" for x in p) for p in points)
    body = text.encode() if kind == "ascii" else points.astype("<f4" if "little" in kind else ">f4").tobytes()
    path = tmp_path / "x.ply"
    path.write_bytes(head + body)
    assert read_header(path).points == len(pointcloud._read_points(path, read_header(path))) == 500
    for cut in (2, len(body) // 3):
        assert_refused(write(path, head + body[: -cut - 1]), "500 points", FormatError)


def test_a_compressed_cloud_is_read_and_refused_where_it_is_cut_off(tmp_path):
    import open3d as o3d

    path, cloud = tmp_path / "x.pcd", o3d.t.geometry.PointCloud(ball(500).astype(np.float32))
    o3d.t.io.write_point_cloud(str(path), cloud, compressed=True)
    assert next(iter(open_source(path))).depth_mm.any()
    assert_refused(write(path, path.read_bytes()[:-1000]), "cannot be read", FormatError)


def test_clouds_are_read_up_to_their_bound(tmp_path, monkeypatch):
    path = write(tmp_path / "x.pcd", pcd(GRID, 32, 24))
    monkeypatch.setattr(cloud_header, "MAX_POINTS", 32 * 24)
    assert read_header(path).shape == (24, 32)
    monkeypatch.setattr(cloud_header, "MAX_POINTS", 32 * 24 - 1)
    with pytest.raises(FormatError, match="768 points; 1 to 767 are read"):
        read_header(path)


def test_equal_points_change_no_spacing(monkeypatch):
    """A tree looks at all of many equal points, for every point."""
    points = ball(500)
    spacing = pointcloud._spacing(points)
    assert pointcloud._spacing(np.repeat(points, 7, axis=0)) == spacing
    np.testing.assert_array_equal(pointcloud._distinct(np.concatenate([points, points[::-1]])), points)
    monkeypatch.setattr(pointcloud, "Nearest", lambda _: pytest.fail("nothing to look for"))
    assert pointcloud._spacing(np.ones((9, 3)) + 1e-12 * np.arange(9)[:, None]) == 0


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
    content = bytearray(pcd(GRID, 32, 24))
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, 250))] = data.draw(st.integers(0, 255))
    path = write(tmp_path / "x.pcd", content)
    try:
        frames = list(open_source(path))
    except CloudError as error:
        assert "\n" not in str(error)
    else:
        assert len(frames) == 1


# Real recordings


def test_the_real_organised_cloud(shared_data):
    source = open_source(shared_data / "pcl_person" / "person.pcd")
    camera = source.calibration.depth
    assert camera.shape == (480, 640)
    pinhole = [camera.fx, camera.fy, camera.cx, camera.cy]
    np.testing.assert_allclose(pinhole, [525, 525, 319.5, 239.5], atol=1e-3)
    depth = next(iter(source)).depth_mm
    assert depth[depth > 0].min() == 607
    assert depth.max() == 3779


@pytest.mark.parametrize("name", ["20190823_020756", "20190823_030127"])
def test_the_real_standing_person(shared_data, name):
    source = open_source(shared_data / "kinect2_standing" / f"{name}.pcd")
    assert source.calibration == RigCalibration(KINECT_V2)
    depth = next(iter(source)).depth_mm
    v, u = np.nonzero(depth)
    assert 0 < v.min() < v.max() < 423
    assert 0 < u.min() < u.max() < 511
    assert np.ptp(v) > 1.5 * np.ptp(u)  # upright
    assert 1500 < depth[v, u].min() < depth.max() < 2700
