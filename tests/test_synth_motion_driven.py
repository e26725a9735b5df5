"""Motions drive data: joints in files, floors found, feet on any body, films, and other files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import synth.rig.film
from annotate.labelset.dataset import read_shard
from annotate.labelset.label_set import LabelSet
from sensors.errors import CloudError
from sensors.session.reader import Session
from synth.body.body import pose, shipped_bodies
from synth.body.crowd import crowd
from synth.body.flesh import flesh_of
from synth.body.skeleton import JOINT_ID, JOINTS, N_JOINTS, PARENTS, Posture, forward
from synth.images.generate import Order, make_shard
from synth.images.posed_scenes import MotionScenes
from synth.images.presets import preset_of
from synth.markers.motion_file import MarkerReport, Motion, save_motion
from synth.markers.person_fit import person_body, zero_bones
from synth.markers.solve import solve_takes
from synth.motion.grounded import ground, resampled
from synth.motion.library import motion_files, read_motions, read_repertoire, read_take
from synth.motion.placed import perform, stand, take_seat
from synth.motion_files.joint_file import read_joint_file
from synth.rig.film import FilmRig
from synth.rig.simulate import simulate, truth_path
from synth.surface.furniture import FLOOR, Chair, Sofa
from tests.helpers.penetration import self_penetration_m

RATE = 30.0
PERSON = shipped_bodies()[3]
STOOD_M = 0.02


def motion_of(angles: np.ndarray, hips_m: np.ndarray) -> Motion:
    frames = len(angles)
    report = MarkerReport((), np.empty((frames, 0), np.float32), np.empty((frames, 0), np.uint8))
    pelvis = np.stack([np.zeros(frames), np.zeros(frames), hips_m], axis=1)
    return Motion(angles, pelvis, RATE, zero_bones(PERSON.joints_m), report)


def squatting(frames: int) -> Motion:
    """One squat, the floor wandering by 3 cm."""
    bends = np.sin(np.pi * np.arange(frames) / max(frames, 1)) ** 2
    return _bent(bends[:, None] * [0.2, 1.2, -1.6, 0.6, 0.9], 0.03 * np.sin(np.arange(frames) / 9))


def sitting() -> Motion:
    """A second on a chair that is not recorded."""
    return _bent(np.tile([0.0, 1.5, -1.5, 0.0, 0.3], (30, 1)), np.zeros(30))


def _bent(flexions: np.ndarray, floor_m: np.ndarray) -> Motion:
    """Both-legged postures: flexions (F, 5) of pelvis, hips, knees, ankles, shoulders."""
    angles, hips = np.zeros((len(flexions), N_JOINTS, 3)), np.zeros(len(flexions))
    for f, (lean, *rest) in enumerate(flexions):
        angles[f, 0, 0] = lean
        for joint, flexion in zip(("hip", "knee", "ankle", "shoulder"), rest, strict=True):
            for side in ("left", "right"):
                angles[f, JOINT_ID[f"{side}_{joint}"], 0] = flexion
        hips[f] = floor_m[f] - pose(PERSON, Posture(angles[f], np.zeros(3)))[0][:, 2].min()
    return motion_of(angles, hips)


def jumping() -> Motion:
    """A standing jump: crouched for half a second, a flight of 20 cm, stood for half a second."""
    motion = squatting(45)
    time = (np.arange(45) - 15) / RATE
    flight = np.clip(2 * time - 9.81 / 2 * time**2, 0, None)
    angles = np.tile(motion.angles_rad[5], (45, 1, 1))
    hips = np.full(45, motion.pelvis_m[5, 2])
    return motion_of(angles, hips + flight)


def test_a_persons_body_has_the_persons_bones():
    for body in (shipped_bodies()[0], crowd()[5]):
        bones = zero_bones(body.joints_m)
        made = person_body(bones)
        np.testing.assert_allclose(zero_bones(made.joints_m), bones, atol=1e-9)
        assert abs(made.height_cm - body.height_cm) < 6 and abs(made.vertices_m[:, 2].min()) < 1e-6


@pytest.mark.parametrize("body", [shipped_bodies()[7], crowd()[2]], ids=["tall", "heavy"])
def test_feet_stand_where_the_motion_stands(body):
    grounded = ground(squatting(40))
    assert (grounded.clear_m[:, :2] < 0.005).all() and not grounded.sits.any() and grounded.sound.all()
    feet = [np.flatnonzero(body.strongest_joints == JOINT_ID[f"{side}_ankle"]) for side in ("left", "right")]
    for frame in range(0, 40, 5):
        vertices, joints = stand(body, grounded, frame)
        assert max(abs(vertices[foot, 2].min()) for foot in feet) < STOOD_M
        assert self_penetration_m(body, vertices, joints) < 0.045


@pytest.mark.parametrize("body", [shipped_bodies()[7], crowd()[2]], ids=["tall", "heavy"])
def test_who_sits_on_the_floor_lies_on_the_trunk_and_its_feet(body):
    grounded = ground(_bent(np.tile([-0.3, 1.3, -0.1, 0.0, 1.0], (20, 1)), np.zeros(20)))
    assert (grounded.clear_m == 0).all() and not grounded.sits.any()
    vertices, _ = stand(body, grounded, 0)
    assert vertices[flesh_of(body).trunk, 2].min() == pytest.approx(-FLOOR.give_m, abs=1e-3)
    for side in ("left", "right"):
        foot = np.flatnonzero(body.strongest_joints == JOINT_ID[f"{side}_ankle"])
        assert abs(vertices[foot, 2].min()) < STOOD_M


def test_a_jump_stays_in_the_air():
    motion, body = jumping(), shipped_bodies()[0]
    grounded = ground(motion)
    low = np.array([stand(body, grounded, f)[0][:, 2].min() for f in range(len(grounded))])
    scale = body.joints_m[JOINT_ID["left_hip"], 2] / PERSON.joints_m[JOINT_ID["left_hip"], 2]
    assert 0.2 * scale - STOOD_M < low.max() < 0.2 * scale + STOOD_M
    assert abs(low[:12]).max() < STOOD_M and abs(low[-12:]).max() < STOOD_M


def test_who_would_fall_without_a_seat_sits():
    body, grounded = shipped_bodies()[6], ground(sitting())
    assert grounded.sits.all()
    (vertices, _), seat = take_seat(body, grounded, 3, Chair())
    trunk = vertices[flesh_of(body).trunk, 2].min()
    assert 0.2 < seat.height < 0.6 and abs(trunk - (seat.height - seat.give_m)) < 0.01
    assert perform(body, grounded).seat is not None


def test_the_legs_of_a_seat_end_below_it_at_the_height_of_a_motion(monkeypatch):
    class Sitting:
        def draw(self, rng):
            return "sitting", grounded, 3

    def seated(*scene):
        posed, seat = take_seat(*scene)
        seats.append(seat)
        return posed, seat

    grounded, seats = ground(sitting()), []
    monkeypatch.setattr("synth.motion.placed.take_seat", seated)
    for seed in range(8):
        MotionScenes(Sitting())(np.random.default_rng(seed), shipped_bodies()[6])
    assert {type(seat) for seat in seats} == {Sofa, Chair}
    assert all(one.high[2] <= seat.height for seat in seats for one in seat.solids()[len(seat.soft) :])


def test_what_nobody_can_do_is_bridged():
    motion = squatting(40)
    angles = motion.angles_rad.copy()
    angles[20:23, 0, 0] += 1.5
    grounded = ground(replace(motion, angles_rad=angles))
    assert not grounded.sound[20:23].any() and grounded.sound.sum() >= 30
    np.testing.assert_allclose(grounded.angles_rad[21, 0], motion.angles_rad[21, 0], atol=0.05)
    assert grounded.clear_m[20:23].min() == 0


def test_another_frame_rate_is_the_same_motion():
    motion = squatting(41)
    again = resampled(resampled(motion, 120.0), RATE)
    assert len(again) == 41
    np.testing.assert_allclose(again.angles_rad, motion.angles_rad, atol=1e-6)


DIALECT = {"wrist": "hand", "elbow": "forearm", "shoulder": "arm", "hip": "upleg", "knee": "leg"}


def joint_file(path: Path, motion: Motion, last: str = "right_foot") -> Path:
    """The motion's joints in millimetres as two takes, named in another dialect than ours."""
    flesh = flesh_of(person_body(motion.bones_m))
    joints = [
        forward(Posture(a, p), flesh.rest_joints_m, flesh.aligned)[1]
        for a, p in zip(motion.angles_rad, motion.pelvis_m, strict=True)
    ]
    names = [joint.name.replace(joint.kind, DIALECT.get(joint.kind, joint.kind)) for joint in JOINTS]
    names = [name.replace("clavicle", "collar") for name in names[:-1]] + [last]
    millimetres = np.rint(1000 * np.array(joints)).astype(np.int16)
    np.savez(path, joint_names=np.array(names), parents=PARENTS, a=millimetres, b=millimetres[:9])
    return path


