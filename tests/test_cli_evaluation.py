"""The verbs evaluate and compare: printed text, kept results, and refusals."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from eval.compare.results import load_result
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


def test_a_result_in_the_way_is_seen_before_measuring(annotate_cloud, folder, tmp_path):
    taken = tmp_path / "r.npz"
    taken.write_text("mine")
    done = annotate_cloud("evaluate", tmp_path / "nowhere", folder / "truth", "--out", taken)
    assert done.code == 1 and "already exists" in done.err and taken.read_text() == "mine"


def test_bad_input_gives_one_line(annotate_cloud, folder, tmp_path):
    (tmp_path / "null.json").write_text("null")
    (tmp_path / "empty").mkdir()
    for command, says in (
        (("evaluate", folder / "other", folder / "truth"), "frame 000000 has another depth image"),
        (("evaluate", folder / "good", tmp_path / "empty"), "is not a label set"),
        (("evaluate", folder / "good", tmp_path / "nowhere"), "nowhere does not exist; check its name"),
        (("compare", tmp_path / "null.json", tmp_path / "null.json"), "null.json cannot be read"),
        (("compare", tmp_path / "absent.json", tmp_path / "null.json"), "absent.json cannot be read"),
        (("compare", folder, tmp_path / "null.json"), "cannot be read"),
    ):
        done = annotate_cloud(*command)
        assert done.code == 1 and says in done.err and done.err.count("\n") == 1, done.err
