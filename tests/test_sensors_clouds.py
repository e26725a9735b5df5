"""Point clouds become depth images: camera, axes and unit are found in the points, or asked for."""

import json
from itertools import product

import numpy as np
import pytest

from sensors.errors import FormatError
from sensors.importers.clouds.cloud_source import CloudFile
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.projection import KINECT_V2
from sensors.importers.open_source import open_source
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import project
from sensors.rig.rig_calibration import RigCalibration, quaternion_of
from tests.helpers import furnished_room
from tests.helpers.cloud_files import (
    CLOUD_FROM_CAMERA,
    assert_is_the_room,
    ball,
    camera_points,
    finite,
    pcd,
    ply,
    random_colors,
    room,
)
from tests.helpers.depth_files import assert_refused, write
from tests.helpers.samples import las

UNITS = {"metres": 1.0, "millimetres": 1000.0, "centimetres": 100.0, "inches": 1 / 0.0254}


def room_points() -> np.ndarray:
    return finite(camera_points(room()))


def random_rotation(seed: int) -> np.ndarray:
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


def viewpoint(rotation: np.ndarray, origin: np.ndarray) -> str:
    x, y, z, w = quaternion_of(rotation)
    return " ".join(f"{number:.9g}" for number in (*origin, w, x, y, z))


def noted(source, text: str) -> bool:
    return any(text in note for note in source.notes)


# Clouds of one camera


@pytest.mark.parametrize(
    ("axes", "unit"),
    # Axes and unit are found apart: all of each, not all pairs.
    [*product(CLOUD_FROM_CAMERA, ["millimetres"]), *(("camera", u) for u in UNITS if u != "millimetres")],
)
def test_a_camera_cloud_stays_in_place_in_any_axes_and_unit(tmp_path, axes, unit):
    """Unorganised points of a depth image give it back, bit for bit, and their colours; none is moved."""
    colors = random_colors(len(room_points()))
    points = room_points() @ CLOUD_FROM_CAMERA[axes].T * UNITS[unit]
    source = open_source(write(tmp_path / "x.ply", ply(points, colors)))
    assert_is_the_room(source, room(), colors)
    assert source.calibration.color == source.calibration.depth
    assert f"cloud with {axes} axes left in place" in source.notes[0]
    assert noted(source, "a unit of the cloud") == (unit != "metres")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stated", [True, False])
def test_a_grid_in_any_frame_finds_its_camera(tmp_path, seed, stated):
    """By its VIEWPOINT, or by the direct linear transform."""
    turn, origin = random_rotation(seed), np.random.default_rng(seed).uniform(-3, 3, 3)
    points = camera_points(room()).reshape(-1, 3) @ turn.T + origin
    header = {"VIEWPOINT": viewpoint(turn, origin)} if stated else {}
    source = open_source(write(tmp_path / "x.pcd", pcd(points, *room().shape[::-1], **header)))
    assert np.abs(source.frame(0).depth_mm.astype(int) - room()).max() <= (not stated)
    assert noted(source, "residual")


@pytest.mark.parametrize(
    ("seed", "place"), [(0, "VIEWPOINT"), (1, "VIEWPOINT"), (2, "VIEWPOINT"), (None, "origin")]
)
def test_a_viewpoint_turns_a_cloud_that_is_not_in_the_sensors_own_frame(tmp_path, seed, place):
    """A PCD's VIEWPOINT is the sensor's pose, or stands beside points in the sensor's own frame."""
    turn, origin = np.eye(3), np.array([0.4, 0.1, 0.3])
    points = room_points()
    if seed is not None:
        turn, origin = random_rotation(seed), np.random.default_rng(seed).uniform(-3, 3, 3)
        points = room_points() @ turn.T + origin
    content = pcd(points, len(points), 1, VIEWPOINT=viewpoint(turn, origin))
    source = open_source(write(tmp_path / "x.pcd", content))
    assert_is_the_room(source, room())
    assert place in source.notes[0]


@pytest.mark.parametrize("turn", [np.eye(3), random_rotation(1)])
def test_a_mirrored_grid_is_refused(tmp_path, turn):
    points = camera_points(room())[:, ::-1].reshape(-1, 3) @ turn.T
    path = write(tmp_path / "x.pcd", pcd(points, *room().shape[::-1]))
    assert_refused(path, "mirror image of its coordinates; negate y", FormatError)
    source = CloudFile(path, ImportOptions(mirror=True))
    # As in the grid: the opener mirrors image and camera back.
    assert np.abs(source.frame(0).depth_mm[:, ::-1].astype(int) - room()).max() <= 1
    camera = source.calibration.depth
    assert camera.width - 1 - camera.cx == pytest.approx(furnished_room.CAMERA.cx, abs=0.01)


