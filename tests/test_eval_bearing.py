"""Body state of a person: it survives as a note, is written as a table, and its sides are smoothed."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from annotate.crop import Crop
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import swap_left_right
from annotate.posture import POSTURES
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import BodyState, body_state_notes
from eval.network.joints.joint_files import write_joints
from eval.network.side_smoothing import smooth_sides
from eval.scores.joints import JOINT, JOINT_NAMES, N_JOINTS
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import JOINTS
from synth.images.standing_statistics import facing_deg

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def body_state(facing: float = 20.0, sure: float = 0.9, quality: bool = False) -> BodyState:
    posture, rng = np.eye(len(POSTURES), dtype=np.float32)[1], np.random.default_rng(0)
    joints = rng.uniform(10, 40, (N_JOINTS, 3)) + np.array([0, 0, 2000])
    if not quality:
        return BodyState(facing, sure, posture, joints)
    seen = np.eye(3)[np.arange(N_JOINTS) % 3]
    return BodyState(facing, sure, posture, joints, "floor", rng.uniform(1, 20, (N_JOINTS, 2)), seen)


def swapped(name: str) -> str:
    return name.replace("left", "right") if "left" in name else name.replace("right", "left")


def frame(number: int, facing: float, sure: float = 0.9, exchanged: bool = False) -> FrameLabels:
    """A frame with both upper arms. exchanged: left and right are the wrong ones."""
    parts = np.zeros((48, 64), np.uint8)
    parts[10:20, 10:20], parts[10:20, 30:40] = (4, 3) if exchanged else (3, 4)
    labelled = Segmentation(parts, np.ones(parts.shape, np.float32), bearing=body_state(facing, sure).note())
    return FrameLabels(
        f"{number:06d}", np.full(parts.shape, 2000, np.uint16), parts, notes={"labelled": labelled}
    )


@pytest.mark.parametrize("turn", [-170, -90, -30, 0, 45, 120])
def test_joints_give_the_facing_from_any_side(turn):
    """Shoulders and hips turned by some degrees about an upright trunk straight before the camera."""
    azimuth = np.radians(turn)
    leftward = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    height = {"head": -0.7, "neck": -0.5, "shoulder": -0.45, "hip": 0.0, "pelvis": 0.0}
    at = np.zeros((N_JOINTS, 3))
    for name, k in JOINT.items():
        side = 150 * (name.startswith("left_") - name.startswith("right_"))
        at[k] = np.array([0, 1000 * height.get(name.split("_")[-1], 0.3), 2000]) + side * leftward
    u, v = (at[:, :2] / at[:, 2:] * 60 + (31.5, 23.5)).T
    seen = replace(body_state(facing=10), joints_px=np.column_stack([u, v, at[:, 2]])).faced_by_joints(CAMERA)
    assert abs((seen.facing_deg - turn + 180) % 360 - 180) < 1e-6
    assert seen.facing_sure == body_state().facing_sure
    off = seen.exchanged().faced_by_joints(CAMERA).facing_deg - seen.exchanged().facing_deg
    assert abs((off + 180) % 360 - 180) < 1e-6


def test_a_note_holds_the_state():
    back = BodyState.from_note(json.loads(json.dumps(body_state().note())))
    assert back is not None and back.note() == body_state().note()
    for broken in (
        None,
        "x",
        {},
        {**body_state().note(), "postures": [1]},
        {**body_state().note(), "joints_px": 3},
        {**body_state().note(), "facing_deg": 10**400},
        {**body_state().note(), "facing_sure": float("nan")},
    ):
        assert BodyState.from_note(broken) is None
    full = body_state(quality=True)
    kept = BodyState.from_note(json.loads(json.dumps(full.note())))
    assert (
        kept is not None and kept.note() == full.note() and kept.exchanged().note() == full.exchanged().note()
    )
    for name in ("joints_sd", "joints_seen"):
        assert BodyState.from_note({**full.note(), name: [[1.0]]}) is None
    others = {"2": {}, "9" * 5000: {}, "x": {}}
    assert body_state_notes({"bearing": {"others": others}}).keys() == {1, 2}


def test_an_output_for_the_crop_is_placed_in_the_image():
    depth, mask = np.full((48, 64), 1500, np.uint16), np.ones((48, 64), np.bool_)
    joints = np.tile(np.array([0.5, 0.25, 0.6], np.float32), (N_JOINTS, 1))
    found = BodyState.of(
        Crop(-4, 6, 40), (depth, mask), (np.array([0, -0.5], np.float32), np.ones(6, np.float32), joints)
    )
    assert (found.facing_deg, found.facing_sure) == pytest.approx((-90, 0.5))
    np.testing.assert_allclose(found.joints_px[0], (0.5 * 40 - 0.5 + 6, 0.25 * 40 - 0.5 - 4, 1700), rtol=1e-5)
    assert found.joints_sd is None and found.joints_sd_mm(CAMERA) is None and found.joint_visibility == ()
    u, v, z = found.joints_px[0]
    np.testing.assert_allclose(found.joints_mm(CAMERA)[0], ((u - 31.5) / 60 * z, (v - 23.5) / 60 * z, z))


def test_deviations_are_of_the_distance_and_joints_beyond_the_image_are_outside():
    depth, mask = np.full((48, 64), 1500, np.uint16), np.ones((48, 64), np.bool_)
    joints = np.tile(np.array([0.5, 0.25, 0.6], np.float32), (N_JOINTS, 1))
    joints[1, 1] = 0.05
    outputs = np.array([0, 1], np.float32), np.ones(6, np.float32), joints
    quality = np.tile(np.float32([0.1, 0.02]), (N_JOINTS, 1)), np.tile(np.float32([0.2, 0.7, 0.1]), (15, 1))
    found = BodyState.of(Crop(-4, 6, 40), (depth, mask), (*outputs, *quality))
    expected = np.hypot(0.1 * 40 / 60 * 1700, 0.02 * 2000)
    np.testing.assert_allclose(found.joints_sd_mm(CAMERA), expected, rtol=1e-5)
    assert found.joint_visibility == ("visible", "outside", *["visible"] * 13)


def test_exchanged_sides_are_the_person_turned_about():
    """The azimuth of the joints' own exchange."""
    joints = np.random.default_rng(1).normal(0, 300, (len(JOINTS), 3)) + np.array([0, 0, 2500])
    own = body_state(facing_deg(joints))
    names = [joint.name for joint in JOINTS]
    twin = [names.index(swapped(name)) for name in names]
    turned = own.exchanged().facing_deg - facing_deg(joints[twin])
    assert np.cos(np.radians(turned)) == pytest.approx(1)
    np.testing.assert_array_equal(
        own.exchanged().joints_px[JOINT["left_knee"]], own.joints_px[JOINT["right_knee"]]
    )
    assert own.exchanged().exchanged().note() == own.note()


