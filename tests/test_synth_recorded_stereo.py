"""Stereo after the maker's filters: laws of the filters, and what they leave of an image."""

from dataclasses import replace

import numpy as np
import pytest

from sensors.rig.camera import Intrinsics
from synth.cameras.depth_filters import Fill, decimate, fill_holes, smooth_between_edges
from synth.cameras.recorded_stereo import MELTING_PX, RecordedStereo
from synth.cameras.sensor import CleanDepth
from synth.cameras.stereo import Stereo

CAMERA = Intrinsics(160, 120, 500.0, 500.0, 79.5, 59.5)
PERFECT = Stereo(0, 0, 0, 0, 0, 0, 0, 0, camera=CAMERA, banded=False)
ANY = np.float32(np.inf)


def smoothed(image, alpha=0.5, delta=ANY, passes=2):
    image = image.astype(np.float32)
    smooth_between_edges(image, np.float32(alpha), np.float32(delta), passes)
    return image


def holed(seed, shape=(23, 31)):
    """Three levels with noise and holes."""
    rng = np.random.default_rng(seed)
    image = rng.choice([5.0, 7.0, 12.0], shape) + rng.normal(0, 0.5, shape)
    return np.where(rng.random(shape) < 0.2, 0, image).astype(np.float32)


def naive(image, alpha, delta, passes):
    """The maker's recursion: one state a line, along rows, then columns, in both directions."""

    def run(line):
        valid, state, previous = line[0] > 0, line[0], line[0]
        for k in range(1, len(line)):
            innovation = line[k]
            if innovation > 0 and valid:
                if -delta < previous - innovation < delta:
                    line[k] = state = innovation * alpha + state * (1 - alpha)
                else:
                    state = innovation
            elif innovation > 0:
                state = innovation
            valid, previous = innovation > 0, innovation

    image = image.astype(float)
    for _ in range(passes):
        for lines in (image, image.T):
            for line in lines:
                run(line)
                run(line[::-1])
    return image


@pytest.mark.parametrize("delta", [0.8, 3.0, np.inf])
def test_smoothing_equals_the_makers_recursion(delta):
    for seed in range(4):
        found = smoothed(holed(seed), 0.4, delta, 3)
        np.testing.assert_allclose(found, naive(holed(seed), 0.4, delta, 3), rtol=1e-5)
        assert ((found > 0) == (holed(seed) > 0)).all()


def test_smoothing_keeps_a_plane_and_edges_beyond_delta_and_mixes_lower_ones():
    step = np.full((20, 60), 4.0)
    np.testing.assert_array_equal(smoothed(step), step)
    step[:, 30:] = 9.0
    np.testing.assert_array_equal(smoothed(step, delta=5.0), step)
    ramp = smoothed(step, delta=5.1)
    np.testing.assert_allclose(ramp[:, [0, -1]], step[:, [0, -1]], atol=1e-3)
    assert (np.diff(ramp, axis=1) >= -1e-6).all() and 6 < ramp[:, 28:32].mean() < 7


@pytest.mark.parametrize(("alpha", "passes"), [(0.5, 2), (0.35, 1), (0.6, 3)])
def test_a_ramp_has_the_variance_of_the_recursions(alpha, passes):
    """Weights alpha (1 - alpha)^k have the variance (1 - alpha) / alpha^2; variances of runs add up."""
    step = np.where(np.arange(200) < 100, 4.0, 5.0)[None].repeat(3, axis=0)
    weights, at = np.diff(smoothed(step, alpha, passes=passes)[1].astype(float)), np.arange(199)
    variance = (weights * (at - weights @ at) ** 2).sum()
    assert variance == pytest.approx(2 * passes * (1 - alpha) / alpha**2, rel=1e-3)
    # Away from borders both directions are alike.
    noise = np.random.default_rng(0).normal(9, 1, (80, 80))
    one, other = smoothed(noise, alpha), smoothed(noise[::-1, ::-1], alpha)[::-1, ::-1]
    np.testing.assert_allclose(one[35:45, 35:45], other[35:45, 35:45], atol=1e-4)


