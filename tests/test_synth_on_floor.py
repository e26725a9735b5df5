"""People on an open floor: they touch it, keep out of the wall, and never jump."""

from itertools import islice

import numpy as np
import pytest

from synth.body.body import shipped_bodies
from synth.body.skeleton import JOINT_ID
from synth.pose.on_floor import KINDS, OFF_WALL_M, ROAM_M, OnFloor
from synth.surface.furniture import FLOOR

BODY = shipped_bodies()[3]
SCENE = OnFloor(wall_y=0.8)
HEAD = JOINT_ID["head"]


def moments(kind, count):
    rng, made = np.random.default_rng(5), []
    while len(made) < count:
        moment = SCENE.draw(rng)
        if KINDS[int(moment["kind"])] == kind:
            made.append(moment)
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_everybody_is_carried_by_the_floor_and_none_is_in_the_wall(kind):
    heads = []
    for moment in moments(kind, 4):
        vertices, joints = SCENE.pose(BODY, moment)
        assert vertices[:, 2].min() == pytest.approx(-FLOOR.give_m, abs=1e-4)
        assert vertices[:, 1].max() <= SCENE.wall_y - OFF_WALL_M + 1e-4
        assert np.abs(joints[:, 0].mean()) < ROAM_M + 1e-6
        heads.append(joints[HEAD, 2])
    low, high = {"standing": (0.7, 2), "upright": (0.4, 2), "slumped": (0.3, 1), "fallen": (0, 0.5)}[kind]
    assert low < min(heads) <= max(heads) < high


def test_who_is_slumped_leans_on_the_wall():
    for moment in moments("slumped", 4):
        vertices, _ = SCENE.pose(BODY, moment)
        assert vertices[:, 1].max() == pytest.approx(SCENE.wall_y - OFF_WALL_M, abs=0.01)


def test_from_posture_to_posture_joints_go_a_short_way_and_arrive():
    """At 30 frames a second no person jumps, whatever two postures are glided between."""
    stream = SCENE.stream(np.random.default_rng(2), 30.0)
    joints = np.array([SCENE.pose(BODY, moment)[1] for moment in islice(stream, 60)])
    assert np.linalg.norm(np.diff(joints, axis=0), axis=2).max() < 0.25
    assert np.linalg.norm(joints[-1] - joints[0], axis=1).max() > 0.1


def test_a_moment_is_the_same_whenever_it_is_posed():
    moment = moments("upright", 1)[0]
    again = OnFloor(wall_y=0.8).pose(BODY, dict(moment))
    for a, b in zip(SCENE.pose(BODY, moment), again, strict=True):
        np.testing.assert_array_equal(a, b)
