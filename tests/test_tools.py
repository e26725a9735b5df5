"""Measuring tools and benchmarks: imports, and chains of benchmarks."""

import importlib
from pathlib import Path

import pytest

from annotate.labelset.label_set import LabelSet
from bench import label, predict
from eval.network.onnx_network import OnnxNetwork
from eval.network.refine import shipped_refinement_network
from sensors.session.reader import Session

ROOT = Path(__file__).parent.parent
ALONE = {"tools.fuzz.run"}
"""Needs its own process and an extra, because it instruments later imports."""
PATHS = [path.relative_to(ROOT) for folder in ("tools", "bench") for path in (ROOT / folder).rglob("*.py")]
MODULES = sorted({".".join(path.with_suffix("").parts) for path in PATHS} - ALONE)


@pytest.mark.parametrize("name", MODULES)
def test_a_tool_can_be_imported_and_shows_how_it_is_run(name):
    module = importlib.import_module(name)
    runs = "__main__" in Path(module.__file__).read_text()
    assert runs == (f"python -m {name}" in module.__doc__)


def test_the_benchmark_of_prediction_labels_a_recording_like_the_product(monkeypatch, rig_session, tmp_path):
    monkeypatch.setattr(predict, "FRAMES", 1)
    monkeypatch.setattr(predict, "RECORDED", 1)
    network, refiner = OnnxNetwork(), shipped_refinement_network()
    predict.recording_seconds(tmp_path, Session(rig_session), network, refiner)
    ours, singly = (LabelSet.open(tmp_path / name) for name in ("recording", "singly"))
    assert len(ours) == 3 and singly.scheme == ours.scheme
    for one, other in zip(singly.frame_ids, ours.frame_ids, strict=False):
        parts = singly.read(one).parts, ours.read(other).parts
        assert parts[0].any() and (parts[0] == parts[1]).mean() > 0.95


def test_the_naive_crop_and_paste_of_the_benchmark_label_like_the_product(rig_labels):
    frame = rig_labels.read(rig_labels.frame_ids[0])
    image = frame.depth_mm, frame.on_person
    for network in (OnnxNetwork(), predict.Silent()):
        found = network.segment(*image).parts
        naive = network.scheme.class_ids[predict.segment_naive(network, *image)]
        on_person = found > 0
        assert on_person.any() and (found == naive)[on_person].mean() > 0.7


def test_the_benchmark_of_labels_by_a_suit_runs(monkeypatch, shot_before):
    monkeypatch.setattr(label, "FRAMES", 2)
    [(_, ours, naive)] = label.bench()
    assert ours > 0 < naive
