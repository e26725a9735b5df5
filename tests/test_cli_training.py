"""The verb ``train``: it resumes, starts from weights, and refuses mistakes in one line."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from sensors.rig.camera import Intrinsics


@pytest.fixture(scope="module")
def labels(tmp_path_factory) -> LabelSet:
    """Return four small frames of two people."""
    path = tmp_path_factory.mktemp("labels") / "labels"
    found = LabelSet.create(path, Intrinsics(60, 50, 60.0, 60.0, 29.5, 24.5), {})
    for i in range(4):
        parts = np.zeros((50, 60), np.uint8)
        parts[5:25, 10 + i : 40] = 1
        parts[25:45, 10 + i : 40] = 2
        depth = np.where(parts > 0, np.uint16(1800) + 10 * parts, np.uint16(0)).astype(np.uint16)
        found.write(FrameLabels(f"f{i}", depth, parts, subject="ab"[i % 2]))
    return found


def small(labels: LabelSet, out: object, *more: object) -> tuple[object, ...]:
    return ("train", labels.path, "--out", out, "--batch", 2, "--network", "compact-small", *more)


def test_a_run_goes_on_and_its_weights_start_another_and_predict(
    annotate_cloud, tmp_path, labels, rig_session
):
    out = ("--out", tmp_path / "p")
    command = small(labels, tmp_path / "t", "--epochs", 2, "--hold-out", "a", "--without", "cuts", "--json")
    done = annotate_cloud(*command)
    assert done.code == 0, done.err
    assert done.result["epochs"] == 2
    assert "4 of 4 frames" in done.err
    assert done.result["calibrated_on"] == {"images": 0, "subjects": []}
    assert "too few to calibrate on" in done.err and done.result["temperature"] == 1.0
    assert 0 <= done.result["history"][-1]["mean_recall"] <= 1
    plan = json.loads((tmp_path / "t" / "plan.json").read_text())
    assert plan["data"]["images"] == 2
    assert plan["augmentation"]["cuts"] is False
    assert plan["augmentation"]["noise"] is True
    assert plan["precision"] == "float32"
    made = {name: (tmp_path / "t" / name).read_bytes() for name in ("weights.safetensors", "weights.onnx")}
    assert annotate_cloud(*command).result["history"] == done.result["history"]
    for name, data in made.items():
        assert (tmp_path / "t" / name).read_bytes() == data

    predicted = annotate_cloud("predict", rig_session, "--weights", tmp_path / "t" / "weights.onnx", *out)
    assert predicted.code == 0, predicted.err
    start = tmp_path / "t" / "weights.safetensors"
    more = annotate_cloud("train", labels.path, "--init", start, "--epochs", 1, "--out", tmp_path / "u")
    assert more.code == 0, more.err
    recipe, plan = plan["recipe"], json.loads((tmp_path / "u" / "plan.json").read_text())
    assert plan["recipe"]["peak_rate"] < recipe["peak_rate"] and plan["recipe"]["coarse"] == 0
    assert plan["network"] == {"kind": "compact", "widths": [16, 24, 32, 48, 64], "layers": 2}
