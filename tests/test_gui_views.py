"""Projection, orbit, levels of detail, colours and shapes, without a window."""

import numpy as np
import pytest
import pyvista as pv
from hypothesis import given
from hypothesis import strategies as st

from annotate.cloud.fuse import Fuser
from annotate.correction.correction import Correction
from annotate.correction.select import ScreenPoints, polygon
from annotate.frame_labels import FrameLabels
from annotate.gui.state.drawing import Drawing
from annotate.gui.state.keys import Settings
from annotate.gui.state.orbit_camera import Orbit, front_view, project
from annotate.gui.state.outcome import described
from annotate.gui.state.point_colors import SAME_RGB, Look, Painting, colourings
from annotate.gui.state.scene import ROOM_POINTS, SceneReader
from annotate.gui.widgets.theme import DARK, LIGHT
from annotate.labelset.label_set import LabelSet
from annotate.labelset.source_recording import find_session
from annotate.labelset.stroke import Stroke
from annotate.parts import PAPER, PARTS
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration
from tests.helpers.gui_driver import Driver

SIZE = (640, 480)
GROUND = (20, 22, 27)


def point_colors(scene, parts, pixels, colouring, visibility=None):
    """Colours without anything over them."""
    return Painting(scene, parts, Look(colouring, outlines=False), visibility or {}, GROUND)(pixels)


def camera_of(orbit: Orbit) -> pv.Camera:
    camera = pv.Camera()
    camera.position, camera.focal_point = orbit.position_m.tolist(), orbit.target_m
    camera.up, camera.view_angle = (0.0, -1.0, 0.0), orbit.angle_deg
    camera.clipping_range = (0.01, 100.0)
    return camera


def matrix_of(orbit: Orbit) -> np.ndarray:
    matrix = camera_of(orbit).GetCompositeProjectionTransformMatrix(SIZE[0] / SIZE[1], -1, 1)
    return np.array([[matrix.GetElement(r, c) for c in range(4)] for r in range(4)])


orbits = st.builds(
    Orbit,
    st.tuples(*(st.floats(-1, 1) for _ in range(2)), st.floats(1, 4)),
    st.floats(0.5, 5),
    st.floats(-180, 180),
    st.floats(-80, 80),
)


@given(orbits)
def test_projection_is_the_pinhole_of_the_orbit(orbit):
    """Closed form: along the axes of the view, divided by depth, times the focal length."""
    points = np.random.default_rng(0).normal(orbit.target_m, 0.2, (50, 3)).astype(np.float32)
    view = project(points, np.ones(50, bool), matrix_of(orbit), SIZE, 1.0)
    right, down, forward = orbit.axes
    away = points - orbit.position_m
    depth, focal = away @ forward, orbit.focal_px(SIZE[1])
    x = SIZE[0] / 2 + focal * (away @ right) / depth
    y = SIZE[1] / 2 + focal * (away @ down) / depth
    ahead = depth > 0.05
    np.testing.assert_allclose(view.xy_px[ahead], np.stack([x, y], 1)[ahead], atol=0.5)
    np.testing.assert_allclose(view.distance_m[ahead], depth[ahead], rtol=1e-3)
    assert np.isnan(view.xy_px[depth < 0]).all()


@given(orbits, st.floats(-300, 300), st.floats(-20, 20))
def test_turning_there_and_back_changes_nothing(orbit, right_px, down_px):
    turned = orbit.turned(right_px, down_px)
    assert np.linalg.norm(turned.position_m - orbit.target_m) == pytest.approx(orbit.distance_m)
    if abs(orbit.elevation_deg) < 75:
        back = turned.turned(-right_px, -down_px)
        np.testing.assert_allclose(back.position_m, orbit.position_m, atol=1e-6)


@given(orbits, st.floats(-100, 100), st.floats(-100, 100))
def test_shifting_moves_the_target_by_what_was_dragged(orbit, right_px, down_px):
    target = np.array([orbit.target_m], np.float32)
    moved = orbit.shifted(right_px, down_px, SIZE[1])
    view = project(target, np.ones(1, bool), matrix_of(moved), SIZE, 1.0)
    middle = np.array(SIZE) / 2
    np.testing.assert_allclose(view.xy_px[0] - middle, (right_px, down_px), atol=0.5)


@given(orbits, st.floats(-3, 3), st.tuples(*(st.floats(-0.1, 0.1) for _ in range(3))))
def test_zooming_keeps_the_point_under_the_pointer_where_it_is(orbit, steps, away_m):
    point = np.array(orbit.target_m) + away_m
    places = [
        project(point[None].astype(np.float32), np.ones(1, bool), matrix_of(each), SIZE, 1.0).xy_px[0]
        for each in (orbit, orbit.neared(steps, point))
    ]
    np.testing.assert_allclose(*places, atol=0.5)


