"""Converted label sets and datasets keep all but their parts; converting twice is converting once."""

import json

import numpy as np
import pytest
from conftest import assert_refused, tree

from annotate.correction.correction import Correction
from annotate.crop import SIZE, Crop
from annotate.labelset.convert import convert
from annotate.labelset.dataset import Dataset
from annotate.labelset.images import Probabilities
from annotate.labelset.label_set import LabelSet, validate
from annotate.labelset.scheme_note import scheme_note
from annotate.parts import PAPER
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme_file import load_scheme, scheme_to_toml
from sensors.errors import ExistsError, FormatError
from tests.helpers.correctable import FRAMES, correctable
from tests.helpers.label_sets import CAMERA
from tests.helpers.same_frame import assert_same_frame
from tests.helpers.schemes import WARD, frame_in
from tests.helpers.shards import write_dataset

SIX, HANDS = load_scheme("six"), load_scheme("hands-and-feet")


def nothing(_: int) -> None:
    pass


def made(path, scheme=WARD) -> LabelSet:
    info = {"source": "ward 3", "steps": {"label": {"x": 1}}, "cast": "judging"}
    labels = LabelSet.create(path, CAMERA, info | scheme_note(scheme))
    for seed in range(2):
        labels.write(frame_in(scheme, seed))
    return labels


def corrected(path):
    """Write a set of the paper with two strokes and a verdict, and return its path."""
    with Correction.open(correctable(path), "anna") as correction:
        editor = correction.edit(FRAMES[0])
        editor.paint(np.arange(40, 60), 4)
        editor.swap_left_right()
        editor.judge("accept")
    return path


@pytest.mark.parametrize("name", ["paper", "hands-and-feet", "six", "trunk-and-limbs"])
def test_all_but_the_parts_is_kept(tmp_path, annotate_cloud, name):
    labels, out, scheme = made(tmp_path / "ward"), tmp_path / "out", load_scheme(name)
    done = annotate_cloud("convert", labels.path, "--scheme", name, "--out", out, "--json")
    assert (done.code, done.result["from"], done.result["scheme"]) == (0, "ward", name)
    got, table = LabelSet.open(out), conversion_table(WARD, scheme)
    assert got.scheme == scheme and validate(got) == []
    assert {k: v for k, v in got.info.items() if k != "scheme"} == {
        k: v for k, v in labels.info.items() if k != "scheme"
    }
    for seed in range(2):
        before = frame_in(WARD, seed)
        after = got.read(before.frame_id)
        np.testing.assert_array_equal(after.parts, table[before.parts])
        assert (after.status, after.subject, after.notes) == (before.status, before.subject, before.notes)
        np.testing.assert_array_equal(after.confidence, before.confidence)
        np.testing.assert_array_equal(after.persons, before.persons)


def test_converting_twice_is_converting_once(tmp_path):
    labels = made(tmp_path / "ward")
    once = convert(labels, SIX, tmp_path / "once", nothing, overwrite=False)
    convert(once, SIX, tmp_path / "twice", nothing, overwrite=False)
    paper = convert(labels, PAPER, tmp_path / "paper", nothing, overwrite=False)
    convert(paper, SIX, tmp_path / "by way of paper", nothing, overwrite=False)
    assert tree(tmp_path / "once") == tree(tmp_path / "twice") == tree(tmp_path / "by way of paper")


def test_a_set_in_its_own_scheme_keeps_its_bytes(tmp_path):
    labels = made(tmp_path / "paper", PAPER)
    convert(labels, PAPER, tmp_path / "again", nothing, overwrite=False)
    assert tree(tmp_path / "paper") == tree(tmp_path / "again")


def test_a_split_is_refused_by_part_and_scheme(tmp_path, annotate_cloud):
    labels = made(tmp_path / "paper", PAPER)
    out = tmp_path / "out"
    done = annotate_cloud("convert", labels.path, "--scheme", "hands-and-feet", "--out", out)
    assert_refused(done, "part 'left_forearm' of scheme 'paper'", "of scheme 'hands-and-feet'")
    assert not out.exists()


def test_things_stay_things(tmp_path):
    file = tmp_path / "ward.toml"
    file.write_text(scheme_to_toml(WARD))
    labels = made(tmp_path / "ward")
    again = convert(labels, load_scheme(file), tmp_path / "again", nothing, overwrite=False)
    assert_same_frame(again.read("000000"), frame_in(WARD))


