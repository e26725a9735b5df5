"""A thermal image that was moved over the depth image is found out, and by how much."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.alignment import (
    SHIFT_PX,
    contrasts,
    degrees,
    is_warmer,
    measure_drift,
    misplacement_px,
    peak_px,
)
from annotate.person.warmth import warmth
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, rays
from sensors.rig.rig_calibration import Pose
from synth.rig.virtual_rig import RigOptions, VirtualRig

CAMERA = Intrinsics(200, 160, 150.0, 150.0, 99.5, 79.5)
WINDOW_C = (25.0, 35.0)
EVERYWHERE = np.ones(CAMERA.shape, bool)


def warm_disc(centre=(80, 100), radius=30, person_c=30.0, noise_c=0.08):
    """A warm disc at 2 m before a wall at 3 m."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    disc = np.hypot(v - centre[0], u - centre[1]) < radius
    depth = np.where(disc, 2000, 3000).astype(np.uint16)
    celsius = np.where(disc, person_c, 20.0) + np.random.default_rng(0).normal(0, noise_c, disc.shape)
    points = (rays(CAMERA) * depth[..., None] / 1000).astype(np.float32)
    return ThermalCloud(
        CAMERA, depth, points, np.zeros((*disc.shape, 3), np.uint8), disc, celsius.astype(np.float32)
    )


@pytest.mark.parametrize(("gaps", "least"), [(0, 0.8), (0.4, 0.7)])
def test_temperatures_in_their_place_are_not_off(gaps, least):
    cloud = warm_disc()
    hidden = np.random.default_rng(1).random(cloud.temperature_c.shape) < gaps
    celsius = np.where(hidden, np.float32(np.nan), cloud.temperature_c)
    surface = contrasts(replace(cloud, temperature_c=celsius), WINDOW_C, EVERYWHERE)
    assert misplacement_px(surface) is None and np.hypot(*peak_px(surface)) <= 2 * SHIFT_PX
    assert surface[len(surface) // 2, len(surface) // 2] > least


@pytest.mark.parametrize("shift", [(18, 0), (0, -15), (-12, 12)])
def test_the_shift_of_the_temperatures_is_found(shift):
    cloud = warm_disc()
    moved = replace(cloud, temperature_c=np.roll(cloud.temperature_c, shift[::-1], axis=(0, 1)))
    shift_px = misplacement_px(contrasts(moved, WINDOW_C, EVERYWHERE))
    np.testing.assert_allclose(shift_px, shift, atol=2 * SHIFT_PX)
    expected = np.degrees(np.arctan(np.hypot(*shift_px) / 150.0))
    assert degrees(shift_px, CAMERA) == pytest.approx(expected)


@pytest.mark.parametrize("shift", [(18, 0), (0, -15), (-12, 12)])
def test_a_person_is_warmer_where_the_temperatures_went(shift):
    disc = warm_disc()
    warmth, person = (disc.temperature_c - 20) / 10, disc.color_valid
    moved = np.roll(warmth, shift[::-1], axis=(0, 1))
    assert is_warmer(moved, person, shift) and not is_warmer(moved, person, (-shift[0], -shift[1]))
    assert not is_warmer(warmth, person, shift) and is_warmer(warmth, person & False, shift)


def test_the_few_pixels_of_a_person_that_a_shift_still_meets_tell_nothing():
    person = np.zeros((120, 80), np.bool_)
    person[10:110, 30:50] = True
    warmth = np.where(person, np.float32(1), np.float32(np.nan))  # nothing is seen around them
    warmth[85:110, 30:50] = 0.4  # shoes and trouser legs
    assert not is_warmer(warmth, person, (17.0, -27.0))
    warmth[~person] = 0
    assert is_warmer(np.roll(warmth, (-27, 17), axis=(0, 1)), person, (17.0, -27.0))


def contrast_naive(warmth, disc, shift):
    """Mean warmth inside less outside of a disc's rim under one shift (down, right)."""
    differences = []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        step = sign * np.eye(2, dtype=int)[axis]
        for at in np.argwhere(disc):
            if min(at) < 1 or disc[tuple(at + step)]:
                continue
            # The jump's middle is the pixel between the two that differ, on either side of the rim.
            for middle in (at, at + step):
                inside, outside = middle - SHIFT_PX * step + shift, middle + SHIFT_PX * step + shift
                if (np.array([inside, outside]) >= 0).all() and (
                    np.maximum(inside, outside) < warmth.shape
                ).all():
                    differences.append(warmth[tuple(inside)] - warmth[tuple(outside)])
    return np.nanmean(differences)


@pytest.mark.parametrize("shift", [(0, 0), (9, -12), (-15, 15)])
def test_a_contrast_is_the_mean_over_all_silhouettes_in_the_image(shift):
    cloud = warm_disc((52, 60), 26)
    cloud.temperature_c[np.random.default_rng(2).random(CAMERA.shape) < 0.2] = np.nan
    surface = contrasts(cloud, WINDOW_C, EVERYWHERE)
    disc, middle = cloud.depth_mm < 2500, len(surface) // 2
    at = tuple(middle + np.array(shift) // SHIFT_PX)
    expected = contrast_naive(warmth(cloud.temperature_c, WINDOW_C).clip(0, 1), disc, np.array(shift))
    assert surface[at] == pytest.approx(expected, abs=1e-6)


def test_nothing_is_said_where_there_is_no_silhouette_or_no_warmth():
    assert contrasts(warm_disc(), WINDOW_C, ~EVERYWHERE) is None
    assert misplacement_px(contrasts(warm_disc(person_c=20.0), WINDOW_C, EVERYWHERE)) is None


FRAMES = 8


@pytest.fixture(scope="module")
def session():
    rig = VirtualRig(FRAMES, 2, "clean", 3, RigOptions(draft=True))
    return rig.calibration, list(rig)


@pytest.mark.parametrize("turned_deg", [0.0, -2.0, 3.0])
def test_the_angle_is_found(session, turned_deg):
    calibration, frames = session
    turn = Pose(Rotation.from_euler("y", turned_deg, degrees=True).as_matrix(), np.zeros(3))
    turned = replace(calibration, thermal_from_depth=turn @ calibration.thermal_from_depth)
    drift = measure_drift(frames, turned)
    right, down = drift.shift_px
    expected_px = calibration.depth.fx * np.tan(np.radians(turned_deg))
    assert abs(abs(right) - abs(expected_px)) < 3.5
    assert abs(down) < 3.5
    assert drift.is_tolerable == (turned_deg == 0)
    assert drift.frames == FRAMES


def test_without_temperatures_nothing_can_be_said(session):
    calibration, frames = session
    blind = [replace(frame, thermal_c=None) for frame in frames]
    with pytest.raises(CalibrationError, match="0 frames"):
        measure_drift(blind, calibration)
