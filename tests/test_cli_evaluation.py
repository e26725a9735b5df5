"""The verbs evaluate and compare: printed text, kept results, and refusals."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import assert_refused

from annotate.labelset.cast_note import known_people_note
from eval.compare.results import load_result
from synth.data_files import JUDGE, TRAINING
from synth.images.generate import Order
from synth.images.presets import preset_named
from tests.helpers.shards import write_dataset
from tests.test_eval_compare import guess_frame, label_set, truth_frame


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset as the truth, two predictions of it, and one of another session."""
    out = tmp_path_factory.mktemp("evaluated")
    write_dataset(out / "truth", [truth_frame(i) for i in range(6)], 4)
    label_set(out / "good", [guess_frame(i, better=True) for i in range(6)])
    label_set(out / "bad", [guess_frame(i) for i in range(6)])
    other = [guess_frame(i) for i in range(6)]
    label_set(out / "other", [replace(f, depth_mm=f.depth_mm + (f.depth_mm > 0)) for f in other])
    return out


def test_evaluate_keeps_a_result_and_compare_tells_two_apart(annotate_cloud, folder, tmp_path):
    results = {}
    for name in ("good", "bad"):
        results[name] = tmp_path / "kept" / f"{name}.npz"
        done = annotate_cloud(
            "evaluate", folder / name, folder / "truth", "--out", results[name], "--title", name, "--json"
        )
        assert done.code == 0 and "3 subjects: the interval is wide" in done.err
        assert {"ci95", "confusion", "mious", "by", "reliability", "suspicious"} <= set(done.result)
        assert done.result["frames"] == 6 and done.result["reliability"]["all"]["pixels"]
    facts = load_result(results["good"]).facts
    assert facts["truth"] == str(folder / "truth") and len(facts["predicted hash"]) == 64
    assert facts["command"].startswith("annotate-cloud ")

    better = annotate_cloud("compare", results["good"], results["bad"], "--json").result
    assert better["paired"] and better["frames"] == [6, 6] and better["a"] == "good"
    assert better["difference"]["miou"] > 0 and better["wilcoxon_p"]["miou"] is None
    low, high = better["ci95"]["miou"]
    assert low < better["difference"]["miou"] < high
    shown = annotate_cloud("compare", results["good"], results["bad"]).out
    assert shown.startswith("good minus bad, on the same frames\n")
    assert re.search(r"Mean recall +\+0\.\d{3} \[[+-]0\.\d{3}, \+0\.\d{3}\]", shown)
    assert "most gained" in shown
    printed = annotate_cloud("evaluate", folder / "good", folder / "truth").out
    assert printed.startswith("6 frames of 3 people\n") and re.search(r"swaps +\d+\.\d %", printed)
    assert re.search(r"Recall by part: best .+ \(1\.000\), worst .+ \(0\.\d{3}\)", printed)
    assert re.search(r"mIoU +0\.\d{3}\n", annotate_cloud("diff", folder / "good", folder / "truth").out)


def test_labels_of_other_images_are_refused(annotate_cloud, folder):
    done = annotate_cloud("evaluate", folder / "other", folder / "truth")
    assert_refused(done, "frame 000000 has another depth image", remarks=done.err.count("evaluate: "))


def test_scores_on_people_that_trained_the_networks_have_a_note(rig_session, annotate_cloud):
    truth = rig_session.with_suffix(".truth")
    done = annotate_cloud("diff", truth, truth)
    assert done.code == 0 and "--cast judge" in done.err and "second" not in done.err
    notes = [
        known_people_note(Order(preset_named("people", cast), 1, 0).manifest()) for cast in (TRAINING, JUDGE)
    ]
    assert [bool(note) for note in notes] == [True, False]
    assert not known_people_note({"source": "ward", "steps": {}})
