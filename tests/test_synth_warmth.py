"""Temperatures of people, things and the thermal camera's pixels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.parts import PART_ID
from sensors.rig.camera import Intrinsics
from synth.appearance.warmth import CONTACT_C, HAIR_C, PART_C, BodyWarmth, Clothing, surface_temperatures
from synth.body.body import pose, shipped_bodies
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture
from synth.cameras.optics import Lens
from synth.cameras.thermal_camera import (
    FLAG_CLOSED_S,
    FLAG_EVERY_S,
    ThermalNoise,
    ThermalState,
    thermograph,
    through_lens,
    warmth_seen,
)
from synth.surface.furniture import Surface
from synth.surface.rasterize import ZBuffer, face_means

BODY = shipped_bodies()[4]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_means_of_faces_are_those_of_numpy_bit_for_bit(kind, shape):
    by_vertex = np.random.default_rng(1).normal(0, 5, (len(BODY.vertices_m), *shape)).astype(kind)
    means = face_means(by_vertex, BODY.faces)
    assert means.dtype == kind
    np.testing.assert_array_equal(means, by_vertex[BODY.faces].mean(axis=1))


def arms(degrees):
    """A standing body with its arms so far from its sides."""
    angles = np.zeros((N_JOINTS, 3))
    angles[[JOINT_ID["left_shoulder"], JOINT_ID["right_shoulder"]], 1] = np.radians(degrees)
    return pose(BODY, Posture(angles, np.zeros(3)))[0]


def warmth(clothing=None, room_c=20.5):
    return BodyWarmth(BODY, clothing or Clothing(), room_c, np.random.default_rng(0))


def test_everybody_is_as_the_table_says_in_the_tables_room():
    celsius = warmth().celsius()
    torso = BODY.face_parts == PART_ID["torso"]
    assert (celsius[torso] == PART_C["chest"]).all()
    assert set(np.unique(celsius[BODY.face_parts == PART_ID["head"]])) == {HAIR_C, PART_C["head"]}
    assert warmth(room_c=25.5).celsius() - celsius == pytest.approx(2.0)


def test_arms_at_the_sides_warm_and_arms_held_away_do_not():
    away, close = warmth(), warmth()
    none = np.zeros(len(BODY.vertices_m), bool)
    away.update(arms(70), none, 60.0)
    close.update(arms(0), none, 60.0)
    upper = np.isin(BODY.face_parts, [PART_ID["left_upper_arm"], PART_ID["right_upper_arm"]])
    gain = close.celsius() - away.celsius()
    assert gain[upper].max() > 1.5 and (gain > -1e-9).mean() > 0.99
    assert 0.02 < (gain > 0.5).mean() < 0.6
    assert close.celsius()[BODY.face_parts != PART_ID["head"]].max() <= CONTACT_C
    for _ in range(20):
        close.update(arms(70), none, 30.0)
    assert close.celsius() == pytest.approx(away.celsius(), abs=0.1)


def test_what_furniture_presses_warms():
    person, pressed = warmth(), np.zeros(len(BODY.vertices_m), bool)
    pressed[BODY.faces[BODY.face_parts == PART_ID["hip"]]] = True
    before = person.celsius()
    person.update(arms(60), pressed, 1e3)
    hip = BODY.face_parts == PART_ID["hip"]
    assert person.celsius()[hip] == pytest.approx(CONTACT_C, abs=0.01)
    assert (person.celsius() >= before - 1e-9).all()


@given(strength=st.floats(0, 2), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_clothes_differ_more_the_harder_it_is(strength, seed):
    clothing = Clothing.sample(np.random.default_rng(seed), strength)
    assert 0 <= clothing.cold_feet <= 1 and 0 <= clothing.cold_hands <= 1
    assert abs(clothing.offset_c) <= 2.5 * strength
    if strength == 0:
        assert clothing == Clothing()


def test_cold_feet_hands_and_sleeves_are_cold():
    usual = warmth().celsius()
    sleeve = PART_ID["left_forearm"]
    cold = warmth(Clothing(cold_feet=1, cold_hands=1, cold_sleeves=(sleeve,))).celsius()
    assert 4 < (usual - cold)[BODY.face_parts == sleeve].max() < 6
    colder = {int(part) for part in np.unique(BODY.face_parts[usual - cold > 1])}
    limbs = ("left_forearm", "right_forearm", "left_lower_leg", "right_lower_leg")
    assert colder == {PART_ID[name] for name in limbs}


def test_things_have_their_own_temperature_and_the_rest_the_rooms():
    tags = np.array([Surface.WALL, Surface.SOFA, Surface.RADIATOR, Surface.MUG, Surface.WINDOW], np.int32)
    exact = surface_temperatures(tags, 22.0, 0.0, np.random.default_rng(0))
    assert exact.tolist() == [22.0, 22.0, 46.0, 50.0, 14.0]
    many = np.array([surface_temperatures(tags, 22.0, 1.0, np.random.default_rng(s)) for s in range(200)])
    assert many.mean(axis=0) == pytest.approx(exact, abs=1.5)
    assert many.std(axis=0)[0] < 0.5 < many.std(axis=0)[2]


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_flag_closes_for_half_a_second_every_twelve_or_more(seed):
    state = ThermalState(ThermalNoise(), np.random.default_rng(seed))
    times = np.arange(0, 120, 0.05)
    closed = np.array([state.flag_closed(t) for t in times])
    starts = times[1:][closed[1:] & ~closed[:-1]]
    assert 4 <= len(starts) <= 10
    assert (np.diff(starts) >= FLAG_EVERY_S[0] - 0.06).all()
    assert (np.diff(starts) <= FLAG_EVERY_S[1] + 0.06).all()
    assert closed.sum() * 0.05 == pytest.approx(len(starts) * FLAG_CLOSED_S, abs=0.6)
    never = ThermalState(ThermalNoise(flag=False), np.random.default_rng(seed))
    assert not any(never.flag_closed(t) for t in times)


@given(seed=st.integers(0, 2**32 - 1), most=st.floats(0, 3))
@settings(max_examples=30, deadline=None)
def test_drift_is_slow_and_bounded(seed, most):
    state = ThermalState(ThermalNoise(drift_c=most), np.random.default_rng(seed))
    drift = np.array([state.drift_c(t) for t in np.arange(0, 600, 0.5)])
    assert (np.abs(drift) <= most + 1e-9).all()
    assert np.abs(np.diff(drift)).max(initial=0) <= 0.05 * most + 1e-9


def test_a_thermal_pixel_is_the_mean_of_what_it_sees():
    lens, size = Lens(Intrinsics(10, 8, 20.0, 20.0, 4.5, 3.5), 3), (24, 30)
    face = np.zeros(lens.pinhole.shape, np.int32)
    face[:, :13] = 1
    face[0, 0] = -1
    off = ThermalNoise(netd_c=0, blur_px=0)
    seen, rng = ZBuffer(np.ones(size, np.float32), face), np.random.default_rng(0)
    warm = warmth_seen(seen, np.array([20.0, 32.0]), 11.0)
    image = thermograph(through_lens(warm, lens), off, 0.5, rng)
    assert image.shape == (8, 10) and image.dtype == np.float32
    assert image[3, 2] == 32.5 and image[3, 7] == 20.5
    assert image[3, 4] == pytest.approx(24.5) and image[0, 0] == pytest.approx(32.5 - 21 / 9, abs=1e-4)
    noisy = thermograph(0 * image, ThermalNoise(netd_c=0.3, blur_px=0), 0, rng)
    assert noisy.std() == pytest.approx(0.3, rel=0.4)
