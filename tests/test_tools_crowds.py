"""Counts of detected people in crowded scenes: found, joined, split, phantoms."""

from itertools import islice

import numpy as np
import pytest

from eval.training.rooms.empty_rooms import ROOMS, empty_rooms
from eval.training.rooms.scenes import Scene
from sensors.rig.camera import Intrinsics
from synth.data_files import TRAINING
from tools.finder.empty_rooms import COLUMNS, row
from tools.measure.crowds import tally

CAMERA = Intrinsics(300, 100, 200.0, 200.0, 149.5, 49.5)


def scene_of(persons, whole_px):
    depth = np.full(CAMERA.shape, 2000, np.uint16)
    return Scene(CAMERA, depth, np.full(CAMERA.shape, np.nan, np.float32), persons, "stereo", whole_px)


def test_a_person_is_found_joined_or_split_and_things_are_phantoms():
    persons = np.zeros(CAMERA.shape, np.uint8)
    persons[10:90, 20:60], persons[10:90, 60:90], persons[40:80, 200:220] = 1, 2, 3
    scene = scene_of(persons, (3200.0, 2400.0, 800.0))
    # The third person is too small.
    assert tally(scene, persons) == {"images": 1, "people": 2, "found": 2}
    joined = np.where(persons == 2, np.uint8(1), persons)
    assert tally(scene, joined) == {"images": 1, "people": 2, "found": 1, "joined": 1}
    split = persons.copy()
    split[10:30, 20:60], split[:20, 120:180] = 4, 5
    assert tally(scene, split) == {"images": 1, "people": 2, "found": 2, "split": 1, "phantoms": 1}
    assert tally(scene, np.zeros_like(persons)) == {"images": 1, "people": 2}
    # A quarter of a person in view does not count.
    assert tally(scene_of(persons, (12_800.0, 2400.0, 800.0)), persons)["people"] == 1


def test_an_empty_image_is_haunted_by_any_detection():
    empty, seen = np.zeros(CAMERA.shape, np.uint8), np.zeros(CAMERA.shape, np.uint8)
    assert tally(scene_of(empty, ()), empty) == {"images": 1, "empty": 1}
    seen[:10, :10], seen[20:30, :10] = 1, 2
    assert tally(scene_of(empty, ()), seen) == {"images": 1, "empty": 1, "haunted": 1, "phantoms": 2}


@pytest.mark.parametrize("kind", ROOMS)
def test_empty_rooms_have_no_person_and_one_kind_of_sensor(kind):
    scenes, again = (list(islice(empty_rooms(kind, "lidar", 5, TRAINING), 2)) for _ in range(2))
    assert not any(scene.persons.any() or scene.whole_px for scene in scenes)
    assert {scene.sensor for scene in scenes} == {"lidar"}
    assert all(np.array_equal(a.depth_mm, b.depth_mm) for a, b in zip(scenes, again, strict=True))
    assert not np.array_equal(scenes[0].depth_mm, scenes[1].depth_mm)


def test_phantoms_are_counted_per_thousand_frames():
    cells = dict(zip(COLUMNS, row("close", "lidar", np.array([0, 2, 0, 0])), strict=True))
    assert (cells["with phantoms"], cells["phantoms per 1,000 frames"], cells["standard error"]) == (
        "1", "500", "433"
    )  # fmt: skip