def test_a_file_of_joint_positions_gives_back_the_angles(tmp_path):
    motion = squatting(30)
    found = solve_takes(*read_joint_file(joint_file(tmp_path / "lib.npz", motion)))
    assert list(found) == ["a", "b"] and len(found["b"]) == 9
    knee = JOINT_ID["left_knee"]
    assert np.abs(np.degrees(found["a"].angles_rad - motion.angles_rad)[:, knee, 0]).max() < 3
    assert found["a"].leg_m == pytest.approx(motion.leg_m, rel=0.02)


def test_a_dataset_of_a_motion_names_it_and_is_the_same_again(tmp_path):
    save_motion(tmp_path / "squat.npz", squatting(30))
    repertoires = [read_repertoire(tmp_path), read_repertoire(tmp_path / "squat.npz")]
    orders = [Order(preset_of(r), 2, 5, 2) for r in repertoires]
    assert orders[0].manifest()["motion"] == {
        "name": tmp_path.name,
        "sha256": repertoires[1].sha256,
        "motions": 1,
    }
    shards = [make_shard(order, 0) for order in orders]
    assert shards[0] == shards[1]
    (tmp_path / "s.tar").write_bytes(shards[0])
    assert {frame.notes["activity"] for frame in read_shard(tmp_path / "s.tar")} == {"squat"}