def test_a_declared_camera_is_used(tmp_path):
    camera = furnished_room.CAMERA
    numbers = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    options = ImportOptions(intrinsics=write(tmp_path / "i.json", json.dumps(numbers).encode()))
    grid = pcd(camera_points(room()).reshape(-1, 3), 320, 264)
    for name, content in (("x.ply", ply(room_points())), ("x.pcd", grid)):
        source = open_source(write(tmp_path / name, content), options)
        assert source.calibration.depth == camera
        np.testing.assert_array_equal(source.frame(0).depth_mm, room())


ROUGH = {
    "noise of 2 mm": lambda points, rng: points + rng.normal(0, 0.002, points.shape),
    "half of the points": lambda points, rng: points[rng.random(len(points)) < 0.5],
    "a tenth of them": lambda points, rng: points[rng.random(len(points)) < 0.1],
}
SHAPES = [("camera", False), ("kinect", False), ("ros", False), ("camera", True), ("kinect", True)]


@pytest.mark.parametrize(("axes", "upper"), SHAPES)
@pytest.mark.parametrize("name", ROUGH)
def test_rough_clouds_of_a_person_are_upright_and_whole(tmp_path, name, axes, upper):
    """Without floor, by the head; the depth image is the camera's, within noise and spacing."""
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


def person(shape: str) -> np.ndarray:
    """A person cut out of a room, camera axes (n, 3)."""
    points = finite(camera_points(room(room=False)))
    if shape == "one leg":  # the lower end is narrower than the head
        low = points[:, 1] > np.percentile(points[:, 1], 55)
        return points[~low | (points[:, 0] > np.median(points[low, 0]) + 0.02)]
    if shape == "raised arm":  # beside the head: the upper end is broad
        top = points[:, 1].min()
        arm = np.stack(np.meshgrid(np.linspace(0.25, 0.35, 20), np.linspace(top, top + 0.6, 80)), -1)
        return np.concatenate([points, np.insert(arm.reshape(-1, 2), 2, np.median(points[:, 2]), axis=1)])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) if shape == "lying" else np.eye(3)
    return points @ turn


@pytest.mark.parametrize("shape", ["whole", "one leg", "raised arm", "lying"])
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_a_person_alone_is_not_turned_upside_down(tmp_path, shape, share):
    """Cameras' axes stand, unless a head with shoulders is at the lower end."""
    points = person(shape)
    points = points[np.random.default_rng(0).random(len(points)) < share]
    source = open_source(write(tmp_path / "x.ply", ply(points)))
    assert "camera axes left in place" in source.notes[0]


def test_axes_that_are_not_sure_are_noted_and_can_be_declared(tmp_path):
    u, v = np.meshgrid(np.arange(60), np.arange(50))
    wall = np.stack([(u - 30) * 0.013, (v - 25) * 0.017, 2.0 + 0.002 * u], axis=-1).reshape(-1, 3)
    source = open_source(write(tmp_path / "wall.ply", ply(wall)))
    assert noted(source, "if the image is upside down, the axes are kinect")
    path = write(tmp_path / "x.ply", ply(person("whole") @ CLOUD_FROM_CAMERA["kinect"].T))
    source = open_source(path)
    assert noted(source, "upside down, the axes are camera")
    assert noted(source, "where it points right (Unity), mirror the image")
    assert "camera axes" in CloudFile(path, ImportOptions(axes="camera")).notes[0]


@pytest.mark.parametrize("axes", ["camera", "z-up"])
def test_stray_points_change_nothing(tmp_path, axes):
    """Flying pixels and broken numbers far outside move no camera."""
    points = room_points() @ CLOUD_FROM_CAMERA[axes].T
    points = points if axes == "camera" else points - [0, 3, 0]  # the origin is within the room
    strays = np.array([[1e30, 0, 0], [0, -4e8, 1], [np.inf, 0, 0], [70.0, 80.0, 90.0]])
    options = AS_STATED if axes == "camera" else ImportOptions(axes=axes)
    plain = CloudFile(write(tmp_path / "a.ply", ply(points)), options)
    source = CloudFile(write(tmp_path / "b.ply", ply(np.concatenate([strays, points]))), options)
    np.testing.assert_array_equal(source.frame(0).depth_mm, plain.frame(0).depth_mm)
    np.testing.assert_array_equal(source.pixels, np.concatenate([[-1] * 4, plain.pixels]))


def test_black_is_no_colour(tmp_path):
    for colors in (None, np.zeros_like(room_points(), np.uint8)):
        source = open_source(write(tmp_path / "a.ply", ply(room_points(), colors)))
        assert source.calibration == RigCalibration(source.calibration.depth)
        assert source.frame(0).color_encoded is None and "no colour images" in source.notes


# Other clouds


@pytest.mark.parametrize("kind", ["ply", "las"])
def test_a_robots_cloud_is_seen_upright_from_in_front(tmp_path, kind):
    """ROS' base_link on the floor: x forward, z up. No camera stands there."""
    points = finite(camera_points(room(room=False, eye=(0.0, -2.4, 0.95))))
    points = points @ CLOUD_FROM_CAMERA["ros"].T + [0, 0, 0.95]
    content = ply(points) if kind == "ply" else las(points, 0.0, False)
    source = open_source(write(tmp_path / f"x.{kind}", content))
    assert "ros axes" in source.notes[0] or "z-up axes" in source.notes[0]
    v, u = np.nonzero(source.frame(0).depth_mm)
    assert np.ptp(v) > 1.5 * np.ptp(u)


