"""Baked bodies: what they measure, how they are skinned, what a blend of two is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.parts import PARTS
from sensors.errors import FormatError
from synth.body import load_body, pose, save_body, shipped_bodies, volume_m3
from synth.fit import PAPER_BODIES
from synth.sample import blend
from synth.scene import box
from synth.skeleton import JOINT_ID, N_JOINTS, Posture, alignment

MEASURES = ("height_cm", "weight_kg", "waist_breadth_cm")


@pytest.mark.parametrize("number", range(8))
def test_shipped_bodies_measure_what_table_1_says(number):
    body, size = shipped_bodies()[number], PAPER_BODIES[number]
    assert body.name == size.name
    for measure in MEASURES:
        assert abs(getattr(body, measure) - getattr(size, measure)) <= 0.5


def test_every_part_is_on_every_body():
    for body in shipped_bodies():
        assert set(np.unique(body.face_parts)) == {part.id for part in PARTS[1:]}


def test_volume_of_a_box_is_its_volume():
    mesh = box((0.1, -0.2, 0.5), (0.6, 0.3, 2.5), 1)
    assert volume_m3(mesh.vertices_m, mesh.faces) == pytest.approx(0.5 * 0.5 * 2.0, rel=1e-6)


@given(pair=st.permutations(range(8)), share=st.floats(0, 1))
@settings(max_examples=20, deadline=None)
def test_a_blend_measures_something_in_between(pair, share):
    a, b = (shipped_bodies()[i] for i in pair[:2])
    blended = blend(a, b, share)
    for measure in MEASURES:
        low, high = sorted((getattr(a, measure), getattr(b, measure)))
        # Lengths mix linearly; a volume is cubic in the shape and may leave the line a little.
        slack = 1.0 if measure == "weight_kg" else 0.35
        assert low - slack <= getattr(blended, measure) <= high + slack


@pytest.mark.parametrize("number", [0, 7])
def test_the_ends_of_a_blend_are_its_bodies(number):
    a, b = shipped_bodies()[number], shipped_bodies()[3]
    np.testing.assert_array_equal(blend(a, b, 0).vertices_m, a.vertices_m)
    np.testing.assert_array_equal(blend(a, b, 1).joints_m, b.joints_m)


def test_at_zero_angles_the_skin_is_the_linear_blend_of_the_aligned_bones():
    body = shipped_bodies()[2]
    pelvis = np.array([0.3, -0.2, 1.1])
    vertices, joints = pose(body, Posture(np.zeros((N_JOINTS, 3)), pelvis))
    np.testing.assert_allclose(joints[0], pelvis, atol=1e-12)
    frames = alignment(body.joints_m)
    moved = np.einsum("jab,jvb->jva", frames, body.vertices_m - body.joints_m[:, None]) + joints[:, None]
    expected = sum(
        body.weights[:, k, None] * moved[body.bones[:, k], np.arange(len(body.vertices_m))] for k in range(4)
    )
    np.testing.assert_allclose(vertices, expected, atol=2e-6)


def test_a_body_moved_rigidly_keeps_its_shape():
    body = shipped_bodies()[5]
    angles = np.zeros((N_JOINTS, 3))
    still, _ = pose(body, Posture(angles, np.zeros(3)))
    angles[JOINT_ID["pelvis"]] = (0.4, -0.7, 1.9)
    moved, _ = pose(body, Posture(angles, np.array([1.0, 2.0, 3.0])))
    pairs = np.random.default_rng(0).integers(0, len(still), (500, 2))
    before, after = (np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1) for v in (still, moved))
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_a_saved_body_comes_back_the_same(tmp_path):
    body = shipped_bodies()[1]
    save_body(tmp_path / "me.npz", body)
    again = load_body(tmp_path / "me.npz")
    assert again.name == "me"
    for name, value in vars(replace(body, name="me")).items():
        np.testing.assert_array_equal(getattr(again, name), value)


def test_what_is_no_body_is_refused(tmp_path):
    path = tmp_path / "bad.npz"
    path.write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(FormatError, match="cannot be read"):
        load_body(path)
    np.savez_compressed(path, bomb=np.zeros((4000, 4000)))
    with pytest.raises(FormatError, match="larger than"):
        load_body(path)
    np.savez(path, vertices_m=np.zeros((3, 3), np.float32))
    with pytest.raises(FormatError, match="cannot be read"):
        load_body(path)
    body = shipped_bodies()[0]
    with pytest.raises(FormatError, match="point outside"):
        replace(body, faces=body.faces + 1)
    with pytest.raises(FormatError, match="weights"):
        replace(body, weights=body.weights[:, :3])
