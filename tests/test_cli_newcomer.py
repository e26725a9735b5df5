"""Slips of a first user are refused in one line with a remedy."""

import shutil

import pytest
from conftest import assert_refused

from cli.console import event_lines

VERBS = ("info", "fix", "export", "diff")


@pytest.fixture
def two_sets(tmp_path, rig_labels):
    """Return a folder of two label sets, as ``label`` of a folder writes."""
    for name in ("a", "b ü"):
        shutil.copytree(rig_labels.path, tmp_path / "sets" / name)
    return tmp_path / "sets"


@pytest.mark.parametrize("verb", VERBS)
def test_a_folder_of_label_sets_and_an_absent_label_set_are_named(annotate_cloud, two_sets, tmp_path, verb):
    more = {"export": (tmp_path / "out", "--format", "coco"), "diff": (two_sets / "a",)}.get(verb, ())
    done = annotate_cloud(verb, two_sets, *more)
    assert_refused(done, "is a folder of label sets (2 in all); give one, e.g.", two_sets / "a")
    assert_refused(annotate_cloud(verb, tmp_path / "absent", *more), "absent does not exist; check its name")


@pytest.mark.parametrize("verb", ["fix", "export"])
def test_a_dataset_in_place_of_a_label_set_is_named(annotate_cloud, tmp_path, verb):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "dataset.json").write_text("{}")
    more = {"export": (tmp_path / "out", "--format", "cvat")}.get(verb, ())
    done = annotate_cloud(verb, tmp_path / "set", *more)
    assert_refused(
        done, "set is a dataset, not a label set; 'train' takes it, 'predict' writes a label set of it"
    )


def test_repair_of_a_folder(annotate_cloud, tmp_path, rig_session):
    assert_refused(annotate_cloud("repair", tmp_path), f"{tmp_path} is a folder; give a recorded session")
    shutil.copy(rig_session, tmp_path / "take.mcap")
    assert_refused(annotate_cloud("repair", tmp_path), "give one file, e.g.", tmp_path / "take.mcap")


@pytest.mark.parametrize(
    ("command", "continued"),
    [
        (("simulate", "s.mcap"), "the same command begins anew"),
        (("export", "a", "b", "--format", "coco"), "the same command begins anew"),
        (("synth", "bodies"), "the same command begins anew"),
        (("label", "s.mcap", "--out", "l"), "run the same command again to continue"),
        (("synth", "generate"), "run the same command again to continue"),
        (("predict", "s.mcap", "--overwrite"), "again, without --overwrite, to continue"),
    ],
)
def test_ctrl_c_names_the_continuation_of_the_verb(annotate_cloud, monkeypatch, command, continued):
    def app() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cli.main.app", app)
    done = annotate_cloud(*command)
    assert done.code == 130
    assert done.err.startswith("annotate-cloud: interrupted; ") and continued in done.err, done.err


def test_lost_images_of_a_stream_are_one_line():
    events = {
        "depth: 1 dropped": 494,
        "thermal flag closed": 14,
        "depth: 2 dropped": 236,
        "thermal: 61 dropped, 61 as writing was too slow": 1,
        "thermal: 15 dropped": 1,
        "color: 3 dropped": 1,
    }
    assert event_lines(events) == [
        "thermal flag closed (14 times)",
        "depth: 966 dropped in 730 gaps",
        "thermal: 76 dropped in 2 gaps, 61 as writing was too slow",
        "color: 3 dropped",
    ]
