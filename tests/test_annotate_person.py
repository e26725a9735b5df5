"""The person in analytic scenes, on the virtual rig, and in real recordings without temperature."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.person.extract import Survey
from annotate.person.persons import _joined
from annotate.person.pixel_odds import WINDOW_C
from annotate.person.planes import find_planes
from annotate.person.subject import suit_told
from annotate.suit.palette import DEFAULT_SUIT
from sensors.importers.pointcloud import CloudFile
from sensors.rig.camera import Intrinsics, rays
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import VirtualRig

CAMERA = Intrinsics(256, 212, 183.0, 183.0, 127.5, 105.5)
RAYS = rays(CAMERA)


def survey_of(cloud, window_c=None):
    return Survey(CoarseCloud.of(cloud), window_c)


class Scene:
    """Ray-traced spheres and planes; what was hit last in front counts. Camera frame, metres."""

    def __init__(self):
        self.z = np.full(CAMERA.shape, np.inf)
        self.celsius = np.full(CAMERA.shape, np.nan)
        self.person = np.zeros(CAMERA.shape, bool)

    def put(self, z, celsius, person=False):
        front = z < self.z
        self.z[front], self.person[front] = z[front], person
        self.celsius[front] = celsius

    def ellipsoid(self, centre, radii, celsius, person=True):
        """|(p - c) / r| = 1 along p = t ray."""
        d, c = RAYS / radii, np.divide(centre, radii)
        a, b, k = (d * d).sum(-1), d @ c, c @ c - 1
        inside = b * b - a * k
        root = np.where(inside >= 0, (b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        self.put(root, celsius, person)

    def plane(self, normal, offset, celsius, where=None):
        """normal . p = offset, kept where ``where(points)``."""
        with np.errstate(divide="ignore"):
            z = offset / (RAYS @ np.asarray(normal, float))
        z = np.where(z > 0, z, np.inf)
        if where is not None:
            points = np.where(np.isfinite(z), z, 0)[..., None] * RAYS
            z = np.where(where(points), z, np.inf)
        self.put(z, celsius)

    def cloud(self, seed=0, holes=0.0, unseen=None):
        rng = np.random.default_rng(seed)
        z = np.where(np.isfinite(self.z), self.z + rng.normal(0, 0.003, self.z.shape), 0)
        z[(rng.random(z.shape) < holes) | (z > 4.5)] = 0
        depth = np.rint(z * 1000).astype(np.uint16)
        celsius = (self.celsius + rng.normal(0, 0.08, z.shape)).astype(np.float32)
        celsius[(depth == 0) | (unseen if unseen is not None else False)] = np.nan
        return cloud_of(depth, celsius)


def cloud_of(depth_mm, celsius):
    metres = np.where(depth_mm > 0, depth_mm / 1000, np.nan)
    points = (RAYS * metres[..., None]).astype(np.float32)
    return ThermalCloud(
        CAMERA, depth_mm, points, np.zeros((*CAMERA.shape, 3), np.uint8), depth_mm > 0, celsius
    )


def room():
    scene = Scene()
    scene.plane((0, 0, 1), 3.4, 20.5)
    scene.plane((0, 1, 0), 0.95, 20.0)
    return scene


def sitting(hair_c=26.0, shoe_c=28.0):
    """A person of ellipsoids on a sofa whose seat and back they touch."""
    scene = room()
    scene.plane((0, 0, 1), 2.45, 21.5, lambda p: (abs(p[..., 0]) < 0.8) & (p[..., 1] > -0.1))
    scene.plane(
        (0, 1, 0), 0.42, 21.5, lambda p: (abs(p[..., 0]) < 0.8) & (p[..., 2] > 1.9) & (p[..., 2] < 2.5)
    )
    scene.plane((0, 0, 1), 1.9, 21.5, lambda p: (abs(p[..., 0]) < 0.8) & (p[..., 1] > 0.42))
    scene.ellipsoid((0, 0.05, 2.36), (0.2, 0.33, 0.12), 30.5)
    scene.ellipsoid((0, -0.43, 2.32), (0.09, 0.13, 0.1), 33.5)
    scene.ellipsoid((0, -0.5, 2.33), (0.095, 0.09, 0.11), hair_c)
    for side in (-1, 1):
        scene.ellipsoid((side * 0.12, 0.36, 2.05), (0.08, 0.08, 0.3), 29.5)
        scene.ellipsoid((side * 0.13, 0.62, 1.8), (0.06, 0.3, 0.06), 28.8)
        scene.ellipsoid((side * 0.13, 0.88, 1.74), (0.05, 0.06, 0.12), shoe_c)
        scene.ellipsoid((side * 0.27, 0.02, 2.26), (0.05, 0.3, 0.06), 30.0)
    return scene


def iou(found, truth):
    return (found & truth).sum() / (found | truth).sum()


def truth_of(scene, cloud):
    return scene.person & cloud.valid


def test_planes_are_where_they_were_put_and_the_largest_come_first():
    cloud = sitting().cloud()
    found = find_planes(cloud, cloud.valid)
    assert {
        (tuple(abs(plane.normal.round(1)).tolist()), round(abs(plane.offset_m), 1)) for plane in found
    } >= {
        ((0, 0, 1), 3.4),
        ((0, 1, 0), 1.0),
    }
    on = [np.count_nonzero(plane.close(cloud.points_m)) for plane in found]
    assert max(on) < 2 * on[0]


def test_a_person_on_a_sofa_is_found_and_the_sofa_is_not():
    scene = sitting()
    cloud = scene.cloud()
    found = survey_of(cloud).person()
    assert found.method == "thermal" and found.notes == ()
    assert iou(found.mask, truth_of(scene, cloud)) > 0.97


def test_hair_and_shoes_below_the_window_are_recovered():
    scene = sitting(hair_c=24.0, shoe_c=24.2)
    cloud = scene.cloud(holes=0.05)
    window_only = (cloud.temperature_c >= 25) & (cloud.temperature_c <= 35)
    truth = truth_of(scene, cloud)
    assert iou(survey_of(cloud).person().mask, truth) > 0.96 > iou(window_only, truth) + 0.02


def test_points_without_temperature_go_with_their_surface():
    scene = sitting()
    rng = np.random.default_rng(1)
    unseen = np.kron(rng.random((27, 32)) < 0.35, np.ones((8, 8))).astype(bool)[:212, :256]
    cloud = scene.cloud(unseen=unseen)
    assert iou(survey_of(cloud).person().mask, truth_of(scene, cloud)) > 0.93


def test_small_and_flat_warm_things_are_no_persons():
    scene = sitting()
    scene.ellipsoid((-1.2, 0.3, 2.6), (0.05, 0.06, 0.05), 33.0, person=False)
    scene.plane((0, 0, 1), 3.3, 31.0, lambda p: (p[..., 0] > 0.5) & (abs(p[..., 1]) < 0.8))
    cloud = scene.cloud()
    assert iou(survey_of(cloud).person().mask, truth_of(scene, cloud)) > 0.97


def test_nobody_there_gives_an_empty_mask_and_a_note():
    found = survey_of(room().cloud()).person()
    assert not found.mask.any() and found.mask.dtype == bool and "no person" in found.notes[0]
    nothing = np.zeros(CAMERA.shape, np.uint16)
    blind = cloud_of(nothing, np.full(CAMERA.shape, np.nan, np.float32))
    found = survey_of(blind).person()
    assert not found.mask.any() and found.method == "depth" and "no person" in found.notes[0]


@pytest.mark.parametrize("drift", [-3.0, 1.5])
def test_drift_of_camera_and_window_changes_nothing(drift):
    cloud = sitting().cloud()
    drifted = replace(cloud, temperature_c=cloud.temperature_c + np.float32(drift))
    found = survey_of(drifted, (25 + drift, 35 + drift)).person()
    assert iou(found.mask, survey_of(cloud).person().mask) > 0.999


def test_how_hot_a_radiator_far_away_is_does_not_matter():
    masks = []
    for celsius in (40.0, 80.0):
        scene = sitting()
        scene.plane((0, 0, 1), 3.3, celsius, lambda p: (p[..., 0] > 1.0) & (abs(p[..., 1]) < 0.4))
        masks.append(survey_of(scene.cloud()).person().mask)
    np.testing.assert_array_equal(*masks)


def test_a_mirrored_cloud_gives_the_mirrored_mask():
    cloud = sitting().cloud()
    mirrored = cloud_of(cloud.depth_mm[:, ::-1].copy(), cloud.temperature_c[:, ::-1].copy())
    assert (
        iou(
            survey_of(mirrored).person().mask[:, ::-1],
            survey_of(cloud).person().mask,
        )
        > 0.99
    )


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), warm=st.floats(0, 1), holes=st.floats(0, 1))
def test_the_mask_is_a_subset_of_the_valid_pixels(seed, warm, holes):
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.integers(800, 3000, (27, 32)), np.ones((8, 8), int))[:212, :256]
    depth = np.where(rng.random(CAMERA.shape) < holes, 0, blocks).astype(np.uint16)
    celsius = np.where(rng.random(CAMERA.shape) < warm, 30, 20).astype(np.float32)
    celsius[rng.random(CAMERA.shape) < 0.2] = np.nan
    cloud = cloud_of(depth, celsius)
    found = survey_of(cloud).person()
    assert not found.mask[~cloud.valid].any()
    np.testing.assert_array_equal(found.mask, survey_of(cloud).person().mask)


def standing():
    scene = room()
    scene.ellipsoid((0.1, 0.0, 2.3), (0.22, 0.4, 0.13), np.nan)
    scene.ellipsoid((0.1, -0.52, 2.3), (0.1, 0.14, 0.1), np.nan)
    for side in (-0.1, 0.1):
        scene.ellipsoid((0.1 + side, 0.55, 2.3), (0.08, 0.38, 0.09), np.nan)
    return scene


def test_by_depth_alone_walls_and_floor_fall_away():
    scene = standing()
    cloud = scene.cloud(unseen=np.ones(CAMERA.shape, bool))
    found = survey_of(cloud).person()
    assert found.method == "depth" and "depth alone" in found.notes[0]
    assert iou(found.mask, truth_of(scene, cloud)) > 0.93
    empty = survey_of(room().cloud(unseen=np.ones(CAMERA.shape, bool))).person()
    assert not empty.mask.any() and "no person" in empty.notes[0]


def test_on_the_virtual_rig_the_person_is_found_where_the_fixed_window_fails():
    rig = VirtualRig(2, 2, "normal", 104)
    fuser = Fuser(rig.calibration)
    for frame, truth in rig.with_truth():
        labels = truth_labels(frame, truth)
        cloud = fuser.fuse_frame(frame)
        known, person = labels.parts != 255, labels.persons == 1
        window = cloud.valid & (cloud.temperature_c >= WINDOW_C[0]) & (cloud.temperature_c <= WINDOW_C[1])
        found, plain = (iou(m & known, person & known) for m in (survey_of(cloud).person().mask, window))
        assert found > max(0.85, plain + 0.05)


@pytest.mark.parametrize("drift", [-2.0, 0.3, 2.0])
def test_a_common_offset_of_all_temperatures_changes_nothing_when_the_window_is_found(drift):
    cloud = sitting().cloud()
    drifted = replace(cloud, temperature_c=cloud.temperature_c + np.float32(drift))
    assert iou(survey_of(drifted).person().mask, survey_of(cloud).person().mask) > 0.998


def stander(scene, x, z):
    """A person of three ellipsoids; their pixels are not the subject's."""
    scene.ellipsoid((x, 0.0, z), (0.2, 0.4, 0.13), 30.0, person=False)
    scene.ellipsoid((x, -0.5, z), (0.1, 0.14, 0.1), 33.0, person=False)
    scene.ellipsoid((x, 0.6, z), (0.12, 0.35, 0.1), 29.0, person=False)