@pytest.mark.parametrize("target", [PAPER, SIX, WARD], ids=lambda scheme: scheme.name)
def test_a_dataset_converts_as_a_label_set_does(tmp_path, target):
    frames = [frame_in(WARD, seed) for seed in range(5)]
    dataset = write_dataset(tmp_path / "shards", frames, 2, info={"cast": "judging", "seed": 7})
    made = convert(dataset, target, tmp_path / "out", nothing, overwrite=False)
    assert isinstance(made, Dataset) and (made.scheme, len(made)) == (target, 5)
    assert (made.info["cast"], made.info["seed"]) == ("judging", 7)
    for before, after in zip(frames, made, strict=True):
        np.testing.assert_array_equal(after.parts, conversion_table(WARD, target)[before.parts])
        assert (after.subject, after.status, after.notes) == (before.subject, before.status, before.notes)
    convert(made, target, tmp_path / "twice", nothing, overwrite=False)
    assert tree(tmp_path / "out") == tree(tmp_path / "twice")
    if target == WARD:
        assert [made.shards, made.info] == [dataset.shards, dataset.info]


def test_an_interrupted_conversion_leaves_nothing(tmp_path):
    labels = made(tmp_path / "ward")

    def stop(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(labels, SIX, tmp_path / "out", stop, overwrite=False)
    assert {path.name for path in tmp_path.iterdir()} == {"ward"}


def test_other_results_are_replaced_only_on_demand(tmp_path):
    labels = made(tmp_path / "ward")
    convert(labels, SIX, tmp_path / "out", nothing, overwrite=False)
    with pytest.raises(ExistsError):
        convert(labels, PAPER, tmp_path / "out", nothing, overwrite=False)
    assert convert(labels, PAPER, tmp_path / "out", nothing, overwrite=True).scheme == PAPER
    with pytest.raises(ExistsError, match="holds the input"):
        convert(labels, PAPER, labels.path, nothing, overwrite=True)


def test_probabilities_of_joined_parts_are_summed(tmp_path):
    rng = np.random.default_rng(0)
    planes = rng.dirichlet(np.full(HANDS.n_classes, 0.2), (SIZE, SIZE)).astype(np.float32).transpose(2, 0, 1)
    probabilities = Probabilities(Crop(0, 0, SIZE), np.ascontiguousarray(planes))
    labels = LabelSet.create(tmp_path / "set", CAMERA, scheme_note(HANDS))
    frame = frame_in(HANDS)
    frame.notes.update(probabilities.note())
    labels.write(frame, probabilities)
    got = convert(labels, PAPER, tmp_path / "out", nothing, overwrite=False).probabilities(frame.frame_id)
    stored, table = labels.probabilities(frame.frame_id).planes, conversion_table(HANDS, PAPER)
    expected = [stored[table[: HANDS.n_classes] == i].sum(axis=0) for i in range(PAPER.n_classes)]
    np.testing.assert_allclose(got.planes, expected, atol=0.03)


def test_the_journal_is_left_out_and_its_result_kept(tmp_path, annotate_cloud):
    folder = corrected(tmp_path / "set")
    done = annotate_cloud("convert", folder, "--scheme", "six", "--out", tmp_path / "out")
    assert done.code == 0 and "journal.jsonl" in done.err
    before, after = LabelSet.open(folder), LabelSet.open(tmp_path / "out")
    table = conversion_table(PAPER, SIX)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(other.parts, table[one.parts])
        assert other.status == one.status
    assert not (tmp_path / "out" / "journal.jsonl").exists() and validate(after) == []


def test_labels_behind_their_journal_are_refused(tmp_path):
    folder = corrected(tmp_path / "set")
    frame_id = LabelSet.open(folder).frame_ids[0]
    file = folder / "frames" / f"{frame_id}.json"
    content = json.loads(file.read_text())
    content["notes"]["journal"] -= 1
    file.write_text(json.dumps(content))
    with pytest.raises(FormatError, match="open the set once with fix"):
        convert(LabelSet.open(folder), SIX, tmp_path / "out", nothing, overwrite=False)


def test_info_and_validate_name_the_scheme(tmp_path, annotate_cloud):
    labels = made(tmp_path / "ward")
    shown = annotate_cloud("info", labels.path, "--json")
    assert shown.result["scheme"] == "ward" and "wheelchair" in shown.result["pixels"]
    dataset = write_dataset(tmp_path / "shards", [frame_in(WARD)])
    assert annotate_cloud("info", dataset.path, "--json").result["scheme"] == "ward"
    for path in (labels.path, dataset.path):
        assert annotate_cloud("validate", path).code == 0
    manifest = dataset.path / "dataset.json"
    content = json.loads(manifest.read_text())
    del content["scheme"]
    manifest.write_text(json.dumps(content))
    assert (
        "unknown in scheme 'paper'"
        in annotate_cloud("validate", dataset.path, "--json").result["problems"][0]
    )
