"""The subject of a frame: found by warmth and shape, told from others, and not trusted where that fails."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.frame_labels import FrameLabels
from annotate.person.extract import PersonDetection
from annotate.person.planes import MOST_PLANES, find_planes
from annotate.person.subject import cloths_shown
from annotate.person.warmth import WINDOW_C
from annotate.suit.palette import DEFAULT_SUIT
from sensors.importers.clouds.cloud_source import CloudFile
from sensors.rig.camera import rays
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tests.helpers.furnished_room import CAMERA, celsius_of, cloud_of, seen


def survey_of(cloud, window_c=None):
    return PersonDetection(CoarseCloud.of(cloud), window_c)


def warm(people=((1, 0.0),), **how):
    """Cloud of people (number, x) in a furnished room, and who is where."""
    depth, whose = seen(people, **how)
    return cloud_of(depth, celsius=celsius_of(whose)), whose


def with_celsius(cloud, where, celsius):
    return replace(cloud, temperature_c=np.where(where, np.float32(celsius), cloud.temperature_c))


def iou(found, truth):
    return (found & truth).sum() / (found | truth).sum()


def test_planes_are_where_they_were_put_and_the_largest_come_first():
    ray = rays(CAMERA)
    floor = np.where(ray[..., 1] > 0.1, 0.95 / np.maximum(ray[..., 1], 0.1), np.inf)
    cloud = cloud_of(np.minimum(floor, 3.4) + np.random.default_rng(0).normal(0, 0.003, CAMERA.shape))
    found = find_planes(cloud)[:2]
    normals = [tuple(abs(plane.normal.round(1)).tolist()) for plane in found]
    assert normals == [(0, 0, 1), (0, 1, 0)]
    assert [round(abs(plane.offset_m), 2) for plane in found] == [3.4, 0.95]


def test_a_rough_surface_far_away_is_not_a_plane_for_each_of_its_facets():
    rng, tile = np.random.default_rng(1), 50
    v, u = np.indices(CAMERA.shape)
    at, slopes = (
        (v // tile, u // tile),
        rng.uniform(-0.02, 0.02, (2, 1 + v.max() // tile, 1 + u.max() // tile)),
    )
    facets = slopes[0][at] * (v % tile) + slopes[1][at] * (u % tile)
    assert len(find_planes(cloud_of(8 + facets))) == MOST_PLANES


def test_hair_and_shoes_below_the_window_are_recovered():
    cloud, whose = warm()
    rows = np.arange(CAMERA.height)[:, None]
    top, bottom = np.flatnonzero((whose == 1).any(axis=1))[[0, -1]]
    ends = (whose == 1) & ((rows < top + 18) | (rows > bottom - 14))
    cloud = with_celsius(cloud, ends, 23.5)
    window_only = (cloud.temperature_c >= 25) & (cloud.temperature_c <= 35)
    truth = (whose == 1) & cloud.valid
    assert iou(survey_of(cloud).person().mask, truth) > max(0.96, iou(window_only, truth) + 0.02)


def test_points_without_temperature_go_with_their_surface():
    cloud, whose = warm()
    unseen = np.kron(np.random.default_rng(1).random((33, 40)) < 0.35, np.ones((8, 8))).astype(bool)
    cloud = with_celsius(cloud, unseen, np.nan)
    assert iou(survey_of(cloud).person().mask, (whose == 1) & cloud.valid) > 0.93


def test_without_a_warm_person_the_mask_is_empty_and_a_note_says_so():
    """In an empty room, without a reading, with a person as cold as the room, after labels of a person."""
    cloud, whose = warm()
    before = labels_of(cloud, survey_of(cloud).person())
    cold = with_celsius(cloud, whose > 0, 20.5)
    for one in (warm(())[0], cloud_of(np.full(CAMERA.shape, np.nan)), cold, cloud_of(seen((), seed=1)[0])):
        for known in (None, before):
            found = survey_of(one).person(known)
            assert not found.mask.any() and found.mask.dtype == bool and "no person" in found.notes[0]


def test_persons_are_kept_apart_from_furniture_and_from_one_another():
    cloud, whose = warm(((1, -0.1), (2, 0.75)))
    found = survey_of(cloud).person()
    assert found.method == "thermal" and found.trusted and found.notes == ()
    assert iou(found.mask, (whose == 1) & cloud.valid) > 0.97 and not (found.others & found.mask).any()
    assert iou(found.others, (whose == 2) & cloud.valid) > 0.95


def test_three_equal_persons_and_a_person_larger_than_the_view_are_not_trusted():
    cloud, _ = warm(((1, -1.0), (1, -0.3), (1, 0.4)))
    found = survey_of(cloud).person()
    assert not found.trusted and "3 persons" in found.notes[-1] and "step aside" in found.notes[-1]
    assert survey_of(cloud).person(labels_of(cloud, found)).trusted
    near = survey_of(warm(((1, 0.0),), eye=(0.0, -0.5, 1.2))[0]).person()
    assert not near.trusted and "larger than" in near.notes[-1] and "back" in near.notes[-1]


def test_small_and_flat_warm_things_are_no_persons():
    cloud, whose = warm()
    things = np.zeros(CAMERA.shape, bool)
    things[40:130, 255:315] = things[150:162, 20:30] = True  # a sunlit wall, a mug
    cloud = with_celsius(cloud, things & (whose == 0) & cloud.valid, 32.0)
    found = survey_of(cloud).person()
    assert not found.others.any() and iou(found.mask, (whose == 1) & cloud.valid) > 0.97


@pytest.mark.parametrize("drift", [-3.0, 0.3, 2.0])
def test_a_common_offset_of_all_temperatures_changes_nothing(drift):
    cloud, _ = warm()
    drifted = replace(cloud, temperature_c=cloud.temperature_c + np.float32(drift))
    assert iou(survey_of(drifted).person().mask, survey_of(cloud).person().mask) > 0.998
    given_ = survey_of(drifted, (25 + drift, 35 + drift)).person()
    assert iou(given_.mask, survey_of(cloud, (25, 35)).person().mask) > 0.999


def test_how_hot_a_radiator_far_away_is_does_not_matter():
    cloud, whose = warm()
    radiator = np.zeros(CAMERA.shape, bool)
    radiator[120:160, 280:318] = True
    hot = (with_celsius(cloud, radiator & (whose == 0) & cloud.valid, celsius) for celsius in (45.0, 80.0))
    np.testing.assert_array_equal(*(survey_of(one).person().mask for one in hot))


def test_a_mirrored_cloud_gives_the_mirrored_mask():
    cloud, _ = warm()
    metres, celsius = cloud.points_m[:, ::-1, 2], cloud.temperature_c[:, ::-1]
    mirrored = survey_of(cloud_of(metres, celsius=celsius)).person().mask[:, ::-1]
    assert iou(mirrored, survey_of(cloud).person().mask) > 0.98


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), warm=st.floats(0, 1), holes=st.floats(0, 1))
def test_the_mask_is_a_subset_of_the_valid_pixels(seed, warm, holes):
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(0.8, 3, (33, 40)), np.ones((8, 8)))
    depth = np.where(rng.random(CAMERA.shape) < holes, np.nan, blocks)
    celsius = np.where(rng.random(CAMERA.shape) < warm, 30, 20).astype(np.float32)
    celsius[rng.random(CAMERA.shape) < 0.2] = np.nan
    cloud = cloud_of(depth, celsius=celsius)
    found = survey_of(cloud).person()
    assert not found.mask[~cloud.valid].any()
    np.testing.assert_array_equal(found.mask, survey_of(cloud).person().mask)


def test_on_the_virtual_rig_the_person_is_found_where_the_fixed_window_fails():
    rig = VirtualRig(2, 2, "normal", 104, RigOptions(draft=True))
    fuser = Fuser(rig.calibration)
    for frame, truth in rig.with_truth():
        labels = truth_labels(frame, truth)
        cloud = fuser.fuse_frame(frame)
        known, person = labels.parts != 255, labels.persons == 1
        window = cloud.valid & (cloud.temperature_c >= WINDOW_C[0]) & (cloud.temperature_c <= WINDOW_C[1])
        found, plain = (iou(m & known, person & known) for m in (survey_of(cloud).person().mask, window))
        assert found > max(0.92, plain + 0.05)


def test_halves_above_and_below_a_thing_held_before_the_body_are_one_person():
    cloud, whose = warm()
    middle = int(np.flatnonzero((whose == 1).any(axis=1)).mean())
    board = np.zeros(CAMERA.shape, bool)
    board[middle - 14 : middle + 14, 110:210] = True
    held = cloud_of(
        np.where(board, 1.7, cloud.points_m[..., 2]), celsius=np.where(board, 20.5, cloud.temperature_c)
    )
    found = survey_of(held).person()
    assert not found.others.any() and iou(found.mask, (whose == 1) & held.valid & ~board) > 0.95


def test_a_thermal_image_beside_the_depth_image_is_not_trusted():
    cloud, _ = warm()
    moved = replace(cloud, temperature_c=np.roll(cloud.temperature_c, 15, axis=1))
    found = survey_of(moved).person()
    assert not found.trusted and "thermal" in found.notes[-1] and "calibrate" in found.notes[-1]
    angle = re.search(r"([\d.]+) degrees", found.notes[-1])
    assert float(angle[1]) == pytest.approx(3.75, abs=0.06) and "+15, +0 pixels" in found.notes[-1]
    assert survey_of(cloud).person().trusted


def labels_of(cloud, found):
    persons = np.where(found.mask, 1, np.where(found.others, 2, 0)).astype(np.uint8)
    parts = np.where(found.mask, 255, 0).astype(np.uint8)
    return FrameLabels("000000", cloud.depth_mm, parts, notes={"extraction": found.method}, persons=persons)


def test_while_the_flag_is_closed_the_subject_stays_the_subject():
    cloud, whose = warm(((1, -0.1), (2, 0.75)))
    found = survey_of(cloud).person()
    other = replace(found, mask=found.others, persons=np.array([0, 2, 1], np.uint8)[found.persons])
    closed = with_celsius(warm(((1, -0.1), (2, 0.75)), seed=1)[0], np.ones(CAMERA.shape, bool), np.nan)
    for before, subject in ((found, 1), (other, 2)):
        now = survey_of(closed).person(labels_of(cloud, before))
        assert now.method == "depth" and now.trusted and "depth alone" in now.notes[0]
        assert iou(now.mask, (whose == subject) & closed.valid) > 0.85


def depth_only(path):
    recording = CloudFile(path)
    cloud = Fuser(recording.calibration).fuse(next(iter(recording)).depth_mm)
    return cloud, survey_of(cloud).person().mask


def test_real_people_without_temperature(shared_data):
    for path in sorted((shared_data / "kinect2_standing").glob("*.pcd")):
        cloud, mask = depth_only(path)
        assert mask.sum() > 0.9 * cloud.valid.sum()
    cloud, mask = depth_only(shared_data / "pcl_person" / "person.pcd")
    near = cloud.valid & (cloud.points_m[..., 2] < 1.1)  # a head and shoulders in front of an office
    assert iou(mask, near) > 0.95


def test_a_suit_tells_more_of_parts_than_clothes_and_noise_tells_nothing():
    cloud, rng = warm()[0], np.random.default_rng(1)
    person = cloud.temperature_c > 25
    told = {}
    for name, colors in {
        "wall": np.array([[180, 180, 180]]),
        "noise": rng.integers(18, 30, (5000, 3)),
        "clothes": np.array([[150, 40, 40], [40, 40, 120]]),
        "suit": DEFAULT_SUIT.colors_rgb,
    }.items():
        rgb = np.zeros((*CAMERA.shape, 3), np.uint8)
        rgb[person] = np.repeat(colors, -(-person.sum() // len(colors)), axis=0)[: person.sum()]
        told[name] = cloths_shown(
            DEFAULT_SUIT, replace(cloud, color_valid=cloud.valid, color_rgb=rgb), person
        )
    assert told["suit"] > 2 * told["clothes"] > 0 and told["suit"] > 3 * max(told["wall"], told["noise"])