def run(film: list[tuple[float, bool]], sure: float = 0.9) -> list[FrameLabels]:
    """Frames one after the other, as `predict` labels them. film: facing, and whether sides are exchanged."""
    done: list[FrameLabels] = []
    for number, (facing, exchanged) in enumerate(film):
        new = frame(number, facing, sure, exchanged)
        labelled = smooth_sides(new.notes["labelled"], done[-1] if done else None)
        done.append(replace(new, parts=labelled.parts, notes={"bearing": labelled.bearing}))
    return done


TURN = ((np.arange(60) * 12 + 180) % 360 - 180).tolist()


@pytest.mark.parametrize(
    ("film", "known_from"),
    [
        # One frame with exchanged sides, whose joints are exchanged too, or give a facing of their own.
        *(([(10, False)] * 3 + [(turn, True)] + [(10, False)], 0) for turn in (-170, 10, 90)),
        ([(facing, False) for facing in TURN], 0),  # a turn all round within two seconds
        ([(10, False)] * 3 + [(-170, False)], 0),  # joints alone that are exchanged
        ([(-170, True)] * 2 + [(10, False)] * 4, 3),  # a wrong start is outvoted in the end
    ],
)
def test_labels_keep_their_sides_over_the_frames(film, known_from):
    for done in run(film)[known_from:]:
        np.testing.assert_array_equal(done.parts, frame(0, 0).parts)