def test_the_front_view_holds_every_point():
    points = np.random.default_rng(1).uniform((-0.4, -0.9, 1.8), (0.4, 0.9, 2.4), (500, 3)).astype(np.float32)
    view = project(points, np.ones(500, bool), matrix_of(front_view(points, SIZE[0] / SIZE[1])), SIZE, 1.0)
    assert len(view.pixels) == 500
    assert np.ptp(view.xy_px[:, 1]) > 0.6 * SIZE[1]
    assert front_view(points[:0], 1.0).distance_m > 0


def test_hidden_points_neither_hide_nor_are_chosen():
    points = np.array([[0, 0, 2], [0, 0, 3]], np.float32)
    orbit = Orbit((0.0, 0.0, 2.0), 2.0)
    everywhere = np.array([(0, 0), (SIZE[0], 0), SIZE, (0, SIZE[1])], float)
    for shown, chosen in (((True, True), [0]), ((False, True), [1])):
        view = project(points, np.array(shown), matrix_of(orbit), SIZE, 1.0)
        assert polygon(view, everywhere).tolist() == chosen


def test_a_near_surface_leaves_no_gap_when_it_is_zoomed():
    """Points 12 px apart on the screen hide points behind them only in cells as large."""
    grid = np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-5, 6)), -1).reshape(-1, 2) * 0.01
    near, far = (np.c_[grid + by, np.full(len(grid), z)] for by, z in ((0.0, 1.0), (0.005, 1.3)))
    points = np.r_[near, far].astype(np.float32)
    orbit = Orbit((0.0, 0.0, 1.0), 0.75)
    spacing = 0.01 * orbit.focal_px(SIZE[1]) / 0.75
    view = project(points, np.ones(len(points), bool), matrix_of(orbit), SIZE, spacing)
    assert view.front[: len(near)].all()
    inner = np.abs(grid).max(axis=1) < 0.035
    assert not view.front[len(near) :][inner].any()


@given(st.floats(1, 5), st.floats(-50, 50))
def test_a_shape_scaled_takes_what_it_took(scale, corner):
    view = ScreenPoints.of_image(np.full((40, 50), 1000, np.uint16))
    lasso = Drawing("lasso", (10.0, 10.0))
    for place in ((30.0, 12.0), (25.0, 30.0), (8.0, 25.0)):
        lasso.drag(*place)
    zoomed = Drawing("lasso", (10 * scale + corner, 10 * scale + corner))
    for u, v in lasso.points_px[1:]:
        zoomed.drag(u * scale + corner, v * scale + corner)
    back = zoomed.scaled(corner, corner, scale)
    # Corners are rounded to a sixteenth of a pixel, so points on the edge may fall to either side.
    assert len(set(back.pixels(view)) ^ set(lasso.pixels(view))) <= 3
    assert lasso.gesture("lasso").path_px < zoomed.gesture("lasso").path_px * 1.01


def test_slips_of_the_hand_are_no_strokes():
    assert Drawing("lasso", (5, 5)).is_slip and not Drawing("piece", (5, 5)).is_slip
    small = Drawing("rectangle", (5, 5))
    small.drag(7, 6)
    assert small.is_slip
    small.drag(25, 40)
    assert not small.is_slip


def test_a_stroke_in_words():
    runs = np.array([[0, 9, 1, 2], [9, 3, 3, 2]], np.int64)
    assert described(Stroke("f", "paint", runs, 2), PAPER) == "12 pixels to torso (9 head, 3 left upper arm)"
    assert described(Stroke("f", "paint", runs[1:], 2), PAPER) == "3 pixels from left upper arm to torso"


# Scenes


@pytest.fixture
def small_set(tmp_path):
    """One frame: a box before a wall, its left half the head, its right half the torso."""
    camera = Intrinsics(300, 240, 250.0, 250.0, 150.0, 120.0)
    depth = np.full(camera.shape, 2500, np.uint16)
    parts = np.zeros(camera.shape, np.uint8)
    depth[80:160, 100:200], parts[80:160, 100:150], parts[80:160, 150:200] = 2000, 1, 2
    depth[:5] = 0
    labels = LabelSet.create(tmp_path / "labels", camera, {"source": "people"})
    confidence = np.where(parts == 1, 1.0, 0.2).astype(np.float32)
    labels.write(FrameLabels("000000", depth, parts, confidence))
    return labels


@pytest.fixture
def scene(small_set):
    with Correction.open(small_set.path, "mia") as correction:
        yield SceneReader(correction, other=small_set).read("000000")


