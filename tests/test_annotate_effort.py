"""The simulated annotator: right frames cost one look, more errors more work, and no work harms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.effort import AGREEMENT, LOOK_S, STROKE_S, correct
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.store import LabelSet

law = settings(deadline=None, max_examples=30)

H, W = 120, 160
ROOMY = [(20 + 40 * (i // 4), 20 + 40 * (i % 4)) for i in range(12)]


def person() -> np.ndarray:
    """Torso on the left, hip on the right, a frame of background round them."""
    parts = np.zeros((H, W), np.uint8)
    parts[4:-4, 4 : W // 2] = 2
    parts[4:-4, W // 2 : -4] = 7
    return parts


def frame(parts: np.ndarray) -> FrameLabels:
    return FrameLabels("f", np.full(parts.shape, 1500, np.uint16), parts, subject="s")


def with_errors(n: int) -> np.ndarray:
    """The person with ``n`` patches called head, too far apart for one stroke, each over the tolerance."""
    parts = person()
    for v, u in ROOMY[:n]:
        parts[v - 8 : v + 8, u - 8 : u + 8] = 1
    return parts


def agreement(parts: np.ndarray, truth: np.ndarray) -> float:
    counted = (truth != UNDEFINED) & ((truth != BACKGROUND) | (parts != BACKGROUND))
    return float((parts == truth)[counted].mean()) if counted.any() else 1.0


def test_a_right_frame_costs_one_look(rig_session):
    truth = LabelSet.open(rig_session.with_suffix(".truth"))
    for true in [frame(person()), frame(np.zeros((H, W), np.uint8)), *truth]:
        done = correct(true, true)
        assert (done.strokes, done.seconds, done.agreement) == (0, LOOK_S, 1.0)
        np.testing.assert_array_equal(done.frame.parts, true.parts)


def test_twelve_frames_cost_the_more_the_more_errors_they_have():
    done = [correct(frame(with_errors(n)), frame(person())) for n in range(12)]
    seconds = [d.seconds for d in done]
    assert seconds == sorted(seconds)
    assert seconds[-1] > seconds[1] > seconds[0] == LOOK_S
    assert [d.strokes for d in done] == sorted(d.strokes for d in done)
    for d in done:
        assert d.seconds == pytest.approx(LOOK_S + d.strokes * STROKE_S)
        assert d.agreement >= AGREEMENT


def test_one_patch_is_one_stroke_and_is_mended():
    done = correct(frame(with_errors(1)), frame(person()), goal=1.0)
    assert done.strokes == 1
    np.testing.assert_array_equal(done.frame.parts, person())


def test_the_frame_says_what_was_done():
    automatic = frame(with_errors(2))
    done = correct(automatic, frame(person()))
    assert (done.frame.status, done.frame.frame_id, done.frame.subject) == ("corrected", "f", "s")
    assert done.frame.notes["strokes"] == done.strokes
    assert done.frame.notes["active_seconds"] == pytest.approx(done.seconds, abs=0.01)
    np.testing.assert_array_equal(automatic.parts, with_errors(2))


@law
@given(st.integers(0, 999), st.floats(0.5, 1))
def test_work_never_makes_it_worse_and_leaves_the_undefined_alone(seed, goal):
    rng = np.random.default_rng(seed)
    truth, start = person(), person()
    for parts, values in ((truth, (0, 2, 7, UNDEFINED)), (start, (0, 1, 2, 7, UNDEFINED))):
        for _ in range(4):
            v, u = rng.integers(0, H - 20), rng.integers(0, W - 20)
            parts[v : v + rng.integers(1, 20), u : u + rng.integers(1, 20)] = rng.choice(values)
    done = correct(frame(start), frame(truth), goal)
    assert done.agreement >= agreement(start, truth)
    assert done.strokes == 0 or agreement(start, truth) < goal
    changed = done.frame.parts != start
    assert set(np.unique(done.frame.parts[changed])) <= set(np.unique(truth))
    assert not (done.frame.parts[changed] == UNDEFINED).any()