def test_a_second_person_is_kept_apart():
    scene = sitting()
    stander(scene, 1.35, 2.5)
    cloud = scene.cloud()
    found = survey_of(cloud).person()
    assert found.trusted and iou(found.mask, truth_of(scene, cloud)) > 0.97
    aside = cloud.valid & (cloud.temperature_c > 27) & ~scene.person
    assert iou(found.others, aside) > 0.9 and not (found.others & found.mask).any()


def sitting_upright():
    """A chest high above two legs, so that trunk and legs are two trunks' distance apart."""
    scene = room()
    scene.ellipsoid((0, -0.35, 2.36), (0.2, 0.2, 0.12), 30.5)
    scene.ellipsoid((0, -0.75, 2.32), (0.09, 0.13, 0.1), 33.5)
    for side in (-1, 1):
        scene.ellipsoid((side * 0.1, 0.5, 2.2), (0.11, 0.35, 0.1), 29.5)
    return scene


def test_halves_above_and_below_a_thing_held_before_the_body_are_one_person():
    scene = sitting_upright()
    scene.ellipsoid((0, -0.05, 2.36), (0.18, 0.3, 0.12), 30.5)
    scene.plane(
        (0, 0, 1), 1.9, 21.5, lambda p: (abs(p[..., 0]) < 0.5) & (p[..., 1] > -0.15) & (p[..., 1] < 0.1)
    )
    cloud = scene.cloud()
    found = survey_of(cloud).person()
    assert not found.others.any() and iou(found.mask, truth_of(scene, cloud)) > 0.95


