"""Drawn depth sensors: what each kind makes of known surfaces, and the laws that all of them keep."""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest

from sensors.rig.camera import Intrinsics
from synth.cameras.maker_filters import Filtered
from synth.cameras.pixel_random import NORMALS, chance_of, lattice, ramps, smooth
from synth.cameras.random_sensor import draw_sensor
from synth.cameras.recorded_stereo import RecordedStereo
from synth.cameras.sensor import REACH_PX, CleanDepth, Reading
from synth.cameras.smoothed_lidar import SmoothedLidar
from synth.cameras.stereo import Stereo
from synth.cameras.structured_light import StructuredLight
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import table
from synth.images.silhouette_statistics import holes, largest_piece, roughness

CAMERA = Intrinsics(160, 120, 500.0, 500.0, 79.5, 59.5)
NO_LIGHT = StructuredLight(0, 0, 0, 0, 1, shadow=0, grazing=0, dark=0, holes=0)
NO_STEREO = Stereo(0, 0, 0, 0, 0, 0, 0, 0)
PERFECT = (TimeOfFlight(0, 0, 0, 0, 0), NO_LIGHT, NO_STEREO, Filtered(0))
DARK = np.zeros(CAMERA.shape, np.float32)
DARK[30:45, 60:100] = 1.0


def scene():
    """Depth, and pixels of a person with a hand in front and a wall behind; no hit at the left."""
    depth = np.full(CAMERA.shape, 3.0, np.float32)
    depth[:, :30] = np.nan
    person = np.zeros(CAMERA.shape, bool)
    person[20:100, 50:110] = True
    depth[person] = 2.0
    depth[40:60, 70:90] = 1.6
    return depth, person


def read(sensor, seed=0, depth=None, **more):
    rng = np.random.default_rng(seed)
    return sensor.read(CleanDepth(CAMERA, scene()[0] if depth is None else depth, DARK, **more), rng)


def drawn(n):
    return [draw_sensor(np.random.default_rng(seed)) for seed in range(n)]


@pytest.mark.parametrize("sensor", PERFECT, ids=lambda s: s.kind)
def test_without_faults_depth_is_rounded_alone(sensor):
    depth, person = scene()
    reading = read(sensor, person=person)
    np.testing.assert_array_equal(reading.depth_mm, np.where(person, np.rint(1000 * depth), 0))
    np.testing.assert_array_equal(reading.source[person], np.flatnonzero(person))
    assert (reading.source[~person] == -1).all()


def test_laws_of_all_sensors():
    depth, person = scene()
    only = np.random.default_rng(0).random(CAMERA.shape) < 0.4
    for seed, sensor in enumerate(drawn(60)):
        whole = read(sensor, seed, person=person)
        again, part = read(sensor, seed, person=person), read(sensor, seed, person=person, only=only)
        for one, same, some, nothing in zip(whole, again, part, (0, -1), strict=True):
            np.testing.assert_array_equal(one, same)
            # No pixel depends on whether another is wanted.
            np.testing.assert_array_equal(some, np.where(only, one, nothing))
        there = whole.depth_mm > 0
        assert (there == (whole.source >= 0)).all()
        assert person.ravel()[whole.source[there]].all(), sensor
        # Readings are near the person, at the depth of a surface or, where pixels fly, between two.
        assert not (there & ~cv2.dilate(person.view(np.uint8), np.ones((33, 33))).view(bool)).any()
        off = np.abs(whole.depth_mm[there] / 1000 - depth.ravel()[whole.source[there]])
        clear = 0.5 if isinstance(sensor, (RecordedStereo, SmoothedLidar)) else 0.75
        assert np.quantile(off, clear) < 0.06 and off.max() < 0.75, sensor


def test_labels_follow_the_readings():
    reading = Reading(np.array([[5, 0, 7]], np.uint16), np.array([[1, -1, 2]], np.int32))
    np.testing.assert_array_equal(reading.carry(np.array([[3, 4, 9]], np.uint8)), [[4, 0, 9]])


