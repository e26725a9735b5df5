"""Figures of joints: pooled groups, people without an interval, offsets of a tracker, real people by hand."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from eval.network.body_state import BodyState
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import predict_source
from eval.scores.joint_scores import GROUPS, JointErrors
from eval.scores.joint_visibility import HIDDEN, OUTSIDE, VISIBLE
from eval.scores.joints import JOINT, N_JOINTS
from sensors.importers.open_source import open_source
from tests.helpers import naive_joints
from tests.helpers.real_takes import first_frames
from tools.figures import joints, network, rig
from tools.figures.table import Kind
from tools.figures.tables import TABLES
from tools.measure import real_people
from tools.measure.real_people import People


def errors(people: int = 6, frames: int = 5, seed: int = 0) -> JointErrors:
    rng = np.random.default_rng(seed)
    apart = rng.gamma(3.0, 20.0, (people * frames, N_JOINTS))
    apart[0] = np.inf
    seen = rng.choice([HIDDEN, VISIBLE, OUTSIDE], apart.shape).astype(np.uint8)
    return JointErrors(apart, seen, tuple(f"s{i // frames}" for i in range(people * frames)))


def test_a_row_is_what_evaluate_prints():
    found = errors()
    row, printed = joints.row(found), found.to_json()
    assert row["error, mm"].value == pytest.approx(printed["mpjpe_mm"])
    assert row["error, mm"][1:3] == pytest.approx(printed["ci95"]["mpjpe_mm"])
    assert row["within 100 mm"].value == pytest.approx(printed["pck_100mm"])
    assert row["within 50 mm"][1:3] == pytest.approx(printed["ci95"]["pck_50mm"])
    for seen in ("visible", "hidden", "outside"):
        assert row[f"{seen}, mm"].value == pytest.approx(printed[seen]["mpjpe_mm"])
    assert len(row["error, mm"].without) == 6 and row["images"].value == 30


def test_both_sides_of_a_joint_are_one_row_and_one_person_has_no_interval():
    found = errors()
    own = found.errors_mm[:, [JOINT["left_knee"], JOINT["right_knee"]]]
    inside = found.visibility[:, [JOINT["left_knee"], JOINT["right_knee"]]] != OUTSIDE
    knees = joints.scores(found, joints.both_sides("left_knee"))
    assert knees["within 50 mm"].value == pytest.approx(np.mean(own[inside] <= 50))
    assert knees["error, mm"].value == pytest.approx(own[inside & np.isfinite(own)].mean(), abs=0.01)
    alone = joints.row(replace(found, subjects=("anna",) * 30))
    assert all(figure.certain and not figure.without for figure in alone.values())
    assert joints.joined([found, errors(seed=1)]).estimates.total[0, 0] > found.estimates.total[0, 0]


def people(apart_mm: np.ndarray, subjects: tuple[str, ...]) -> People:
    n = len(subjects)
    return People(subjects, np.zeros((n, 20, 4), np.int64), np.zeros(n), apart_mm)


def test_an_offset_is_of_the_other_people_and_no_person_tunes_his_own():
    rng = np.random.default_rng(5)
    offset = rng.normal(0, 80, (N_JOINTS, 3))
    subjects = tuple(f"s{i % 4}" for i in range(80))
    alike = people(np.tile(offset, (80, 1, 1)), subjects)
    assert np.abs(alike.without_offsets().apart_mm).max() < 1e-9
    other = alike.apart_mm.copy()
    other[::4] += 30.0  # the first person differs
    found = people(other, subjects).without_offsets().apart_mm
    np.testing.assert_allclose(found[::4], 30.0)
    lost = other.copy()
    lost[1] = np.inf
    row = joints.of_people(people(lost, subjects).without_offsets())
    assert row["within 100 mm"].value == pytest.approx(79 / 80) and "visible, mm" not in row


@pytest.mark.skipif(not real_people.PEOPLE.is_dir(), reason="recordings of real people are absent")
def test_joints_of_a_real_person_by_plain_loops(tmp_path):
    take, net = first_frames(real_people.PEOPLE / "takes" / "a24_s3_t1", tmp_path), OnnxNetwork()
    found = joints.of_people(real_people.measure_people(take, net))
    labels = predict_source(open_source(take), net, tmp_path / "p", lambda n: None).labels
    camera = json.loads((take / "intrinsics.json").read_text())
    tracked = json.loads((take / "joints.json").read_text())
    order = ["head", "neck", "spine", "pelvis"]
    order += [
        f"{side}_{kind}" for side in ("left", "right") for kind in ("shoulder", "elbow", "wrist", "hand")
    ]
    order += [f"{side}_{kind}" for side in ("left", "right") for kind in ("hip", "knee", "ankle", "foot")]
    apart = []
    for name, frame_id in zip(
        sorted(tracked, key=lambda n: int(n.split("_")[-1])), labels.frame_ids, strict=True
    ):
        state = BodyState.from_note(labels.notes(frame_id)["bearing"])
        for k, joint in enumerate(naive_joints.OF_NETWORK):
            (u, v), z = (tracked[name][what][order.index(joint)] for what in ("uv", "z_mm"))
            places = [(u, v, z), state.joints_px[k].tolist()]
            mm = [
                ((a - camera["cx"]) / camera["fx"] * d, (b - camera["cy"]) / camera["fy"] * d, d)
                for a, b, d in places
            ]
            apart.append(math.dist(*mm))
    assert found["error, mm"].value == pytest.approx(sum(apart) / len(apart), abs=0.1)
    assert found["within 100 mm"].value == pytest.approx(sum(one <= 100 for one in apart) / len(apart))
    assert found["error, mm"].certain


def test_the_tables_have_the_columns_of_their_rows(monkeypatch):
    table = {one.name: one for one in TABLES}
    monkeypatch.setattr(
        network, "people", lambda: {"f": people(np.zeros((8, N_JOINTS, 3)), tuple("abcd") * 2)}
    )
    recording = rig.Recording("sofa", "hard", 1)
    monkeypatch.setattr(rig, "measured_recordings", lambda seed: {recording: rig.Labelled({}, errors(), {})})
    monkeypatch.setattr(network, "judged", lambda seed: {})
    rows = table["joints"].measure(1)
    assert list(rows) == ["real people, raw", "real people, one offset a joint removed", "rig: sofa, `hard`"]
    assert set(rows["rig: sofa, `hard`"]) == set(table["joints"].columns)
    assert rows["real people, raw"]["error, mm"].value == 0.0
    assert table["joints"].kind in Kind.__args__ and GROUPS[0] == "inside"
