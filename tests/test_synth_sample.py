"""One synthetic image: what it holds, what its notes say, and what its options do."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from annotate.crop import SIZE, Crop
from annotate.parts import N_CLASSES
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE as CAMERA
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics, project
from synth.body.skeleton import N_JOINTS
from synth.images.presets import PRESETS, preset_named, sample
from synth.images.view import cut, occluder, visibility
from synth.images.viewpoints import inside_image
from synth.pose.pose_parameters import NEARLY_THERE, PoseFamily, posture_class
from synth.pose.postures import IN_BED, SITTING, UPRIGHT
from synth.pose.standing_parameters import stances
from synth.surface.rasterize import NEAR_M

NAMES = sorted(PRESETS)
WHOLE = [name for name in NAMES if PRESETS[name].joints > 0.5]
DRAWN = sorted(set(NAMES) - set(WHOLE))


@cache
def frames(name):
    """A dozen samples of a preset."""
    return [sample(PRESETS[name], 3, i * 7) for i in range(12)]


@pytest.mark.parametrize("name", NAMES)
def test_depth_and_parts_belong_to_one_person(name):
    for frame in frames(name):
        assert frame.depth_mm.shape == frame.parts.shape == (SIZE, SIZE)
        np.testing.assert_array_equal(frame.depth_mm > 0, frame.parts > 0)
        assert frame.parts.max() < N_CLASSES and frame.status == "truth"
        assert np.unique(frame.parts).size > (5 if name in WHOLE else 2)
        assert np.ptp(np.percentile(frame.depth_mm[frame.depth_mm > 0], (2, 98))) < 2500


@pytest.mark.parametrize("name", WHOLE)
def test_notes_tell_where_the_joints_are(name):
    inside = []
    for frame in frames(name):
        joints = np.array(frame.notes["joints_mm"]) / 1000
        assert joints.shape == (N_JOINTS, 3)
        u, v = project(CAMERA, joints).T
        top, left, side = frame.notes["crop"]
        inside.append((u > left - 2) & (u < left + side + 2) & (v > top - 2) & (v < top + side + 2))
        pelvis = joints[0, 2] * 1000
        assert abs(np.median(frame.depth_mm[frame.depth_mm > 0]) - pelvis) < 700
    assert np.mean(inside) > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_one_index_is_one_image_and_streams_never_meet(name):
    again = sample(PRESETS[name], 3, 7)
    np.testing.assert_array_equal(again.depth_mm, frames(name)[1].depth_mm)
    assert again.notes == frames(name)[1].notes
    assert (sample(PRESETS[name], 4, 7).depth_mm != again.depth_mm).any()
    streams = [preset.stream for preset in PRESETS.values()]
    assert len(set(streams)) == len(streams)


def test_two_images_in_a_row_show_one_pose_from_two_places():
    frames = [sample(PRESETS["people"], 3, i).notes for i in range(3)]
    first, second, third = (np.array(notes["joints_mm"]) for notes in frames)
    bones = [np.linalg.norm(joints[:, None] - joints, axis=2) for joints in (first, second, third)]
    assert np.abs(bones[0] - bones[1]).max() < 3 < np.abs(bones[1] - bones[2]).max()
    assert np.abs(first - second).max() > 30


def test_the_recumbent_are_seen_from_all_around_and_from_several_heights():
    cameras = [f.notes["camera"] for f in frames("recumbent")] + [
        sample(PRESETS["recumbent"], 0, i).notes["camera"] for i in range(20)
    ]
    azimuths = np.sort([c["azimuth_deg"] for c in cameras])
    assert np.diff(azimuths).max() < 90 and np.ptp(azimuths) > 270
    assert np.ptp([c["height_m"] for c in cameras]) > 1


def test_occluders_and_cuts_come_in_their_share_and_are_recorded():
    plain = PRESETS["sitting-train"]
    assert all(f.notes["occluders"] == 0 and f.notes["cut"] == 0 for f in frames("sitting-train"))
    hidden = [sample(replace(plain, occluders=1, cut=1), 0, i) for i in range(16)]
    assert np.mean([f.notes["occluders"] > 0 for f in hidden]) > 0.7
    assert np.mean([f.notes["cut"] > 0 for f in hidden]) > 0.7
    whole = np.mean([f.notes["visible"][0] for f in frames("sitting-train")])
    assert np.mean([f.notes["visible"][0] for f in hidden]) < whole - 0.15
    half = [sample(replace(plain, occluders=0.5), 0, i).notes["occluders"] > 0 for i in range(30)]
    assert 0.2 < np.mean(half) < 0.8


def test_bad_options_are_refused():
    with pytest.raises(CloudError, match="sitting-train"):
        preset_named("flying")
    with pytest.raises(CloudError, match=r"occluders 1\.5"):
        replace(PRESETS["recumbent"], occluders=1.5)


def test_an_occluder_stands_between_the_camera_and_the_person():
    rng = np.random.default_rng(0)
    eye, seen = np.array([0.0, -2.0, 1.0]), np.array([0.2, 0.0, 0.5])
    for _ in range(20):
        centre = occluder(eye, seen, rng).vertices_m.mean(axis=0)
        along = (centre - eye) @ (seen - eye) / np.sum((seen - eye) ** 2)
        assert 0.49 < along < 0.86
        np.testing.assert_allclose(centre, eye + along * (seen - eye), atol=1e-5)


def test_a_cut_takes_only_from_the_person():
    person = np.zeros((90, 120), bool)
    person[20:80, 30:60] = True
    for seed in range(10):
        left = cut(person, np.random.default_rng(seed))
        assert not (left & ~person).any() and 0 < left.sum() < person.sum()


def test_points_inside_the_image_are_those_that_project_there():
    points = np.random.default_rng(0).normal((0, 0, 1), 1.5, (500, 3))
    u, v = project(CAMERA, points).T
    expected = (u >= 0) & (u < CAMERA.width) & (v >= 0) & (v < CAMERA.height) & (points[:, 2] > NEAR_M)
    np.testing.assert_array_equal(inside_image(points, CAMERA), expected)


def test_visibility_by_hand():
    whole = np.array([[1, 1, 2, 2], [0, 3, 3, 3]], np.uint8)
    parts = np.array([[1, 0, 2, 2], [0, 0, 0, 0]], np.uint8)
    shares = visibility(parts, whole, N_CLASSES)
    assert shares[[1, 2, 3, 4]].tolist() == [0.5, 1, 0, 1] and shares[0] == pytest.approx(3 / 7)


@pytest.mark.parametrize("crop", [Crop(3, 5, 40), Crop(-30, 70, 90), Crop(200, 0, 20), Crop(-9, -9, 400)])
def test_a_crop_reads_the_pixels_it_cuts(crop):
    image = np.arange(1, 101 * 97 + 1, dtype=np.int32).reshape(101, 97)
    taken = crop.cut(image, 0)
    for row in range(0, SIZE, 13):
        for column in range(0, SIZE, 17):
            v = crop.top + (row * crop.side + crop.side // 2) // SIZE
            u = crop.left + (column * crop.side + crop.side // 2) // SIZE
            inside = 0 <= v < 101 and 0 <= u < 97
            assert taken[row, column] == (image[v, u] if inside else 0)
    np.testing.assert_array_equal(np.unique(taken[taken > 0]), image[crop.reads(image.shape)])


@cache
def drawn(name):
    """Notes of some people before drawn sensors."""
    return [sample(PRESETS[name], 2, 5 * i).notes for i in range(60)]


@pytest.mark.parametrize("name", DRAWN)
def test_a_drawn_sensors_frame_notes_its_camera_and_its_person(name):
    for notes in (frame.notes for frame in frames(name)):
        camera = Intrinsics(*notes["intrinsics"])
        joints = np.array(notes["joints_mm"]) / 1000
        seen = inside_image(joints, camera)
        assert 1 - seen.mean() == pytest.approx(notes["beyond"], abs=1e-3)
        top, left, side = notes["crop"]
        u, v = project(camera, joints[seen]).T
        around = (u > left - 3) & (u < left + side + 3) & (v > top - 3) & (v < top + side + 3)
        assert around.mean() > 0.8 or notes["visible"][0] < 0.9
        assert 0 < notes["height_px"] <= camera.height and notes["sensor"]["kind"]
        assert 1.4 < notes["body"]["height_cm"] / 100 < 2.05 and 15 < notes["body"]["bmi"] < 40


def test_people_of_drawn_sensors_mostly_face_the_camera_and_some_are_cut():
    notes = drawn("standing")
    facing = np.abs([n["facing_deg"] for n in notes])
    assert 0.4 < np.mean(facing < 45) < 0.75 and 0.05 < np.mean(facing > 135) < 0.4
    assert 0.03 < np.mean([n["beyond"] > 0.05 for n in notes]) < 0.35
    assert len({n["sensor"]["kind"] for n in notes}) >= 3
    assert (
        min(n["camera"]["height_m"] for n in notes) >= 0.4
        and max(n["camera"]["height_m"] for n in notes) <= 2.65
    )


def test_people_stand_sit_lie_and_crouch():
    activities = {n["activity"] for n in drawn("people")}
    assert all(activities & set(family.activities) for family in (SITTING, IN_BED, UPRIGHT))
    assert activities & set(stances())


def test_a_person_between_two_postures_has_none_and_else_that_of_the_nearer():
    still, rng, seen = {"x": (0.0, 0.0)}, np.random.default_rng(5), set()
    family = PoseFamily(still, {"kneeling": still, "standing": {"x": (1.0, 0.0)}})
    for _ in range(300):
        activities, moment = family.single(rng)
        nearer = "kneeling" if moment["x"] <= 0.5 else "standing"
        between = NEARLY_THERE < moment["x"] < 1 - NEARLY_THERE
        assert activities[0] == nearer and len(activities) == 1 + between
        assert posture_class(*activities) == (None if between else nearer)
        seen.add(activities)
    assert len(seen) == 4
    assert posture_class("kneeling", "half_kneeling_left") == "kneeling" and posture_class("juggling") is None
