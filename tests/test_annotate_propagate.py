"""Propagation: corrections travel with the part they were made on, and nothing else changes."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from annotate.correction.follow import followed
from annotate.correction.propagate import CorrectedFrame, propagate
from annotate.correction.rigid import LabelledPoints, part_motions
from annotate.frame_labels import FrameLabels
from annotate.parts import UNDEFINED
from tests.helpers.balls import CAMERA, seen

law = settings(deadline=None, max_examples=6)


def face_mistaken(frame: FrameLabels) -> FrameLabels:
    """The lower half of the head called left leg: a mistake that moves with it."""
    rows = np.nonzero(frame.parts == 1)[0]
    below = np.arange(CAMERA.height)[:, None] > np.median(rows)
    return replace(frame, parts=np.where((frame.parts == 1) & below, np.uint8(8), frame.parts))


def wrong(frame: FrameLabels, parts) -> int:
    return int((parts != frame.parts).sum())


shifts = st.tuples(*(st.floats(-0.12, 0.12) for _ in range(2)), st.floats(-0.1, 0.1))


@law
@given(shifts)
def test_a_correction_follows_the_movement_and_nothing_else_changes(shift):
    before, after = seen(), seen(shift, "b")
    mistaken = face_mistaken(after)
    done = propagate([CorrectedFrame(face_mistaken(before), before)], mistaken, CAMERA)
    assert wrong(after, done) <= 0.1 * wrong(after, mistaken.parts)
    assert (mistaken.parts[done != mistaken.parts] != 8).sum() <= 5


@law
@given(shifts)
def test_what_is_right_stays_but_for_a_stray_pixel(shift):
    before, after = seen(), seen(shift, "b")
    for corrected, automatic in ((before, before), (before, face_mistaken(before))):
        assert wrong(after, propagate([CorrectedFrame(automatic, corrected)], after, CAMERA)) <= 5


def test_the_parts_of_the_frame_before_follow_the_movement():
    before, after = seen(), seen((0.1, 0.02, -0.05), "b")
    mistaken = face_mistaken(after)
    parts = followed(CorrectedFrame(face_mistaken(before), before), mistaken, CAMERA)
    named = parts != UNDEFINED
    body = after.parts != 0
    assert named[body].mean() > 0.9 and not named[~body].any()
    assert (parts[named] != after.parts[named]).mean() < 0.02


def test_what_stands_still_is_taken_away_where_it_stood():
    before, after = seen(), seen((0.08, 0, 0), "b")
    stain = np.zeros(CAMERA.shape, np.bool_)
    stain[100:130, 100:115] = True

    def stained(frame):
        return replace(frame, parts=np.where(stain & (frame.parts == 0), np.uint8(10), frame.parts))

    done = propagate([CorrectedFrame(stained(before), before)], stained(after), CAMERA)
    assert wrong(after, stained(after).parts) > 100
    assert wrong(after, done) <= 0.1 * wrong(after, stained(after).parts)


def test_a_limb_named_otherwise_in_every_frame_gets_its_name():
    before, after = seen(), seen((0.03, 0.02, 0), "b")

    def misread(frame, name):
        return replace(frame, parts=np.where(frame.parts == 4, np.uint8(name), frame.parts))

    done = propagate([CorrectedFrame(misread(before, 8), before)], misread(after, 10), CAMERA)
    assert wrong(after, done) <= 0.1 * wrong(after, misread(after, 10).parts)


def test_an_undefined_frame_takes_the_labels_over():
    before, after = seen(), seen((0.03, 0.02, 0), "b")
    unknown = replace(after, parts=np.where(after.parts > 0, np.uint8(UNDEFINED), after.parts))
    done = propagate([CorrectedFrame(face_mistaken(before), before)], unknown, CAMERA)
    on_body = after.parts > 0
    assert (done == after.parts)[on_body].mean() > 0.9
    np.testing.assert_array_equal(done[~on_body], 0)


def test_a_mistake_that_comes_back_is_put_right_as_it_was_then():
    old, after = seen((0.02, 0, 0)), seen((0.03, 0.01, 0), "z")
    right = [CorrectedFrame(frame, frame) for frame in (seen((0.02, 0, 0), f"{i}") for i in range(5))]
    done = propagate([*right, CorrectedFrame(face_mistaken(old), old)], face_mistaken(after), CAMERA)
    assert wrong(after, done) <= 0.1 * wrong(after, face_mistaken(after).parts)


def test_a_hand_that_was_missed_is_found_where_it_went():
    before, after = seen(), seen((0.03, 0.02, 0), "b")
    below = np.arange(CAMERA.height)[:, None] > 85
    missed = replace(after, parts=np.where((after.parts == 4) & below, np.uint8(0), after.parts))
    done = propagate([CorrectedFrame(face_mistaken(before), before)], missed, CAMERA)
    assert wrong(after, missed.parts) > 100
    assert wrong(after, done) <= 0.2 * wrong(after, missed.parts)


def test_what_the_labels_doubt_the_corrections_decide():
    before, after = seen(), seen((0.03, 0.02, 0), "b")
    near = np.hypot(*(np.indices(CAMERA.shape) - [[[80]], [[100]]])) < 6
    stained = np.where(near, np.uint8(3), after.parts)
    for sure, corrected in ((1.0, False), (0.1, True)):
        confidence = np.full(CAMERA.shape, sure, np.float32)
        unsure = replace(after, parts=stained, confidence=confidence)
        done = propagate([CorrectedFrame(face_mistaken(before), before)], unsure, CAMERA)
        assert (wrong(after, done) < 0.3 * wrong(after, stained)) == corrected


@law
@given(st.integers(0, 999))
def test_motions_of_parts_are_found_again(seed):
    rng = np.random.default_rng(seed)
    points, parts, moved = [], [], []
    for part, middle in ((2, (0, 0, 2)), (4, (-0.3, 0, 1.9)), (6, (-0.3, 0.3, 1.8))):
        own = rng.normal(0, (0.05, 0.1, 0.03), (400, 3))
        turn = Rotation.from_rotvec(rng.normal(0, 0.06, 3))
        shift = rng.normal(0, 0.02, 3)
        points.append(own + middle)
        moved.append(turn.apply(own) + middle + shift)
        parts.append(np.full(400, part, np.uint8))
    source = LabelledPoints(np.concatenate(points), np.concatenate(parts))
    motions = part_motions(source, source.automatic, LabelledPoints(np.concatenate(moved), source.automatic))
    for part, own, goal in zip((2, 4, 6), points, moved, strict=True):
        assert np.linalg.norm(motions[part].apply(own) - goal, axis=1).mean() < 0.01
    np.testing.assert_array_equal(motions[0].translation_m, 0)
    assert motions[5] is motions[3]