def test_persons_between_whom_the_room_is_seen_are_two():
    cloud = sitting_upright().cloud()
    assert survey_of(cloud).person().others.any()


def test_three_persons_alike_are_not_trusted_unless_one_was_the_subject_before():
    scene = room()
    for x in (-0.75, 0.0, 0.75):
        stander(scene, x - 0.375, 2.4)
    cloud = scene.cloud()
    found = survey_of(cloud).person()
    assert not found.trusted and "3 persons" in found.notes[-1] and "step aside" in found.notes[-1]
    before = labels_of(cloud, found)
    assert survey_of(cloud).person(before).trusted


def test_a_person_larger_than_the_view_is_not_trusted():
    scene = room()
    scene.ellipsoid((0, 0, 1.0), (0.72, 1.1, 0.25), 30.0)
    found = survey_of(scene.cloud()).person()
    assert not found.trusted and "larger than" in found.notes[-1] and "back" in found.notes[-1]


def test_a_thermal_image_beside_the_depth_image_is_not_trusted():
    cloud = sitting().cloud()
    moved = replace(cloud, temperature_c=np.roll(cloud.temperature_c, 12, axis=1))
    found = survey_of(moved).person()
    assert not found.trusted and "thermal" in found.notes[-1] and "calibrate" in found.notes[-1]
    assert "3.8 degrees" in found.notes[-1]
    assert survey_of(cloud).person().trusted