def test_a_film_is_a_session_with_truth(tmp_path, monkeypatch):
    monkeypatch.setattr(synth.rig.film, "SHORTEST_S", 0.1)
    rig = FilmRig("squat", squatting(4), "clean", 0)
    simulate(rig, tmp_path / "film.mcap", lambda n: None)
    session, truth = Session(tmp_path / "film.mcap"), LabelSet.open(truth_path(tmp_path / "film.mcap"))
    assert len(session) == len(truth) == 4
    assert np.diff([frame.stamp_ns for frame in session]).mean() == pytest.approx(1e9 / 30, rel=1e-3)
    assert all(len(np.unique(frame.parts)) >= 10 for frame in truth)


def test_what_is_no_motion_is_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    save_motion(tmp_path / "two.npz", replace(squatting(2)))
    dog = joint_file(tmp_path / "dog.npz", squatting(3), "Tail1")
    cases = {
        "holds no motions": lambda: motion_files(tmp_path / "empty"),
        "does not exist": lambda: motion_files(tmp_path / "nowhere"),
        "0.07 s; give": lambda: FilmRig("two", read_take(tmp_path / "two.npz", None)[1], "clean", 0),
        "Tail1": lambda: read_motions(dog),
        "takes; name one": lambda: read_take(joint_file(tmp_path / "lib.npz", squatting(3)), None),
    }
    for text, act in cases.items():
        with pytest.raises(CloudError, match=text) as error:
            act()
        assert "\n" not in str(error.value)


def test_recorded_people_stand_on_the_floor(shared_data):
    takes, places = read_joint_file(shared_data / "mocap_library" / "cmu_joints.npz")
    grounded = ground(solve_takes({"a": takes["train__jumping_1"]}, places)["a"])
    body = crowd()[7]
    feet = [np.flatnonzero(body.strongest_joints == JOINT_ID[f"{side}_ankle"]) for side in ("left", "right")]
    assert 0.1 < grounded.clear_m.min(axis=1).max() < 0.4
    for frame in range(0, len(grounded), 13):
        vertices, _ = stand(body, grounded, frame)
        standing = [foot for foot, clear in zip(feet, grounded.clear_m[frame], strict=False) if clear == 0]
        assert all(abs(vertices[foot, 2].min()) < STOOD_M for foot in standing)