def test_a_scene_shows_the_person_in_full_and_the_room_thinned(scene):
    person = scene.labels.parts.ravel() > 0
    assert scene.near[person].all() and not scene.near[: 5 * 300].any()
    assert 0 < len(scene.room) <= ROOM_POINTS and not scene.near[scene.room].any()
    whole = np.flatnonzero((scene.labels.depth_mm.ravel() > 0) & ~scene.near)
    assert len(scene.room) * scene.room_step**2 == pytest.approx(len(whole), rel=0.1)
    np.testing.assert_array_equal(
        scene.points_m,
        Fuser(RigCalibration(scene.cloud.camera)).fuse(scene.labels.depth_mm).points_m.reshape(-1, 3),
    )


def test_parts_have_their_colours_and_faded_ones_the_grounds(scene):
    pixels = np.flatnonzero(scene.labels.parts)
    plain = point_colors(scene, scene.labels.parts, pixels, "part")
    hue = plain[scene.labels.parts.ravel()[pixels] == 2].astype(float)
    expected = np.array(PARTS[2].rgb) / max(PARTS[2].rgb)
    np.testing.assert_allclose(
        hue / hue.max(axis=1, keepdims=True), np.tile(expected, (len(hue), 1)), atol=0.03
    )
    faded = point_colors(scene, scene.labels.parts, pixels, "part", {2: "faded"}).astype(float)
    is_torso = scene.labels.parts.ravel()[pixels] == 2
    away = np.abs(faded - GROUND).sum(axis=1) - np.abs(plain.astype(float) - GROUND).sum(axis=1)
    assert (away[is_torso] < 0).all() and (away[~is_torso] == 0).all()


def test_doubt_glows_and_agreement_is_grey(scene):
    assert colourings(scene) == ("part", "depth", "confidence", "disagreement")
    pixels = np.flatnonzero(scene.labels.parts)
    doubtful = scene.labels.parts.ravel()[pixels] == 2
    rgb = point_colors(scene, scene.labels.parts, pixels, "confidence").astype(int)
    assert (rgb[doubtful, 0] - rgb[doubtful, 2] > 50).all() and (rgb[~doubtful, 0] < rgb[~doubtful, 2]).all()
    same = point_colors(scene, scene.labels.parts, pixels, "disagreement")
    assert (same <= SAME_RGB).all()
    changed = scene.labels.parts.copy()
    changed[changed == 2] = 3
    differs = point_colors(scene, changed, pixels, "disagreement").astype(int)
    assert (differs[doubtful, 0] > differs[doubtful, 2]).all()


def test_a_session_beside_the_labels_is_found(small_set):
    assert find_session(small_set) is None
    beside = small_set.path.parent / "people.mcap"
    beside.write_bytes(b"")
    assert find_session(small_set) == beside
    small_set.info["source"] = "../../etc/people"
    assert find_session(small_set) is None
    named_alike = LabelSet.create(
        small_set.path.with_name("x.labels"), small_set.intrinsics, {"source": "rig"}
    )
    beside = small_set.path.with_name("x.mcap")
    beside.write_bytes(b"")
    assert find_session(named_alike) == beside


def test_another_recording_is_refused_or_left_out(small_set, rig_session, rig_labels, tmp_path):
    with Correction.open(small_set.path, "mia") as correction:
        with pytest.raises(FormatError, match="session"):
            SceneReader(correction, rig_session)
        with pytest.raises(FormatError, match="compare"):
            SceneReader(correction, other=rig_labels)


def test_a_frame_of_another_depth_image_comes_without_colours(rig_labels, rig_session, tmp_path):
    labels = LabelSet.create(tmp_path / "other", rig_labels.intrinsics, {})
    frame = rig_labels.read(rig_labels.frame_ids[0])
    labels.write(FrameLabels(frame.frame_id, frame.depth_mm // 2, frame.parts))
    with Correction.open(labels.path, "mia") as correction:
        scene = SceneReader(correction, rig_session).read(frame.frame_id)
    assert colourings(scene) == ("part", "depth") and "another depth image" in scene.remark


def test_a_cameras_picture_has_a_dark_ground_in_every_theme(qapp, rig_labels, rig_session):
    driver = Driver(rig_labels.path, rig_session, read_only=True, settings=Settings("light"))
    window = driver.window
    for colouring, ground in (("part", LIGHT), ("colour", DARK), ("temperature", LIGHT)):
        for view in window.views:
            driver.look(colouring, view=view)
        background = np.array(window.views.cloud.plotter.renderer.GetBackground()) * 255
        np.testing.assert_allclose(background, ground.ground_rgb, atol=1)
        assert window.views.depth.ground.getRgb()[:3] == ground.ground_rgb
    driver.close()