def labels_of(cloud, found):
    persons = np.where(found.mask, 1, np.where(found.others, 2, 0)).astype(np.uint8)
    parts = np.where(found.mask, 255, 0).astype(np.uint8)
    return FrameLabels("000000", cloud.depth_mm, parts, notes={"extraction": found.method}, persons=persons)


def test_while_the_flag_is_closed_the_frame_before_is_carried_over():
    first = sitting().cloud()
    before = labels_of(first, survey_of(first).person())
    scene = sitting()
    scene.ellipsoid((0.1, -0.1, 2.1), (0.2, 0.05, 0.06), 31.0)
    cloud = scene.cloud(seed=1, unseen=np.ones(CAMERA.shape, bool))
    found = survey_of(cloud).person(before)
    assert found.method == "before" and "carried over" in found.notes[0] and found.trusted
    assert iou(found.mask, truth_of(scene, cloud)) > 0.95
    turned = replace(before, depth_mm=(before.depth_mm * 0.8).astype(np.uint16))
    lost = survey_of(cloud).person(turned)
    assert not lost.trusted and "rig has moved" in lost.notes[0]


def test_without_a_thermal_camera_every_frame_is_looked_at_anew():
    first, unseen = standing(), np.ones(CAMERA.shape, bool)
    before = first.cloud(unseen=unseen)
    scene = room()
    stander(scene, 0.35, 2.1)
    cloud = scene.cloud(seed=1, unseen=unseen)
    alone = survey_of(cloud).person()
    found = survey_of(cloud).person(labels_of(before, survey_of(before).person()))
    assert found.method == "depth" and found.trusted and found.mask.any()
    assert np.array_equal(found.mask, alone.mask)


def depth_only(path):
    recording = CloudFile(path)
    cloud = Fuser(recording.calibration).fuse(next(iter(recording)).depth_mm)
    return cloud, survey_of(cloud).person().mask


def test_real_standing_people_without_temperature(shared_data):
    for path in sorted((shared_data / "kinect2_standing").glob("*.pcd")):
        cloud, mask = depth_only(path)
        assert mask.sum() > 0.9 * cloud.valid.sum()


def test_a_real_head_and_shoulders_before_an_office(shared_data):
    cloud, mask = depth_only(shared_data / "pcl_person" / "person.pcd")
    near = cloud.valid & (cloud.points_m[..., 2] < 1.1)
    assert iou(mask, near) > 0.95


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 60))
def test_pieces_that_share_a_cluster_are_joined(seed, pieces, points):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, pieces, points).astype(np.int32)
    close = rng.integers(0, 15, points).astype(np.int32)
    found = _joined(labels, close, pieces)
    graph = coo_array((np.ones(points), (labels, pieces + close)), (pieces + 15, pieces + 15))
    expected = connected_components(graph, directed=False)[1][:pieces]
    same = found[:, None] == found
    assert (same == (expected[:, None] == expected)).all()
    assert (found <= np.arange(pieces)).all()


def test_a_suit_tells_more_of_parts_than_clothes_and_noise_tells_nothing():
    cloud, rng = sitting().cloud(), np.random.default_rng(1)
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
        told[name] = suit_told(DEFAULT_SUIT, replace(cloud, color_valid=cloud.valid, color_rgb=rgb), person)
    assert told["suit"] > 2 * told["clothes"] > 0 and told["suit"] > 3 * max(told["wall"], told["noise"])