def test_cells_have_the_lower_median_of_their_readings():
    image, source = holed(1, (24, 36)), np.arange(24 * 36, dtype=np.int32).reshape(24, 36)
    for found, given in zip(
        decimate(image, source, 1.0), (image, np.where(image > 0, source, -1)), strict=True
    ):
        np.testing.assert_array_equal(found, given)
    small, origin = decimate(image, source, 3.0)
    for i in range(8):
        for j in range(12):
            values = np.sort(image[3 * i : 3 * i + 3, 3 * j : 3 * j + 3], axis=None)
            values = values[values > 0]
            assert small[i, j] == (values[(len(values) - 1) // 2] if len(values) else 0)
    np.testing.assert_array_equal(image.ravel()[origin[origin >= 0]], small[origin >= 0])
    assert decimate(image, source, 1.45)[0].shape == (17, 25)


@pytest.mark.parametrize("mode", list(Fill))
def test_holes_take_depth_and_source_of_a_neighbour(mode):
    image, source = holed(2), np.arange(23 * 31, dtype=np.int32).reshape(23, 31)
    filled = image.copy()
    fill_holes(filled, source, mode)
    np.testing.assert_array_equal(filled[image > 0], image[image > 0])
    np.testing.assert_array_equal(filled, image.ravel()[source])
    hole = np.zeros((3, 4), np.float32)
    hole[:, :] = [[3, 3, 3, 3], [1, 0, 0, 2], [4, 4, 4, 4]]
    fill_holes(hole, np.arange(12, dtype=np.int32).reshape(3, 4), mode)
    wanted = {Fill.NONE: [0, 0], Fill.LEFT: [1, 1], Fill.FARTHEST: [4, 4], Fill.NEAREST: [1, 1]}
    np.testing.assert_array_equal(hole[1, 1:3], wanted[mode])


def edge():
    """A person 2 m away in front of a wall at 3 m."""
    depth, person = np.full(CAMERA.shape, 3.0, np.float32), np.zeros(CAMERA.shape, bool)
    person[:, 80:] = True
    depth[person] = 2.0
    return CleanDepth(CAMERA, depth, np.zeros(CAMERA.shape, np.float32)), person


def test_without_filters_the_reading_is_the_raw_one():
    clean, _ = edge()
    raw = replace(PERFECT, noise_px=0.1, fattened_px=2.0, patches=0.1)
    found = RecordedStereo(raw, passes=0, fill=Fill.NONE).read(clean, np.random.default_rng(3))
    for one, other in zip(found, raw.read(clean, np.random.default_rng(3)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_strong_filter_melts_a_person_into_the_wall_and_keeps_the_outline():
    clean, person = edge()
    melting = RecordedStereo(PERFECT, 1.45, 0.42, MELTING_PX, 2)
    depth, source = melting.read(clean, np.random.default_rng(0))
    row = depth[60].astype(int)
    assert row[0] == 3000 and row[-1] == 2000 and (np.diff(row) <= 0).all()
    assert 9 <= ((row < 2900) & (row > 2100)).sum() <= 15
    outline = person.ravel()[source][60]
    assert abs(int(outline.argmax()) - 80) <= 1 and (np.diff(outline.astype(int)) >= 0).all()
    # A cut-out person has the same depth at the pixels of the person, and a wall where nothing was rendered.
    alone = melting.read(replace(clean, person=person), np.random.default_rng(0))
    np.testing.assert_array_equal(alone.depth_mm, np.where(person.ravel()[source], depth, 0))
    nothing = replace(clean, person=person, depth_m=np.where(person, np.float32(2), np.float32(np.nan)))
    rim = melting.read(nothing, np.random.default_rng(0)).depth_mm[:, 80:83]
    assert (rim > 2010).all()
