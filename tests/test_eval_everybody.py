"""All persons in depth alone: numbers that last, joints of each, empty rooms, support."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from annotate.parts import PART_ID
from annotate.person.planes import Plane, find_planes
from eval.network.body_state import BodyState
from eval.network.joints.joint_files import write_joints
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions
from eval.network.predict_source import predict_source
from eval.network.support import LEAST_HIPS_M, STANDING_HIPS, exclude_standing, floor_of, support_of
from eval.scores.joints import JOINT
from sensors.rig.camera import rays
from sensors.rig.frame import FrameSource, RigFrame, regular_times_ns
from sensors.rig.rig_calibration import RigCalibration
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tests.helpers.furnished_room import CAMERA, cloud_of, seen

ROOM = RigCalibration(CAMERA)


class Film(FrameSource):
    """A source of depth images in metres (h, w), NaN = no reading."""

    def __init__(self, images: list, calibration: RigCalibration = ROOM) -> None:
        self.images, self.calibration, self.name = images, calibration, "film"
        self.times_ns = regular_times_ns(len(images))

    def _frame(self, index: int) -> RigFrame:
        depth_mm = np.rint(np.nan_to_num(self.images[index]) * 1000).astype(np.uint16)
        return RigFrame(index, int(self.times_ns[index]), depth_mm)


@pytest.fixture(scope="module")
def network() -> OnnxNetwork:
    return OnnxNetwork()


def predicted(film, network, out, **options):
    return predict_source(film, network, out / "labels", lambda n: None, PredictOptions(**options)).labels


def test_two_people_keep_their_numbers_and_have_their_joints(tmp_path, network):
    """The first comes nearer to the second, from frame to frame."""
    frames = [seen([(1, -0.9 + 0.12 * k), (2, 0.5)], seed=k) for k in range(4)]
    labels = predicted(Film([depth for depth, _ in frames]), network, tmp_path, everybody=True)
    numbers = []
    for frame, (_, whose) in zip(labels, frames, strict=True):
        both = [frame.persons[whose == number] for number in (1, 2)]
        numbers.append([int(np.bincount(one).argmax()) for one in both])
        for one, number in zip(both, numbers[-1], strict=True):
            assert np.mean(one == number) > 0.85
        np.testing.assert_array_equal(frame.parts > 0, frame.persons > 0)
    assert sorted(numbers[0]) == [1, 2] and numbers == numbers[:1] * 4
    assert write_joints(labels, tmp_path / "joints.csv") == 8
    with (tmp_path / "joints.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["frame"], row["person"]) for row in rows] == [
        (f"{k:06d}", number) for k in range(4) for number in "12"
    ]
    for row in rows:
        _, whose = frames[int(row["frame"])]
        own = numbers[0].index(int(row["person"])) + 1
        u = CAMERA.cx + CAMERA.fx * float(row["pelvis_x_mm"]) / float(row["pelvis_z_mm"])
        assert abs(u - np.median(np.nonzero(whose == own)[1])) < 15
        assert (row["posture"], row["support"]) == ("standing", "floor")


def test_without_everybody_the_subject_alone_has_parts(tmp_path, network):
    depth, _ = seen([(1, -0.5), (2, 0.6)])
    frame = predicted(Film([depth]), network, tmp_path).read("000000")
    assert set(np.unique(frame.persons)) == {0, 1, 2}
    np.testing.assert_array_equal(frame.parts > 0, frame.persons == 1)


def test_an_empty_room_has_nobody(tmp_path, network):
    film = Film([seen([], seed=k)[0] for k in range(2)])
    for everybody in (False, True):
        labels = predicted(film, network, tmp_path / str(everybody), everybody=everybody)
        for frame in labels:
            assert not frame.parts.any() and not frame.persons.any()
        assert write_joints(labels, tmp_path / "joints.jsonl") == 0
        assert "no person" in labels.notes("000000")["notes"][0]


def test_whoever_sits_still_does_not_fade(tmp_path, network):
    """A frame of the virtual rig over and over, its noise fresh each time."""
    rig = VirtualRig(1, 1, "normal", 8105, RigOptions(draft=True))
    ((frame, truth),) = rig.with_truth()
    person = truth_labels(frame, truth).persons == 1
    rng, depth_m = np.random.default_rng(0), np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)
    film = Film(
        [depth_m + rng.normal(0, 0.003, depth_m.shape) for _ in range(10)],
        RigCalibration(rig.calibration.depth),
    )
    found = [labels.persons == 1 for labels in predicted(film, network, tmp_path)]
    shares = [np.mean(mask[person]) for mask in found]
    assert min(shares) > 0.8 and shares[-1] > shares[0] - 0.03


# What carries them


def box_on(height_m: float, slab_m: float):
    """Depth of a person who lies as a box, its top at a height above the floor, on a slab; and the box."""
    ray = rays(CAMERA)
    down = np.full(CAMERA.shape, np.inf)
    body = np.zeros(CAMERA.shape, bool)
    for top, half_m, own in ((0.0, 9.0, False), (slab_m, 0.9, False), (height_m, 0.35, True)):
        with np.errstate(divide="ignore"):
            z = np.where(ray[..., 1] > 0, (1.2 - top) / ray[..., 1], np.inf)
        x, ahead = ray[..., 0] * z, z
        inside = (np.abs(x) < 2 * half_m) & (np.abs(ahead - 2.6) < half_m) & (z < down) & (z < 4.5)
        down[inside], body[inside] = z[inside], own
    return np.where(np.isfinite(down), down, np.nan), body


@pytest.mark.parametrize(("height_m", "slab_m", "carried"), [(0.12, 0.0, "floor"), (0.62, 0.5, "furniture")])
def test_support_is_the_height_of_the_lowest_part(height_m, slab_m, carried):
    depth_m, body = box_on(height_m, slab_m)
    cloud = cloud_of(depth_m)
    parts = np.where(body, PART_ID["torso"], 0).astype(np.uint8)
    floor = floor_of(find_planes(cloud), cloud.points_m)
    assert support_of("lying", parts, cloud.points_m, floor) == carried
    assert support_of("standing", parts, cloud.points_m, floor) == ""  # No legs in view.
    assert support_of("lying", parts, cloud.points_m, None) == ""


@pytest.mark.parametrize("scene", ["sofa", "bed"])
def test_on_the_rig_furniture_carries_them(scene):
    rig = VirtualRig(1, 1, "normal", 8106, RigOptions(scene, draft=True))
    ((frame, truth),) = rig.with_truth()
    labels = truth_labels(frame, truth)
    camera = rig.calibration.depth.undistorted()
    cloud = cloud_of(labels.depth_mm / 1000, camera)
    parts = np.where(labels.persons == 1, labels.parts, 0).astype(np.uint8)
    posture = "lying" if scene == "bed" else "sitting"
    floor = floor_of(find_planes(cloud), cloud.points_m)
    assert support_of(posture, parts, cloud.points_m, floor) == "furniture"


@given(hips_m=st.floats(0.0, 1.0), head_m=st.floats(1.0, 1.8), tilt_deg=st.floats(-30, 30))
def test_nobody_stands_whose_hips_are_too_low(hips_m, head_m, tilt_deg):
    """Of heights alone, however the camera is tilted; near the floor, or without one, nothing changes."""
    assume(min(abs(hips_m - LEAST_HIPS_M), abs(hips_m - STANDING_HIPS * head_m)) > 1e-6)
    up = np.array([0, -np.cos(np.radians(tilt_deg)), -np.sin(np.radians(tilt_deg))])
    floor = Plane(up.astype(np.float32), -1.2, 4.0)
    joints_mm = 1000 * (np.array([0.0, 0.0, 2.5]) + np.zeros((len(JOINT), 3)))
    for name, height_m in (("pelvis", hips_m), ("head", head_m)):
        joints_mm[JOINT[name]] += 1000 * (height_m + floor.offset_m - up @ [0, 0, 2.5]) * up
    z = joints_mm[:, 2]
    pixels = [CAMERA.fx * joints_mm[:, 0] / z + CAMERA.cx, CAMERA.fy * joints_mm[:, 1] / z + CAMERA.cy, z]
    said = np.array([0.8, 0.15, 0.05, 0, 0, 0], np.float32)
    bearing = BodyState(0.0, 1.0, said, np.column_stack(pixels))
    low = LEAST_HIPS_M < hips_m < STANDING_HIPS * head_m
    found = exclude_standing(bearing, CAMERA, floor)
    assert found.name == ("sitting" if low else "standing") and np.isclose(found.posture.sum(), 1)
    assert exclude_standing(bearing, CAMERA, None) is bearing
    sure = replace(bearing, posture=np.array([1, 0, 0, 0, 0, 0], np.float32))
    assert exclude_standing(sure, CAMERA, floor) is sure  # Nothing else was thought of.
