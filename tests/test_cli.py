"""Verbs as a new user runs them: results on stdout, remarks on stderr, exit codes."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import tree

from annotate.labelset.label_set import LabelSet
from annotate.parts import BODY_PARTS
from annotate.suit.palette import DEFAULT_SUIT, load_suit
from cli.console import cell, table
from eval.network.refine import SHIPPED_REFINEMENT_NETWORK
from sensors.session.messages import COLOR, THERMAL, color_message, thermal_message
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from synth.rig.simulate import suit_path, truth_path

SCRIPT = Path(sys.executable).with_name("annotate-cloud")
SCORES = {
    *("frames", "mean_recall", "recall", "miou", "iou"),
    *("boundary_f", "left_right_swap_rate", "person_iou", "joints", "scheme"),
}


@pytest.fixture
def half_corrupt(tmp_path, rig_session) -> Path:
    """``rig_session`` with the colour image of its second frame cut off."""
    source, path = Session(rig_session), tmp_path / "half.mcap"
    with SessionWriter(path, source.calibration, "half") as writer:
        for frame in source:
            color = frame.color_encoded[:500] if frame.index == 1 else frame.color_encoded
            writer.add(COLOR, color_message(color, frame.stamp_ns), frame.stamp_ns)
            writer.add(THERMAL, thermal_message(frame.thermal_c, frame.stamp_ns), frame.stamp_ns)
            writer.write_depth(frame.depth_mm, frame.stamp_ns)
    return path


@pytest.mark.usefixtures("draft_rigs")
def test_simulate_records_and_is_the_same_for_the_same_seed(annotate_cloud, tmp_path):
    done = [
        annotate_cloud("simulate", tmp_path / d / "s.mcap", "--frames", 1, "--seed", 3, "--json")
        for d in ("a", "b")
    ]
    assert [d.code for d in done] == [0, 0]
    path = tmp_path / "a" / "s.mcap"
    assert done[0].result == {"frames": 1, "truth": str(truth_path(path)), "suit": str(suit_path(path))}
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    assert {p.name for p in (tmp_path / "a").iterdir()} == {"s.mcap", "s.truth", "s.suit.toml"}


@pytest.mark.usefixtures("draft_rigs")
def test_simulate_dresses_people_in_the_suit_given(annotate_cloud, tmp_path):
    drawn, given = tmp_path / "drawn.mcap", tmp_path / "given.mcap"
    annotate_cloud("simulate", drawn, "--frames", 1, "--suit", "random", "--difficulty", "clean", "--seed", 3)
    suit = load_suit(suit_path(drawn))
    assert suit.name == "random suit 3" and not np.array_equal(suit.colors_rgb, DEFAULT_SUIT.colors_rgb)
    same = ("--frames", 1, "--suit", suit_path(drawn), "--difficulty", "clean", "--seed", 3)
    annotate_cloud("simulate", given, *same)
    assert given.read_bytes() == drawn.read_bytes()
    missing = annotate_cloud("simulate", tmp_path / "x.mcap", "--suit", tmp_path / "none.toml")
    assert missing.code == 1 and "none.toml" in missing.err and not (tmp_path / "x.mcap").exists()


def test_info_and_validate_know_all_kinds(annotate_cloud, rig_session, rig_labels):
    kinds = {rig_session: "Session", rig_labels.path: "label set", truth_path(rig_session): "label set"}
    for path, kind in kinds.items():
        info = annotate_cloud("info", path, "--json").result
        assert (info["kind"], info["frames"]) == (kind, 3)
        assert annotate_cloud("validate", path, "--json").result == {"ok": True, "problems": []}
        shown = annotate_cloud("info", path).out.split("\n")
        assert shown[0].split(maxsplit=1) == ["kind", kind]


def test_label_writes_what_the_library_writes(annotate_cloud, tmp_path, rig_session, rig_labels):
    done = annotate_cloud(
        "label", rig_session, "--suit", suit_path(rig_session), "--out", tmp_path / "l", "--json"
    )
    assert done.code == 0
    assert done.result["frames"] == 3
    assert done.result["seconds_per_frame"] > 0
    assert sorted(done.result["review"]) == rig_labels.frame_ids
    confidence = [rig_labels.notes(i)["confidence"] for i in done.result["review"]]
    assert confidence == sorted(confidence)
    assert tree(tmp_path / "l") == tree(rig_labels.path)


def test_diff_evaluate_and_report(annotate_cloud, tmp_path, rig_session, rig_labels):
    diff = annotate_cloud("diff", rig_labels.path, truth_path(rig_session), "--json").result
    assert set(diff) == SCORES
    assert diff["frames"] == 3
    assert set(diff["recall"]) == set(diff["iou"]) == {part.name for part in BODY_PARTS}

    same = annotate_cloud("diff", truth_path(rig_session), truth_path(rig_session), "--json").result
    assert (same["mean_recall"], same["miou"], same["person_iou"]) == (1, 1, 1)

    result = tmp_path / "results" / "auto.npz"
    evaluated = annotate_cloud(
        "evaluate", rig_labels.path, truth_path(rig_session), "--out", result, "--title", "Auto", "--json"
    ).result
    assert diff.items() <= evaluated.items()
    assert {"ci95", "confusion"} <= set(evaluated)

    page = tmp_path / "report.html"
    assert annotate_cloud("report", result, "--out", page, "--json").result["path"] == str(page)
    html = page.read_text()
    assert "Auto" in html
    assert "data:image/" in html


def test_predict_refines_by_a_network_of_learn(annotate_cloud, tmp_path, rig_session):
    weights = ("--learnt", SHIPPED_REFINEMENT_NETWORK)
    done = annotate_cloud("predict", rig_session, *weights, "--out", tmp_path / "p", "--json")
    assert (done.code, done.result["frames"]) == (0, 3)


def test_predict_on_a_session_and_within_given_outlines(annotate_cloud, tmp_path, rig_session, rig_labels):
    done = annotate_cloud("predict", rig_session, "--out", tmp_path / "a", "--json")
    assert (done.code, done.result["frames"]) == (0, 3)
    assert done.result["ms_per_frame"] > 0
    done = annotate_cloud("predict", rig_labels.path, "--out", tmp_path / "b", "--json")
    assert done.result["frames"] == 3
    for predicted, given in zip(LabelSet.open(tmp_path / "b"), rig_labels, strict=True):
        np.testing.assert_array_equal(predicted.parts > 0, given.parts > 0)
        np.testing.assert_array_equal(predicted.depth_mm, given.depth_mm)


def test_a_folder_of_pngs_goes_the_whole_way(annotate_cloud, tmp_path, rig_session):
    """The README's two lines for a user's own depth images."""
    session, folder = Session(rig_session), tmp_path / "mine"
    folder.mkdir()
    camera = session.calibration.depth
    for frame in session:
        cv2.imwrite(str(folder / f"{frame.index}.png"), frame.depth_mm)
    numbers = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    (folder / "intrinsics.json").write_text(json.dumps(numbers))

    imported = annotate_cloud("import", folder, tmp_path / "s.mcap", "--json")
    assert (imported.result["frames"], imported.result["streams"]) == (3, {"depth": 3})
    assert "no colour images" in imported.err
    done = annotate_cloud("label", tmp_path / "s.mcap", "--out", tmp_path / "l", "--json")
    assert (done.code, done.result["frames"]) == (0, 3)
    assert {"no colour images", "no thermal images"} <= set(done.err.splitlines())
    assert LabelSet.open(tmp_path / "l").notes("000000")["extraction"] == "depth"


def test_the_demo_runs_the_whole_path(annotate_cloud, tmp_path):
    done = annotate_cloud("demo", "--out", tmp_path / "d", "--frames", 2, "--json")
    assert done.code == 0
    result = done.result
    scores = {name: set(result[name]) for name in ("auto", "corrected", "fcn")}
    assert all(names == {"mean_recall", "miou"} for names in scores.values())
    assert {"frames", "person_iou", "effort_seconds_median", "report", "seconds"} <= set(result)
    assert result["corrected"]["miou"] >= result["auto"]["miou"]
    assert Path(result["report"]).read_text().startswith("<!doctype html>")

    again = annotate_cloud("demo", "--out", tmp_path / "d", "--frames", 2)
    assert (again.code, again.err.count("\n")) == (1, 1)
    assert "--overwrite" in again.err


def test_one_bad_frame_fails_alone(annotate_cloud, tmp_path, half_corrupt, rig_session, rig_labels):
    out = tmp_path / "l"
    command = ("label", half_corrupt, "--suit", suit_path(rig_session), "--out", out, "--json")
    for _ in range(2):  # the second run resumes, and fails alike
        done = annotate_cloud(*command)
        assert (done.code, done.result["frames"]) == (3, 2)
        (failed,) = done.result["failed"]
        assert failed["frame"] == "000001"
        assert "cannot be decoded" in failed["why"]
        assert "frame 000001" in done.err
    alone = tmp_path / "alone.mcap"  # labels of the third frame do not depend on the failed frame
    with SessionWriter(alone, (source := Session(rig_session)).calibration, "alone") as writer:
        writer.write(source.frame(2))
    annotate_cloud("label", alone, "--suit", suit_path(rig_session), "--out", tmp_path / "a")
    kept, third = LabelSet.open(out), LabelSet.open(tmp_path / "a").read("000000")
    np.testing.assert_array_equal(kept.read("000000").parts, rig_labels.read("000000").parts)
    np.testing.assert_array_equal(kept.read("000002").parts, third.parts)
    checked = annotate_cloud("validate", half_corrupt, "--json")
    assert checked.code == 1
    (problem,) = checked.result["problems"]
    assert problem.startswith("frame 000001: colour image")


def test_one_corrupt_label_fails_alone(annotate_cloud, tmp_path, rig_labels):
    shutil.copytree(rig_labels.path, tmp_path / "l")
    (tmp_path / "l" / "frames" / "000001.depth.png").write_bytes(b"not a png")
    done = annotate_cloud("predict", tmp_path / "l", "--out", tmp_path / "p", "--json")
    assert (done.code, done.result["frames"]) == (3, 2)
    assert [f["frame"] for f in done.result["failed"]] == ["000001"]
    assert "000001.depth.png" in done.result["failed"][0]["why"]


@pytest.mark.parametrize(
    "line",
    [
        *("frobnicate", "label", "label x.mcap", "label x.mcap --out l --window warm hot"),
        *("label x.mcap --out l --window 35 25", "label x.mcap --out l --window nan 35"),
        *("simulate x.mcap --seed -1", "simulate x.mcap --frames 0", "simulate x.mcap --subjects many"),
        *("demo --out d --seed -1", "train x --out t --epochs 0", "train x --out t --seed -1"),
        "record r.mcap --device virtual:kinect2 --suit no.toml",
        *(
            "adapt . --out a --minutes nan",
            "train . --out t --minutes inf",
            "adapt . --out a --minutes 1e308",
        ),
        *("train . --out t --checkpoint-minutes nan", "live --seconds nan", "record r.mcap --seconds inf"),
    ],
)
def test_wrong_usage_is_2_and_touches_nothing(annotate_cloud, tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    done = annotate_cloud(*line.split())
    assert (done.code, done.out) == (2, "")
    assert done.err
    assert not list(tmp_path.iterdir())


def test_the_installed_command_keeps_its_streams_apart(rig_session, tmp_path):
    """The real script: JSON alone on stdout, plain progress lines on stderr, a user's error in one line."""
    script = [str(SCRIPT)] if SCRIPT.is_file() else [sys.executable, "-m", "cli.main"]

    def run(*words):
        return subprocess.run([*script, *words], capture_output=True, text=True, check=False)

    good = run("label", str(rig_session), "--out", str(tmp_path / "l"), "--json")
    assert (good.returncode, json.loads(good.stdout)["frames"]) == (0, 3)
    assert any(line.startswith("label: 3/3") for line in good.stderr.splitlines())
    assert "\x1b" not in good.stderr
    bad = run("info", "absent.mcap")
    assert (bad.returncode, bad.stdout) == (1, "")
    assert bad.stderr.startswith("annotate-cloud: absent.mcap ") and bad.stderr.count("\n") == 1


def test_cells_have_three_digits_a_unit_and_a_dash_for_none_nan_and_empty():
    values = (0.96344, 0.0, 99.96, 12345.6, 0.00012, 1234, True, None, float("nan"), "", {"a": 1, "b": 0.5})
    assert [cell(value) for value in values] == [
        "0.963", "0", "100", "12,346", "0.00012", "1,234", "yes", "-", "-", "-", "a 1, b 0.500",
    ]  # fmt: skip
    assert cell(0.26, "s") == "0.260 s"


def test_tables_set_numbers_to_the_right_and_interpret_no_markup():
    lines = table(("part", "px"), [("[red]head", 5), ("arm", 1200)], "Work").split("\n")
    assert lines[0] == "Work"
    assert [line.split() for line in (lines[1], *lines[3:])] == [
        ["part", "px"], ["[red]head", "5"], ["arm", "1,200"],
    ]  # fmt: skip
    assert lines[3].endswith("    5")
