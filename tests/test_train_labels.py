"""Training the labelling engine: reproducible, resumable, and what it writes is what labels are made by."""

import json
import shutil
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.engine import Engine, load_weights, shipped_weights
from annotate.label_source import label_source
from annotate.suit.palette import DEFAULT_SUIT
from eval.training.engine_data import Recording
from eval.training.engine_odds import logistic
from eval.training.fit_engine import train_labels
from sensors.errors import CloudError, ExistsError, FormatError
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path


@contextmanager
def silent(what, total):
    yield lambda n: None


def recordings(session: Path) -> list[Recording]:
    return [Recording.open(session, truth_path(session), suit_path(session)) for _ in range(2)]


def same(a, b) -> bool:
    return all(np.array_equal(a.arrays()[name], b.arrays()[name]) for name in b.arrays())


@pytest.fixture(scope="module")
def trained(rig_session, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("trained") / "w"
    train_labels(recordings(rig_session), out, 0, silent)
    return out


def test_labels_are_made_by_the_weights_written(trained, rig_session, rig_labels, tmp_path):
    weights = load_weights(trained / "weights.npz")
    assert not same(weights, shipped_weights())
    run = label_source(
        Session(rig_session), DEFAULT_SUIT, tmp_path / "l", lambda n: None, engine=Engine(weights=weights)
    )
    assert any((a.confidence != b.confidence).any() for a, b in zip(run.labels, rig_labels, strict=True))
    manifest = json.loads((tmp_path / "l/labelset.json").read_text())
    assert manifest["steps"]["label"]["weights_sha256"] == weights.sha256()
    with pytest.raises(ExistsError):  # a run by other weights does not go on there
        label_source(Session(rig_session), DEFAULT_SUIT, tmp_path / "l", lambda n: None)


def test_a_broken_run_goes_on_to_the_same_weights_and_a_whole_one_is_kept(
    trained, rig_session, tmp_path, annotate_cloud
):
    out = tmp_path / "w"
    shutil.copytree(trained, out)
    verb = ("train-labels", rig_session, rig_session, "--out", out, "--json")
    assert "another training" in annotate_cloud(*verb).err
    (out / "weights.npz").unlink()
    (out / "rows/1.npz").unlink()
    assert "another training" in annotate_cloud(*verb, "--seed", 1).err
    done = annotate_cloud(*verb).result
    assert done["sha256"] == load_weights(trained / "weights.npz").sha256()
    assert done["frames"] == done["frames_held_out"] == 3
    assert min(done["mean_recall"], done["person_iou"]) > 0.9


@pytest.mark.parametrize(
    ("more", "remedy"), [((), "give two or more"), (("--truth", "x"), "give one --truth")]
)
def test_a_mistake_is_one_line(rig_session, tmp_path, annotate_cloud, more, remedy):
    sessions = [rig_session] * (1 + len(more) // 2)
    done = annotate_cloud("train-labels", *sessions, *more, "--out", tmp_path / "w")
    assert done.code == 1 and remedy in done.err and not (tmp_path / "w").exists()


def test_automatic_labels_are_not_trained_on(rig_session, rig_labels):
    with pytest.raises(CloudError, match="automatic labels only"):
        Recording.open(rig_session, rig_labels.path, suit_path(rig_session))


def test_weights_are_read_as_written_or_refused(tmp_path):
    path, weights = tmp_path / "w.npz", shipped_weights()
    deeper = np.concatenate([weights.network["rounds"]] * 2)
    honest = replace(weights, network=weights.network | {"rounds": deeper})
    for kept in (weights, honest):
        kept.save(path)
        assert same(load_weights(path), kept)
    for spoilt in (
        replace(weights, confidence=weights.confidence[1:]),
        replace(weights, touch=weights.touch * np.nan),
        replace(weights, network=weights.network | {"enter": weights.network["enter"].astype(np.float64)}),
    ):
        spoilt.save(path)
        with pytest.raises(FormatError, match="train-labels"):
            load_weights(path)
    path.write_bytes(b"no archive")
    with pytest.raises(FormatError):
        load_weights(path)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_logistic_curve_is_found_again(seed):
    rng = np.random.default_rng(seed)
    columns, weights = rng.standard_normal((4000, 3)) * (1, 10, 0.1), rng.normal(0, (1, 0.1, 10, 1))
    share = 1 / (1 + np.exp(-(columns @ weights[:3] + weights[3])))
    found = logistic(columns, share, np.full(len(share), 100.0))
    np.testing.assert_allclose(found, weights, rtol=0.01, atol=0.01)
