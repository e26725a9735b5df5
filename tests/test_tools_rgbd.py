"""RGB-D recordings: the measures agree with an outside judge's; unregistered colour is refused."""

import json
import runpy
import shutil
from collections import Counter

import cv2
import numpy as np
import pytest

from eval.network.joints.joint_files import write_joints
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.predict_source import predict_source
from sensors.errors import CalibrationError, FormatError
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics
from tools.measure import colour_people, rgbd
from tools.measure.people_file import PEOPLE_FILE, read_people
from tools.measure.rgbd_tally import AS_JOINTS, JUDGED, Found, Seen, Tally

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def standing(x: float = 30.0) -> np.ndarray:
    """A person (33, 3) who faces the camera, all landmarks visible."""
    person = np.tile([x, 10.0, 1.0], (33, 1))
    for joint, y in enumerate((14, 20, 26), start=5):
        person[2 * joint + 1 : 2 * joint + 3, :2] = (x + 4, y), (x - 4, y)
    for joint, y in enumerate((28, 36, 44)):
        person[2 * joint + 23 : 2 * joint + 25, :2] = (x + 3, y), (x - 3, y)
    return person


def found(person: np.ndarray) -> Found:
    at = np.full((15, 3), np.nan)
    at[AS_JOINTS] = person[JUDGED] * (1, 1, 0) + (0, 0, 2000)
    return Found(at, 0.0, "standing")


@pytest.mark.parametrize(("folder", "frames"), [("sofa", 5), ("upper_body", 2), ("nobody", 4)])
def test_measures_are_those_of_the_recordings_own_judge(shared_data, tmp_path, folder, frames):
    whole, some = shared_data / "rgbd" / folder, tmp_path / folder
    (some / "depth").mkdir(parents=True)
    shutil.copy(whole / "intrinsics.json", some)
    names = [path.stem for path in sorted((whole / "depth").iterdir())[::10][:frames]]
    for name in names:
        shutil.copy(whole / "depth" / f"{name}.png", some / "depth" / f"{names.index(name):06d}.png")
    truth = whole / "people.json"
    people = json.loads(truth.read_text()) if truth.exists() else {name: [] for name in names}
    if any(people.values()):
        (some / "people.json").write_text(json.dumps({f"{i:06d}": people[n] for i, n in enumerate(names)}))
    options = rgbd.READINGS["`predict --everybody`"]()
    network = OnnxNetwork(SHIPPED_WEIGHTS)
    labels = predict_source(open_source(some), network, tmp_path / "p", lambda n: None, options).labels
    write_joints(labels, tmp_path / "joints.jsonl")
    score = runpy.run_path(str(shared_data / "rgbd" / "score.py"))["main"]
    expected = score(labels.path, some, tmp_path / "joints.jsonl")
    judged = [list(map(np.array, people[name])) for name in names]
    frames = rgbd.found_by_network(labels, len(names))
    n = sum(rgbd.tally_of(labels.whole_image, judged, frames).counts, Counter())
    assert all(n[name] == expected[name] for name in ("people", "lost", "joints", "phantoms"))
    for name in ("right", "unlabelled", "other_side", "other_side_far"):
        assert round(n[name] / max(n["joints"], 1), 4) == expected[name]
    for theirs, own in (("within_10", "near"), ("within_20", "wide")):
        assert round(n[own] / max(n["seen"], 1), 4) == expected[theirs]


def test_a_person_in_place_is_right_and_another_one_is_a_phantom():
    person, depth, tally = standing(), np.full((48, 64), 1900, np.uint16), Tally(CAMERA)
    tally.add([person], Seen(depth, None, [found(standing(57)), found(person)]))
    assert tally.counts[0] == {
        **{"frames": 1, "seen": 13, "near": 13, "wide": 13, "faced": 1, "facing": 1},
        **{"matched": 1, "standing": 1, "phantoms": 1},
    }
    np.testing.assert_allclose(tally.across_mm, 0)
    np.testing.assert_allclose(tally.behind_mm, 100)
    for names in ("a", "abcde"):
        row = rgbd.figures(dict.fromkeys(names, tally), "any")
        assert (row["within a tenth"].value, row["phantoms a frame"].value, row["behind, mm"].value) == (
            1,
            1,
            100,
        )
    moved = Tally(CAMERA)
    moved.add([person], Seen(depth, None, [found(person + np.array([2, 0, 0]))]))  # a seventh of the trunk
    assert (moved.counts[0]["near"], moved.counts[0]["wide"]) == (0, 13)
    np.testing.assert_allclose(moved.across_mm, 2 * 1900 / 60)


def test_unregistered_colour_is_refused(tmp_path):
    for folder, shape in (("depth", (48, 64)), ("color", (24, 32, 3))):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / "0.png"), np.zeros(shape, np.uint8))
    for error, match in ((CalibrationError, "register colour to depth"), (FormatError, "has no image")):
        with pytest.raises(error, match=match):
            colour_people.make_people(tmp_path, None)
        (tmp_path / "color" / "0.png").unlink(missing_ok=True)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("{", "is malformed"),
        ("[]", "is malformed"),
        ('{"0": 3}', "is malformed"),
        ('{"0": [[[1, 2, 3]]]}', "33 x 3 numbers"),
        (json.dumps({"0": [[[1, 2, None]] * 33]}), "33 x 3 numbers"),
        ('{"0.png": []}', "has no image '0'"),
        ('{"0": [], "1": []}', "depth/ has no image '1'"),
    ],
)
def test_malformed_people_are_refused(text, fault, tmp_path):
    path = tmp_path / PEOPLE_FILE
    path.write_text(text)
    with pytest.raises(FormatError, match=fault) as refused:
        read_people(path, ["0"])
    assert "\n" not in str(refused.value)
    path.write_text(json.dumps({"0": [standing().tolist()]}))
    np.testing.assert_array_equal(read_people(path, ["0"])["0"], [standing()])


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(FormatError, match="has no recording"):
        rgbd.recordings(tmp_path / "absent")
