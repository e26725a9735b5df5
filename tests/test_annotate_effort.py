"""The simulated annotator: right frames cost one look, errors cost work by the model, no work harms."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.correction.correction import Correction
from annotate.correction.edit import ActiveTime, Editor
from annotate.correction.select import edit_supervoxels
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import AGREEMENT, WHO, Annotator, correct_set
from annotate.effort.hand import CAREFUL, QUICK, along, length_px, loop, outline
from annotate.effort.keystrokes import CLICK_S, KEY_S, MENTAL_S, POINT_S, STEER_S, Tools, gesture_s, moves_s
from annotate.effort.repairs import Move, Repair, in_one_go
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import KEY, Gesture
from annotate.parts import BACKGROUND, UNDEFINED, swap_left_right
from sensors.rig.camera import Intrinsics

law = settings(deadline=None, max_examples=25)

H, W = 120, 160
CAMERA = Intrinsics(W, H, 150.0, 150.0, 79.5, 59.5)
ROOMY = [(14 + 34 * (i // 4), 16 + 36 * (i % 4)) for i in range(12)]


EVERYWHERE = np.ones((H, W), np.bool_)


def person() -> np.ndarray:
    """Arms left and right of a torso over a hip, background round them."""
    parts = np.zeros((H, W), np.uint8)
    parts[4:60, 4:-4], parts[60:-4, 4:-4] = 2, 7
    parts[10:110, 8:40], parts[10:110, -40:-8] = 4, 3
    return parts


def frame(parts: np.ndarray, frame_id: str = "f") -> FrameLabels:
    return FrameLabels(frame_id, np.full(parts.shape, 1500, np.uint16), parts, subject="s")


def with_errors(n: int) -> np.ndarray:
    """The person with ``n`` patches called head, too far apart for one stroke, each over the tolerance."""
    parts = person()
    for v, u in ROOMY[:n]:
        parts[v - 8 : v + 8, u - 8 : u + 8] = 1
    return parts


def worked(start: np.ndarray, truth: np.ndarray, goal=AGREEMENT, tolerance_px=0, at_once=1):
    """The editor and the strokes after the annotator has worked on a frame."""
    strokes, annotator = [], Annotator(goal, tolerance_px, at_once)
    editor = Editor(frame(start), WHO, strokes.append, ActiveTime(annotator.clock))
    pieces = edit_supervoxels(frame(start), CAMERA)
    annotator.work(editor, truth, pieces)
    return editor, strokes


def seconds(strokes) -> float:
    return sum(stroke.active_seconds for stroke in strokes)


def scribbled(seed: int, values: tuple[int, ...]) -> np.ndarray:
    rng, parts = np.random.default_rng(seed), person()
    for _ in range(4):
        v, u = rng.integers(0, H - 20), rng.integers(0, W - 20)
        parts[v : v + rng.integers(1, 25), u : u + rng.integers(1, 25)] = rng.choice(values)
    return parts


@pytest.mark.parametrize(
    ("start", "operations", "spent_s"),
    [
        (np.zeros((H, W), np.uint8), ["accept"], MENTAL_S + KEY_S),
        (person(), ["accept"], MENTAL_S + KEY_S),
        (swap_left_right(person()), ["swap_left_right", "accept"], 2 * MENTAL_S + POINT_S + 2 * KEY_S),
    ],
)
def test_a_right_frame_costs_one_look_and_swapped_arms_one_key(start, operations, spent_s):
    editor, strokes = worked(start, person() if start.any() else start)
    assert [stroke.operation for stroke in strokes] == operations
    assert seconds(strokes) == pytest.approx(spent_s, abs=1e-3)
    np.testing.assert_array_equal(editor.parts, person() if start.any() else start)


def test_errors_cost_work_until_the_goal_is_reached():
    spent = []
    for n in (0, 1, 4, 9):
        editor, strokes = worked(with_errors(n), person())
        spent.append(seconds(strokes))
        assert Agreement(person(), EVERYWHERE).of(editor.parts) >= AGREEMENT
    assert spent == sorted(set(spent))


def test_repairs_of_one_part_are_made_with_one_look():
    left, right = np.array([3, 4]), np.array([4, 9])
    one = Repair((Move("paint", "supervoxel", 2, pixel=3),), left, np.array([2, 2], np.uint8))
    other = Repair((Move("paint", "supervoxel", 2, pixel=9),), right, np.array([2, 2], np.uint8))
    both = in_one_go([one, other])
    np.testing.assert_array_equal(both.pixels, [3, 4, 9])
    np.testing.assert_array_equal(both.parts, [2, 2, 2])
    tools = Tools(2, "piece")
    apart = moves_s(one.moves, tools) + moves_s(other.moves, tools)
    assert moves_s(both.moves, tools) == pytest.approx(apart - MENTAL_S)


def test_one_look_for_many_patches_is_the_cheaper_reading():
    readings, start = [], person()
    for u in (44, 72, 100):
        start[4:20, u : u + 14] = BACKGROUND
    for at_once in (1, 4):
        editor, strokes = worked(start, person(), at_once=at_once)
        assert Agreement(person(), EVERYWHERE).of(editor.parts) >= AGREEMENT
        readings.append(seconds(strokes))
    assert readings[0] > readings[1] + MENTAL_S / 2


def test_a_missing_foot_is_drawn_where_no_piece_fits():
    truth = person()
    truth[90:116, 60:100] = 10
    editor, strokes = worked(person(), truth, goal=0.995)
    assert Agreement(truth, EVERYWHERE).of(editor.parts) >= 0.995
    assert {stroke.how.kind for stroke in strokes} & {"lasso", "brush"}


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 999), st.floats(0.5, 1), st.sampled_from([0, 2]))
def test_work_never_makes_it_worse_and_its_journal_replays(seed, goal, tolerance_px):
    truth = scribbled(seed, (0, 2, 7, UNDEFINED))
    start = scribbled(seed + 1000, (0, 1, 2, 7, UNDEFINED))
    editor, strokes = worked(start, truth, goal, tolerance_px)
    agreement = Agreement(truth, EVERYWHERE, tolerance_px)
    assert agreement.of(editor.parts) >= agreement.of(start)
    assert len(strokes) == 1 or agreement.of(start) < goal
    again = start.copy()
    for stroke in strokes:
        stroke.apply_to(again)
        assert stroke.who == WHO
    np.testing.assert_array_equal(again, editor.parts)
    same, strokes_again = worked(start, truth, goal, tolerance_px)
    np.testing.assert_array_equal(same.parts, editor.parts)
    assert seconds(strokes_again) == seconds(strokes)


def test_a_repair_that_fails_is_undone_and_leaves_nothing(monkeypatch):
    truth = person()
    truth[90:116, 60:100] = 10
    monkeypatch.setattr("annotate.effort.annotator.drawn", lambda corners, hand, rng: corners - 45.0)
    editor, strokes = worked(person(), truth, goal=0.995)
    undone = [stroke for stroke in strokes if stroke.operation == "undo"]
    assert undone and all(stroke.active_seconds >= MENTAL_S + 2 * KEY_S - 1e-3 for stroke in undone)
    again = person()
    for stroke, following in pairwise(strokes):
        if following.operation == "undo":
            np.testing.assert_array_equal(stroke.pixels, following.pixels)
            np.testing.assert_array_equal(stroke.old, following.new)
        elif stroke.operation == "paint":
            stroke.apply_to(again)
    np.testing.assert_array_equal(again, editor.parts)


def test_a_set_is_corrected_frame_by_frame(tmp_path):
    truth, labels = (LabelSet.create(tmp_path / name, CAMERA, {}) for name in ("truth", "labels"))
    for i, errors in enumerate((6, 0)):
        truth.write(frame(person(), f"{i}"))
        labels.write(frame(with_errors(errors), f"{i}"))
    annotator = Annotator()
    with Correction.open(labels.path, WHO, clock=annotator.clock) as correction:
        efforts = list(correct_set(correction, truth, annotator, lambda frame_id: None))
    assert all(effort.agreement >= AGREEMENT for effort in efforts)
    assert efforts[0].seconds > 10 and efforts[0].repairs > 0
    assert efforts[1].seconds == pytest.approx(MENTAL_S + KEY_S, abs=1e-3) and efforts[1].repairs == 0
    spent = [labels.notes(frame_id)["active_seconds"] for frame_id in labels.frame_ids]
    np.testing.assert_allclose(spent, [effort.seconds for effort in efforts], atol=0.01)


def near(mask: np.ndarray, v: int, u: int, reach_px: int) -> bool:
    return bool(mask[max(v - reach_px, 0) : v + reach_px + 1, max(u - reach_px, 0) : u + reach_px + 1].any())


@law
@given(st.integers(0, 999), st.integers(0, 3))
def test_agreement_is_what_a_plain_loop_says_and_mutual(seed, tolerance_px):
    rng = np.random.default_rng(seed)
    truth, parts = rng.choice(np.array([0, 0, 1, 2, UNDEFINED], np.uint8), (2, 9, 11))
    valid = rng.random((9, 11)) < 0.7
    right = counted = 0
    for v, u in np.ndindex(truth.shape):
        t, p = truth[v, u], parts[v, u]
        if t == UNDEFINED or (t == BACKGROUND and p in (BACKGROUND, UNDEFINED)):
            continue
        counted += 1
        both = (near(valid & same, v, u, tolerance_px) for same in (truth == p, parts == t))
        right += p != UNDEFINED and bool(t == p or all(both))
    agreement = Agreement(truth, valid, tolerance_px)
    assert agreement.of(parts) == pytest.approx(right / counted if counted else 1.0)
    a, b = (np.where(one == UNDEFINED, np.uint8(BACKGROUND), one) for one in (truth, parts))
    wrong = Agreement(a, valid, tolerance_px).wrong(b)
    np.testing.assert_array_equal(wrong, Agreement(b, valid, tolerance_px).wrong(a))
    assert not (wrong & (a == b)).any()
    np.testing.assert_array_equal(Agreement(a, valid).wrong(b), a != b)


@pytest.mark.parametrize("was", [BACKGROUND, 2])
def test_a_thin_piece_that_is_missing_is_wrong_and_a_border_beside_is_not(was):
    truth = np.full((40, 40), was, np.uint8)
    truth[10:30, 20:23] = 6
    missing, shifted = np.full_like(truth, was), np.roll(truth, 2, axis=1)
    agreement = Agreement(truth, np.ones(truth.shape, np.bool_), 2)
    np.testing.assert_array_equal(agreement.wrong(missing), truth == 6)
    assert agreement.of(shifted) == 1
    assert agreement.of(np.roll(truth, 6, axis=1)) < 1


@law
@given(st.integers(0, 999), st.integers(0, 3))
def test_gains_are_the_difference_that_a_change_makes(seed, tolerance_px):
    rng = np.random.default_rng(seed)
    truth, before = rng.choice(np.array([0, 1, 2, UNDEFINED], np.uint8), (2, 19, 21))
    agreement = Agreement(truth, rng.random(truth.shape) < 0.7, tolerance_px)
    pixels = np.unique(rng.integers(0, truth.size, rng.integers(0, 9)))
    after, parts = before.copy(), rng.integers(0, 3, len(pixels)).astype(np.uint8)
    after.ravel()[pixels] = parts
    expected = agreement.wrong(before).astype(int) - agreement.wrong(after)
    np.testing.assert_array_equal(agreement.gains(before, pixels, parts), expected)


@pytest.mark.parametrize(
    ("how", "sd_px", "spent_s"),
    [
        (KEY, 1.0, KEY_S),
        (Gesture("key", points=1, keys=1), 1.0, POINT_S + KEY_S),
        (Gesture("supervoxel", clicks=1), 1.0, POINT_S + CLICK_S),
        (Gesture("grow", clicks=3, points=1), 1.0, POINT_S + 3 * CLICK_S),
        (Gesture("rectangle"), 1.0, 2 * POINT_S),
        (Gesture("lasso", path_px=413.3), 1.0, POINT_S + CLICK_S + 100 * STEER_S),
        (Gesture("brush", path_px=413.3), 2.0, POINT_S + CLICK_S + 50 * STEER_S),
    ],
)
def test_gestures_cost_the_seconds_of_the_model(how, sd_px, spent_s):
    assert gesture_s(how, sd_px) == pytest.approx(spent_s)


def test_the_hand_goes_round_a_patch_and_along_it():
    patch = np.zeros((H, W), np.bool_)
    patch[40:60, 50:90] = True
    tight, wide = outline(patch, np.zeros_like(patch), CAREFUL), loop(patch, QUICK)
    assert length_px(tight, closed=True) == pytest.approx(2 * (19 + 39), abs=6)
    assert length_px(wide, closed=True) > length_px(tight, closed=True)
    path = along(patch, 6.0)
    assert length_px(path, closed=False) == pytest.approx(40, abs=12)
    np.testing.assert_allclose(path[:, 1], 49.5, atol=1)
