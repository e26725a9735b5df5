"""The rasteriser against Open3D's ray caster, closed forms and its own symmetries."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.rig.camera import Intrinsics, rays
from synth.body.body import shipped_bodies
from synth.images.view import _window
from synth.pose.postures import SITTING, sit
from synth.surface.furniture import Sofa
from synth.surface.rasterize import look_at, rasterize

SMALL = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def cast(camera, vertices, faces):
    """Open3D's answer: depth along z, NaN where nothing is hit, and the face."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    directions = rays(camera).astype(np.float32)
    hits = scene.cast_rays(np.concatenate([np.zeros_like(directions), directions], axis=2), nthreads=1)
    depth = hits["t_hit"].numpy()
    return np.where(np.isfinite(depth), depth, np.nan), hits["primitive_ids"].numpy().astype(np.int64)


def posed(seed):
    """A seated body and its sofa in the camera frame."""
    rng = np.random.default_rng(seed)
    body, sofa = shipped_bodies()[seed % 8], Sofa.sample(rng)
    vertices, joints = sit(body, sofa, SITTING.draw("reading", rng))
    pose = look_at(joints[0] + [rng.uniform(-1, 1), -1.8, 0.5], joints[0])
    return body, pose.apply(vertices).astype(np.float32), sofa, pose


@pytest.mark.parametrize("seed", [0, 1])
def test_agrees_with_ray_casting_on_a_posed_body(seed):
    body, vertices, _, _ = posed(seed)
    seen = rasterize(KINECT2_PINHOLE, vertices, body.faces)
    depth, face = cast(KINECT2_PINHOLE, vertices, body.faces)
    hit, truth = seen.face >= 0, np.isfinite(depth)
    edge = ndimage.binary_dilation(truth) & ~ndimage.binary_erosion(truth)
    assert truth.sum() > 5000
    assert not ((hit != truth) & ~edge).any()
    both = hit & truth
    # Silhouettes inside the body: a pixel centre on an edge may see the one surface or the other.
    off = np.abs(seen.depth_m[both] - depth[both])
    assert (off > 1e-4).mean() < 1e-3
    assert (seen.face[both] != face[both]).mean() < 2e-3


def test_closed_meshes_look_the_same_from_their_front_alone():
    body, vertices, sofa, pose = posed(3)
    mesh = sofa.mesh()
    for points, faces in (
        (vertices, body.faces),
        (pose.apply(mesh.vertices_m).astype(np.float32), mesh.faces),
    ):
        both, front = (rasterize(KINECT2_PINHOLE, points, faces, closed=closed) for closed in (False, True))
        np.testing.assert_array_equal(both.face, front.face)
        np.testing.assert_array_equal(both.depth_m, front.depth_m)


def test_a_sphere_has_its_closed_form():
    ball = o3d.geometry.TriangleMesh.create_sphere(0.5, 200)
    vertices = np.asarray(ball.vertices, np.float32) + np.array([0.1, -0.05, 2.0], np.float32)
    seen = rasterize(SMALL, vertices, np.asarray(ball.triangles, np.int32))
    d, centre = rays(SMALL), np.array([0.1, -0.05, 2.0])
    a, b, c = (d * d).sum(2), d @ centre, centre @ centre - 0.25
    expected = (b - np.sqrt(np.maximum(b * b - a * c, 0))) / a
    well_inside = b * b - a * c > 0.02
    np.testing.assert_allclose(seen.depth_m[well_inside], expected[well_inside], atol=2e-4)
    assert np.isnan(seen.depth_m[b * b - a * c < -0.005]).all()


def test_a_window_is_the_same_image_cut_out():
    body, vertices, _, _ = posed(4)
    whole = rasterize(KINECT2_PINHOLE, vertices, body.faces)
    window, (top, left) = _window(vertices, KINECT2_PINHOLE)
    part = rasterize(window, vertices, body.faces)
    inside = np.s_[top : top + window.height, left : left + window.width]
    assert (part.face == whole.face[inside]).mean() > 0.9999
    np.testing.assert_allclose(part.depth_m, whole.depth_m[inside], atol=2e-4)
    assert (whole.face >= 0).sum() == (whole.face[inside] >= 0).sum()


@given(shift=st.integers(-20, 20), size=st.floats(0.05, 0.4), z=st.sampled_from([0.5, 1.0, 2.0, 4.0]))
@settings(max_examples=40, deadline=None)
def test_a_plane_moved_by_whole_pixels_is_the_image_moved(shift, size, z):
    """At powers of two, because there the move itself is exact."""
    corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]) * size * z
    camera, images = Intrinsics(128, 48, 64.0, 64.0, 63.5, 23.5), []
    for move in (0, shift * z / 64):
        points = np.column_stack([corners[:, 0] + move, corners[:, 1], np.full(4, z)]).astype(np.float32)
        images.append(rasterize(camera, points, np.array([[0, 1, 2], [1, 3, 2]], np.int32)).face)
    still, moved = images[0][:, 30:98], images[1][:, 30 + shift : 98 + shift]
    assert ((still >= 0) != (moved >= 0)).mean() < 0.01
    # Either triangle may win at a pixel's centre on their diagonal, once a row.
    both = (still >= 0) & (moved >= 0)
    assert (both & (still != moved)).sum(axis=1).max() <= 1


normals = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))


@given(tilt=normals, distance=st.floats(0.8, 4.0))
@settings(max_examples=40, deadline=None)
def test_a_plane_has_its_closed_form(tilt, distance):
    a, b = tilt
    x, y = np.meshgrid([-3.0, 3.0], [-3.0, 3.0])
    z = distance + a * x + b * y
    corners = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    if corners[:, 2].min() < 0.06:
        return
    seen = rasterize(SMALL, corners, np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    d = rays(SMALL)
    expected = distance / (1 - a * d[..., 0] - b * d[..., 1])
    hit = seen.face >= 0
    np.testing.assert_allclose(seen.depth_m[hit], expected[hit], rtol=1e-5)


@given(seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_the_order_of_triangles_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    vertices = (rng.uniform(-1, 1, (60, 3)) + np.array([0, 0, 2.5])).astype(np.float32)
    faces = rng.permutation(60).reshape(20, 3).astype(np.int32)
    order = rng.permutation(20)
    seen, other = rasterize(SMALL, vertices, faces), rasterize(SMALL, vertices, faces[order])
    np.testing.assert_array_equal(seen.depth_m, other.depth_m)
    hit = other.face >= 0
    np.testing.assert_array_equal(seen.face[hit], order[other.face[hit]])


def test_triangles_at_the_camera_and_slivers_are_dropped():
    behind = np.array([[-1, -1, 0.01], [1, -1, 2], [0, 1, 2]], np.float32)
    line = np.array([[0, 0, 1], [1, 1, 1], [2, 2, 1]], np.float32)
    for points in (behind, line):
        assert (rasterize(SMALL, points, np.array([[0, 1, 2]], np.int32)).face == -1).all()