def test_the_mix_is_that_of_the_table_and_every_strength_reaches_zero():
    sensors, kinds = drawn(1500), table("sensors")
    models = Counter(s.model for s in sensors)
    for entry in kinds.values():
        share = sum(models[m["model"]] for m in entry["models"]) / len(sensors)
        assert share == pytest.approx(entry["share"], abs=0.04)
    spans = {m["model"]: m for entry in kinds.values() for m in entry["models"]}
    for sensor in sensors:
        low, high = spans[sensor.model]["focal_px"]
        assert low <= sensor.camera.fx == sensor.camera.fy <= high
        assert [sensor.camera.width, sensor.camera.height] == spans[sensor.model]["size"]
    strengths = ("axial", "flying", "grazing", "lateral_px", "patches", "ragged_px", "shadow", "noise_px",
                 "holes", "melted", "step_per_m", "fattened_px", "wave_px", "ripple_mm")  # fmt: skip
    for name in strengths:
        values = np.array([getattr(s, name) for s in sensors if hasattr(s, name)])
        assert 0.05 < (values == 0).mean() < 0.9 and values.max() > 0, name
    flight = [s for s in sensors if isinstance(s, TimeOfFlight)]
    clean = [s.flying == s.grazing == s.patches == s.dark == s.lateral_px == 0 for s in flight]
    assert 0.15 < np.mean(clean) < 0.4
    # Hair is lost in few images, so that holes do not tell the back of a head from a face.
    assert np.mean([getattr(s, "dark", 0) > 0 for s in sensors]) < 0.25


@pytest.mark.parametrize("log2", [1, 3])
def test_smooth_noise_is_standard_normal_everywhere_and_alike_nearby(log2):
    side = 128
    images = np.array([
        [[smooth(corners, ramps(log2), v, u, log2) for u in range(8)] for v in range(8)]
        for corners in (lattice(np.uint64(k), side, side, log2, NORMALS) for k in range(800))
    ])  # fmt: skip
    np.testing.assert_allclose(images.std(axis=0), 1, atol=0.12)
    near = np.corrcoef(images[:, 2, 2], images[:, 2, 3])[0, 1]
    assert near > (0.8 if log2 == 3 else 0.3)
    assert np.mean([chance_of(n) for n in images[:, 0, 0]]) == pytest.approx(0.5, abs=0.04)


# --- structured light ------------------------------------------------------------------------------


def test_structured_lights_steps_grow_with_the_square_of_depth():
    ramp = np.broadcast_to(np.linspace(1, 4, 160, dtype=np.float32), CAMERA.shape)
    levels = np.unique(read(replace(NO_LIGHT, step_per_m=0.0029), depth=ramp).depth_mm).astype(float)
    middle = (levels[1:] + levels[:-1]) / 2
    steps = np.diff(levels)
    far = middle > 3000  # nearer the ramp itself is coarser
    np.testing.assert_allclose(steps[far], 2.9e-6 * middle[far] ** 2, atol=1.1)


@pytest.mark.parametrize("rim_px", [-2, 2])
def test_structured_lights_rims_grow_and_shrink(rim_px):
    _, person = scene()
    there = read(replace(NO_LIGHT, rim_px=rim_px), person=person).depth_mm > 0
    width = [np.count_nonzero(there[60]), np.count_nonzero(there[:, 60])]
    assert width == [60 + 2 * rim_px, 80 + 2 * rim_px]
    ragged = read(replace(NO_LIGHT, ragged_px=1.0, block_log2=1), person=person).depth_mm > 0
    assert (ragged & ~person).any() and (person & ~ragged).any()


def test_a_shadow_falls_on_one_side_as_wide_as_the_parallax():
    _, person = scene()
    for sensor in (
        replace(NO_LIGHT, shadow=1.0, baseline_m=0.075),
        replace(NO_STEREO, shadow=1.0, baseline_m=0.075),
    ):
        lost = person & (read(sensor, person=person).depth_mm == 0)
        expected = np.zeros_like(person)
        # 500 px x 75 mm x (1 / 1.6 m - 1 / 2 m) = 4.7 px to the left of what stands before the trunk.
        expected[40:60, 66:70] = True
        np.testing.assert_array_equal(lost, expected)
    mirrored = person & (read(replace(NO_LIGHT, shadow=1.0, baseline_m=-0.075), person=person).depth_mm == 0)
    assert mirrored[50, 90:94].all() and not mirrored[50, :90].any()


def test_feet_melt_into_the_floor_they_stand_on_and_into_nothing_else():
    depth, person = scene()
    depth[100:] = 2.02
    melting = replace(NO_LIGHT, melted=1.0, block_log2=2)
    reading = read(melting, depth=depth, person=person)
    there = reading.depth_mm > 0
    grown, lost = there & ~person, person & ~there
    assert grown[100:108, 50:110].mean() == pytest.approx(0.5, abs=0.2) and not grown[:100].any()
    assert lost[92:100, 50:110].mean() == pytest.approx(0.5, abs=0.2) and not lost[:92].any()
    assert (reading.depth_mm[grown] == 2020).all()
    assert (read(melting, depth=depth).depth_mm > 0).sum() == np.isfinite(depth).sum()