def test_joints_follow_the_labels_that_are_exchanged():
    """Elbows in the upper arms of this frame's labels, before and after their exchange."""
    done, new = run([(10, False)] * 3)[-1], frame(3, -170, exchanged=True).notes["labelled"]
    for exchanged in (True, False):
        state = BodyState.from_note(new.bearing)
        state.joints_px[[JOINT["left_elbow"], JOINT["right_elbow"]], :2] = (15, 15), (35, 15)
        state = state.exchanged() if exchanged else state
        found = smooth_sides(replace(new, bearing=state.note()), done)
        at = BodyState.from_note(found.bearing).joints_px[JOINT["left_elbow"], :2]
        np.testing.assert_array_equal(at, (15, 15))


def test_unsure_frames_and_other_persons_do_not_outweigh_a_frame():
    """Another person: after a pause, or in another place."""
    done, there = run([(10, False)] * 3)[-1], frame(3, -170, exchanged=True).notes["labelled"]
    unsure = run([(10, False)], sure=0.4)[-1]
    np.testing.assert_array_equal(smooth_sides(there, unsure).parts, there.parts)
    np.testing.assert_array_equal(smooth_sides(there, None).parts, there.parts)
    elsewhere = replace(there, parts=np.roll(there.parts, 40, axis=1))
    np.testing.assert_array_equal(smooth_sides(elsewhere, done).parts, elsewhere.parts)
    np.testing.assert_array_equal(smooth_sides(there, done).parts, swap_left_right(there.parts))


@pytest.mark.parametrize("name", ["joints.jsonl", "joints.csv"])
def test_joints_are_written_as_a_table(tmp_path, name):
    labels = LabelSet.resume(tmp_path / "labels", CAMERA, {"source": "x", "steps": {}})
    for one in run([(10, False), (20, False)]):
        labels.write(one)
    labels.write(FrameLabels("000002", *(np.zeros((48, 64), kind) for kind in (np.uint16, np.uint8))))
    assert write_joints(LabelSet.open(tmp_path / "labels"), tmp_path / name) == 2
    text = (tmp_path / name).read_text()
    assert "_sd" not in text and "visibility" not in text
    expected = body_state().joints_mm(CAMERA)
    if name.endswith("csv"):
        rows = list(csv.DictReader(text.splitlines()))
        first = [float(rows[0][f"{JOINT_NAMES[3]}_{axis}_mm"]) for axis in "xyz"]
    else:
        rows = [json.loads(line) for line in text.splitlines()]
        first = rows[0]["joints_mm"][JOINT_NAMES[3]]
    assert [row["frame"] for row in rows] == ["000000", "000001"] and rows[0]["posture"] == "sitting"
    np.testing.assert_allclose(first, expected[3], atol=3)
    with pytest.raises(CloudError, match="jsonl or"):
        write_joints(labels, tmp_path / "joints.txt")


@pytest.mark.parametrize("name", ["joints.jsonl", "joints.csv"])
def test_the_table_has_deviations_and_visibility_where_the_network_gives_them(tmp_path, name):
    labels, state = LabelSet.create(tmp_path / "labels", CAMERA, {"source": "x"}), body_state(quality=True)
    blank = [np.zeros((48, 64), kind) for kind in (np.uint16, np.uint8)]
    for number, one in enumerate((state, body_state())):
        labels.write(FrameLabels(f"{number:06d}", *blank, notes={"bearing": one.note()}))
    write_joints(labels, tmp_path / name)
    text, joint = (tmp_path / name).read_text(), JOINT_NAMES[4]
    if name.endswith("csv"):
        first, second = csv.DictReader(text.splitlines())
        found = first[f"{joint}_sd_mm"], first[f"{joint}_visibility"]
        assert second[f"{joint}_sd_mm"] == second[f"{joint}_visibility"] == ""
    else:
        first, second = map(json.loads, text.splitlines())
        found = first["joint_sd_mm"][joint], first["joint_visibility"][joint]
        assert "joint_sd_mm" not in second
    assert float(found[0]) == pytest.approx(state.joints_sd_mm(CAMERA)[4], rel=0.01)
    assert found[1] == "visible"
