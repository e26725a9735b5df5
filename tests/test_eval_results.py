"""Results on disk: written, read back, damaged, of older versions."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from annotate.labelset.label_set import LabelSet
from eval.compare import results
from eval.compare.compare import Comparison, compare_sets
from eval.compare.results import Result, load_result, save_result
from sensors.errors import CloudError, ExistsError, FormatError
from sensors.files.npz import array_sizes
from tests.test_eval_compare import CAMERA, guess_frame, label_set, same_counts, truth_frame


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("sets")
    guesses = label_set(folder / "guess", [guess_frame(i) for i in range(6)])
    return compare_sets(guesses, label_set(folder / "truth", [truth_frame(i) for i in range(6)]))


def with_joints(comparison: Comparison) -> Comparison:
    joints = np.full((6, 15), 25.0)
    joints[0, 0] = np.nan
    joints[1, 1] = np.inf
    seen = np.arange(joints.size).reshape(joints.shape).astype(np.uint8) % 3
    return replace(comparison, joints_mm=joints, joints_seen=seen)


@pytest.mark.parametrize("joints", [True, False])
def test_a_result_comes_back_as_it_was(compared: Comparison, tmp_path: Path, joints: bool) -> None:
    path = tmp_path / "result.npz"
    result = Result("Network", with_joints(compared) if joints else compared, {"command": "<b>"})
    save_result(path, result)
    loaded = load_result(path)
    assert loaded.title == "Network" and loaded.facts == {"command": "<b>"}
    a, b = loaded.comparison, result.comparison
    assert same_counts(a, b) and a.to_evaluation_json() == b.to_evaluation_json()
    assert (a.subjects, a.traits, a.digests, a.hashes) == (b.subjects, b.traits, b.digests, b.hashes)
    if joints:
        np.testing.assert_array_equal(a.joints_mm, b.joints_mm)
        np.testing.assert_array_equal(a.joints_seen, b.joints_seen)
    with pytest.raises(ExistsError):
        save_result(path, loaded)
    save_result(tmp_path / "again", loaded)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_a_result_of_people_with_half_a_letter_comes_back(tmp_path: Path) -> None:
    truth = LabelSet.create(tmp_path / "t", CAMERA, {})
    notes = {"activity": "\ud800", "hard": ["\udfff"]}
    truth.write(replace(truth_frame(0), subject="anna\ud800", notes=notes))
    save_result(tmp_path / "r.npz", Result("Network", compare_sets(truth, truth, workers=1)))
    back = load_result(tmp_path / "r.npz").comparison
    assert back.subjects == ("anna?",) and back.traits[0].hard == ("?",)


def set_in(value: object, *keys: object) -> None:
    """set_in(v, "a", 0, new): v["a"][0] = new."""
    *way, last, new = keys
    for key in way:
        value = value[key]
    value[last] = new


def spoilt(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], None]:
    return lambda v: v.update({name: change(v[name])})


DAMAGES = {
    "no counts": lambda v: v.pop("counts"),
    "a frame too many": spoilt("counts", lambda a: np.concatenate([a, a[:1]])),
    "negative counts": spoilt("counts", lambda a: -a),
    "a negative distance": spoilt("distance_m", lambda a: -a),
    "a negative error": spoilt("joints_mm", lambda a: a - 100),
    "pickled joints": spoilt("joints_mm", lambda a: a.astype(object)),
    "a visibility of another kind": spoilt("joints_seen", lambda a: a + 1),
    "joints without a visibility": lambda v: v.pop("joints_seen"),
}
IN_TEXTS = {
    "another schema": lambda v: v.update(schema=1),
    "no frame": lambda v: v.update(frame_ids=[]),
    "an id twice": lambda v: set_in(v, "frame_ids", 1, v["frame_ids"][0]),
    "a subject too few": lambda v: v["subjects"].pop(),
    "a strange status": lambda v: set_in(v, "traits", "status", 0, "perfect"),
    "a view too few": lambda v: v["traits"]["view"].pop(),
    "digests missing": lambda v: v["digests"].pop("truth"),
    "half a letter": lambda v: set_in(v, "digests", "depth", 0, "\ud800"),
    "facts are a list": lambda v: v.update(facts=[1]),
    "frames left over": lambda v: v.update(extra_frames=-1),
}


@pytest.mark.parametrize("damage", [*DAMAGES, *IN_TEXTS])
def test_a_damaged_result_is_refused_in_one_line(compared: Comparison, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "result.npz"
    save_result(path, Result("Network", with_joints(compared)))
    arrays = dict(np.load(path))
    if damage in DAMAGES:
        DAMAGES[damage](arrays)
    else:
        texts = json.loads(arrays["texts"].tobytes())
        IN_TEXTS[damage](texts)
        arrays["texts"] = np.frombuffer(json.dumps(texts).encode(), np.uint8)
    np.savez(path, **arrays)
    with pytest.raises(FormatError, match=r"result\.npz.*evaluate again") as caught:
        load_result(path)
    assert len(str(caught.value)) < 500 and "\n" not in str(caught.value)


def test_a_result_is_read_and_written_up_to_its_bound(
    compared: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_result(tmp_path / "r.npz", Result("Network", compared))
    size = sum(array_sizes(tmp_path / "r.npz", "").values())
    monkeypatch.setattr(results, "MAX_BYTES", size)
    load_result(tmp_path / "r.npz")
    save_result(tmp_path / "again.npz", Result("Network", compared))
    monkeypatch.setattr(results, "MAX_BYTES", size - 1000)
    with pytest.raises(FormatError, match=r"unpacks to .*evaluate again"):
        load_result(tmp_path / "r.npz")
    with pytest.raises(CloudError, match=r"a result of 6 frames has .*fewer frames"):
        save_result(tmp_path / "none.npz", Result("Network", compared))
    assert not (tmp_path / "none.npz").exists()


def test_no_result_at_all(tmp_path: Path) -> None:
    """An older version's, lines of JSON, among them."""
    for name, text in {"list": "[]", "older": '{"schema":4,"title":"N"}\n'}.items():
        (tmp_path / name).write_text(text)
    deep = {"texts": np.frombuffer(b"[" * 100_000, np.uint8)}
    np.savez(tmp_path / "deep.npz", **deep)
    for path in (*sorted(tmp_path.iterdir()), tmp_path / "missing", tmp_path):
        with pytest.raises(FormatError, match=rf"{path.name}.*evaluate again"):
            load_result(path)