def test_a_las_of_a_cameras_cloud_is_no_map(tmp_path):
    source = open_source(write(tmp_path / "x.las", las(room_points(), 0.0, False)))
    assert "camera axes left in place" in source.notes[0]
    found = source.frame(0).depth_mm
    assert np.count_nonzero(found) > 0.99 * len(room_points())
    assert np.median(found[found > 0]) == np.median(room()[room() > 0])


@pytest.mark.parametrize("kind", ["float", "double"])
def test_coordinates_far_away_are_those_of_a_map(tmp_path, kind):
    """UTM: z is up in any format; floats are too coarse, which a note states."""
    points = room_points() @ CLOUD_FROM_CAMERA["z-up"].T + [612345.5, 5412345.25, 433.5]
    source = open_source(write(tmp_path / "x.ply", ply(points, kind=kind)))
    assert "z-up axes" in source.notes[0]
    assert noted(source, "32-bit coordinates are 0.5 m apart") == (kind == "float")


@pytest.mark.parametrize("axes", ["y-up", "z-up"])
def test_a_lying_person_above_the_origin_is_seen_by_no_camera_there(tmp_path, axes):
    """A body on its own floor: its axes stay open, or are right where they are declared."""
    lying = person("lying")
    level = (lying - np.median(lying, axis=0)) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) - [0, 0.8, 0]
    path = write(tmp_path / "x.ply", ply(level @ CLOUD_FROM_CAMERA[axes].T))
    assert_refused(path, r"give the axes: camera, y-up", FormatError)
    assert CloudFile(path, ImportOptions(axes=axes)).frame(0).depth_mm.any()


def test_what_stays_open_is_asked_for(tmp_path):
    rng = np.random.default_rng(0)
    blob = write(tmp_path / "blob.ply", ply(rng.normal(0, 0.5, (4000, 3))))
    assert_refused(blob, r"give the axes: camera, y-up, ros, z-up, kinect", FormatError)
    assert "y-up axes" in CloudFile(blob, ImportOptions(axes="y-up")).notes[0]
    noise = np.array([0, 0, 150.0]) + rng.normal(0, 20, (4000, 3))
    cloud = write(tmp_path / "hand.ply", ply(noise))
    assert_refused(cloud, r"1\.5 m as centimetres.*give the millimetres of a unit", FormatError)
    assert CloudFile(cloud, ImportOptions(depth_unit_mm=10)).frame(0).depth_mm.any()
    far = write(tmp_path / "far.ply", ply(room_points() * 1000))
    with pytest.raises(
        FormatError, match=r"no point is within the 65\.534 m .* give the millimetres of a unit"
    ):
        CloudFile(far, ImportOptions(depth_unit_mm=1000))
    with pytest.raises(FormatError, match="axes 'up' are unknown; use camera"):
        CloudFile(blob, ImportOptions(axes="up"))


@pytest.mark.parametrize("axes", CLOUD_FROM_CAMERA)
def test_a_cloud_without_pixels_is_the_same_in_any_axes(tmp_path, axes):
    path = write(tmp_path / "ball.pcd", pcd(ball() @ CLOUD_FROM_CAMERA[axes].T, len(ball()), 1))
    depth_mm = CloudFile(path, ImportOptions(axes=axes)).frame(0).depth_mm
    v, u = np.unravel_index(np.where(depth_mm > 0, depth_mm, 9999).argmin(), depth_mm.shape)
    expected = project(KINECT_V2, np.array([0.1, 0.2, 2.0]) * (1 - 0.3 / np.linalg.norm([0.1, 0.2, 2.0])))
    assert depth_mm[v, u] == pytest.approx(1700, abs=4)
    np.testing.assert_allclose([u, v], expected, atol=12)
    if axes != "kinect":  # a ball has no feet
        np.testing.assert_array_equal(CloudFile(path).frame(0).depth_mm, depth_mm)


# Real recordings


def test_the_real_camera_is_found_by_its_grid_and_without(shared_data, tmp_path):
    grid = open_source(shared_data / "pcl_person" / "person.pcd")
    depth, camera = grid.frame(0).depth_mm, grid.calibration.depth
    assert camera.shape == (480, 640) and (depth[depth > 0].min(), depth.max()) == (607, 3779)
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx, camera.cy], [525, 525, 319.5, 239.5], atol=1e-3
    )
    kept = finite(grid.cloud.points())
    source = open_source(write(tmp_path / "x.ply", ply(kept)))
    camera = source.calibration.depth
    found = [camera.fx, camera.fy, camera.cx % 1, camera.cy % 1]
    np.testing.assert_allclose(found, [525, 525, 0.5, 0.5], atol=1e-3)
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