def test_narrow_things_are_lost():
    _, person = scene()
    person[10:20, 60:62] = True
    for sensor in (replace(NO_LIGHT, least_px=3), Filtered(0, least_px=3)):
        there = read(sensor, person=person).depth_mm > 0
        assert not there[:20].any() and there[22:98, 52:108].all()


def test_dark_surfaces_are_lost_by_their_share_in_every_kind():
    for sensor in (*PERFECT[:3],):
        sensor = replace(sensor, dark=0.5)
        lost = np.mean([read(sensor, seed).depth_mm[DARK > 0] == 0 for seed in range(20)])
        assert lost == pytest.approx(0.5, abs=0.05), sensor
        assert (read(sensor).depth_mm[(DARK == 0) & np.isfinite(scene()[0])] > 0).all()


@pytest.mark.parametrize("sensor", [NO_LIGHT, NO_STEREO], ids=lambda s: s.kind)
def test_steep_surfaces_are_lost_and_their_rims_are_not(sensor):
    sensor = replace(sensor, grazing=1.0)
    # A wall that turns away: at 80 degrees (1 - 4 cos^2)^4 is 0.60.
    away = (2 / (1 - np.tan(np.radians(80)) * (np.arange(160) - 79.5) / 500)).astype(np.float32)
    wall = np.broadcast_to(np.where(np.abs(away - 2) < 0.5, away, np.nan), CAMERA.shape)
    there = np.isfinite(wall)
    there[:, :-1] &= there[:, 1:]
    lost = [read(sensor, seed, depth=wall).depth_mm[there] == 0 for seed in range(20)]
    assert np.mean(lost) == pytest.approx(0.6, abs=0.08)
    depth, person = scene()
    assert (read(sensor, depth=depth, person=person).depth_mm[person] > 0).all()


# --- stereo ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [1.0, 2.0, 4.0])
def test_stereo_noise_grows_with_the_square_of_depth(distance):
    depth = np.full(CAMERA.shape, distance, np.float32)
    sensor = replace(NO_STEREO, noise_px=0.08, baseline_m=0.05)
    spread = np.mean([read(sensor, seed, depth=depth).depth_mm.std() for seed in range(4)])
    assert spread == pytest.approx(1000 * distance**2 * 0.08 / (500 * 0.05), rel=0.1)


def test_stereo_fattens_edges_with_the_depth_of_what_is_near():
    _, person = scene()
    reading = read(replace(NO_STEREO, fattened_px=2.5), person=person)
    grown = (reading.depth_mm > 0) & ~person
    assert 1 < np.count_nonzero(grown) / (2 * (60 + 80)) < 3
    assert (reading.depth_mm[grown] == 2000).all()
    assert not grown[:, : 50 - REACH_PX].any()


# --- figures ---------------------------------------------------------------------------------------


def disc(radius):
    v, u = np.mgrid[-60:61, -60:61]
    return v * v + u * u <= radius * radius


def test_figures_of_shapes_without_and_with_faults():
    person = disc(40)
    assert holes(person) == 0 and roughness(person) == pytest.approx(1, abs=0.03)
    pierced = person.copy()
    pierced[60:63, 60:63] = pierced[50, 50] = False
    assert holes(pierced) == pytest.approx(10 / person.sum())
    # Neither a gap between limbs, nor an open ring, nor an island outside is a hole.
    open_ring = person & ~disc(10)
    open_ring[60, 60:] = False
    open_ring[0, 0] = True
    assert holes(person & ~disc(10)) == holes(open_ring) == 0
    assert not largest_piece(open_ring)[0, 0]
    teeth = person & ~((np.arange(121)[:, None] % 4 < 2) & (np.arange(121) > 95))
    assert roughness(teeth) > 1.15
    assert holes(np.zeros((5, 5), bool)) == 0


def test_real_filtered_depth_has_few_holes_and_a_clean_rim(shared_data):
    paths = sorted((shared_data / "real_people" / "frames" / "depth").glob("*.png"))
    if not paths:
        pytest.skip("no real people: ../shared/data/real_people is absent")
    people = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0 for path in paths[::9]]
    assert np.median([holes(person) for person in people]) < 0.006
    assert np.median([roughness(person) for person in people]) == pytest.approx(1.12, abs=0.03)
