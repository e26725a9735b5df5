"""The depth camera's faults: measured against their formulas, and absent when they are switched off."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.rig.camera import Intrinsics, rays
from synth.cameras.sensor import CleanDepth
from synth.cameras.time_of_flight import TimeOfFlight, axial_sigma_mm

CAMERA = Intrinsics(160, 120, 365.0, 365.0, 79.5, 59.5)
OFF = TimeOfFlight(axial=0, flying=0, grazing=0, dark=0, lateral_px=0)
NOTHING_DARK = np.zeros(CAMERA.shape, bool)


def plane(distance_m, slope=0.0):
    """Depth of a plane whose z grows by ``slope`` per metre to the right."""
    return (distance_m / (1 - slope * rays(CAMERA)[..., 0])).astype(np.float32)


def fankhauser_mm(z, theta):
    """Fankhauser et al. 2015, eq. 4, written out in float64."""
    return 1.5 - 0.5 * z + 0.3 * z**2 + 0.1 * z**1.5 * theta**2 / (np.pi / 2 - theta) ** 2


def noise(depth, faults, seed=0, **more):
    dark, rng = more.pop("dark", NOTHING_DARK), np.random.default_rng(seed)
    return faults.read(CleanDepth(CAMERA, depth, dark, **more), rng).depth_mm


@given(z=st.floats(0.5, 4.5), theta=st.floats(0, 1.4))
@settings(deadline=None)
def test_axial_sigma_is_fankhausers(z, theta):
    assert axial_sigma_mm(np.float32(z), np.float32(theta)) == pytest.approx(
        fankhauser_mm(z, theta), rel=1e-3
    )


def test_axial_sigma_is_finite_at_grazing_incidence():
    assert np.isfinite(axial_sigma_mm(np.float32(2), np.float32(np.pi / 2)))


@pytest.mark.parametrize("slope", [0.0, 0.8, 1.7])
@pytest.mark.parametrize("distance", [1.0, 2.0, 3.2])
def test_measured_noise_has_the_formulas_sigma(distance, slope):
    depth = plane(distance, slope)[40:80, 60:100]
    window = Intrinsics(40, 40, 365.0, 365.0, 19.5, 19.5)
    clean = CleanDepth(window, depth, np.zeros(depth.shape, bool))
    rng = np.random.default_rng(1)
    faults = replace(OFF, axial=1)
    images = np.stack([faults.read(clean, rng).depth_mm for _ in range(120)]).astype(float)
    measured = images[:, 2:-2, 2:-2].std(axis=0)
    ray = rays(window)[2:-2, 2:-2]
    normal = np.array([slope, 0, -1]) / np.hypot(slope, 1)
    theta = np.arccos(np.abs(ray @ normal) / np.linalg.norm(ray, axis=2))
    # Rounding to whole millimetres adds 1/12 to the variance.
    expected = np.sqrt(fankhauser_mm(depth[2:-2, 2:-2].astype(float), theta) ** 2 + 1 / 12)
    assert np.median(measured / expected) == pytest.approx(1, abs=0.02)
    bias = (images[:, 2:-2, 2:-2] - 1000 * depth[2:-2, 2:-2]).mean()
    assert abs(bias) < 0.05 * expected.mean()


@given(seed=st.integers(0, 2**32 - 1), distance=st.floats(0.6, 4.0))
@settings(max_examples=20, deadline=None)
def test_without_faults_the_depth_is_rounded_alone(seed, distance):
    depth = plane(distance, 0.3)
    depth[:, :20] = np.nan
    depth[50:70, 50:70] = 0.55
    clean = np.rint(np.nan_to_num(depth) * np.float32(1000))
    expected = np.where((clean < 500) | (clean > 4500), 0, clean)
    np.testing.assert_array_equal(noise(depth, OFF, seed), expected)


def test_offset_and_scale_are_the_units_error():
    assert (noise(plane(2.0), replace(OFF, offset_mm=20, scale=1.01)) == 2040).all()


def test_a_silhouette_loses_and_mixes_pixels_and_a_wall_does_not():
    depth = plane(3.0)
    depth[30:90, 40:120] = 1.5
    noisy = noise(depth, replace(OFF, flying=1)).astype(float)
    border = np.zeros(CAMERA.shape, bool)
    border[29:91, 39:121] = True
    border[31:89, 41:119] = False
    mixed = (noisy > 1510) & (noisy < 2990)
    assert not mixed[~border].any() and not (noisy == 0)[~border].any()
    assert (noisy[border] == 0).mean() == pytest.approx(0.6, abs=0.06)
    # They lean to the foreground, and float at most 0.6 m behind it.
    assert mixed[border].sum() > 50 and noisy[mixed].max() <= 2101


@pytest.mark.parametrize("slope", [0.0, 2.0, 4.0])
def test_grazing_surfaces_are_lost_with_the_eighth_power_of_the_incidence(slope):
    middle = np.s_[:, 70:90]
    lost = noise(plane(1.0, slope), replace(OFF, grazing=1))[middle] == 0
    ray = rays(CAMERA)[middle]
    theta = np.arccos(np.abs(ray @ [slope, 0, -1]) / np.hypot(slope, 1) / np.linalg.norm(ray, axis=2))
    assert lost.mean() == pytest.approx(((theta / (np.pi / 2)) ** 8).mean(), abs=0.03)


def test_lateral_noise_moves_edges_by_a_pixel_and_leaves_flat_parts():
    depth = plane(2.0)
    depth[:, 80:] = 2.04
    noisy = noise(depth, replace(OFF, lateral_px=1))
    moved = noisy != np.rint(1000 * depth)
    assert moved[:, 78:82].mean() > 0.1
    assert not moved[:, :76].any() and not moved[:, 84:].any()
