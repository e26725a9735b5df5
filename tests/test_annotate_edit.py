"""The correction core: all work can be undone and replayed to the bit, and no lock is ever broken."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from annotate import cleanup
from annotate.correction.edit import IDLE_S, ActiveTime, Editor
from annotate.correction.history import History
from annotate.correction.replay import after
from annotate.frame_labels import FrameLabels
from annotate.labelset.stroke import Gesture, Stroke, difference, from_line, to_line
from annotate.parts import BACKGROUND, LEFT_RIGHT, N_CLASSES, PAPER, PART_ID, UNDEFINED, swap_left_right
from annotate.scheme.limbs import limbs_of
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE

law = settings(deadline=None, max_examples=60)

H, W = 9, 13
PART_IDS = [*range(N_CLASSES), UNDEFINED]
ids = st.sampled_from(PART_IDS)
maps = arrays(np.uint8, (H, W), elements=ids)
masks = arrays(np.bool_, (H, W))
depths = arrays(np.uint16, (H, W), elements=st.sampled_from([0, 1000, 1005, 1010, 2000]))
ARMS, LEGS = (limb.pairs for limb in limbs_of(PAPER))
pairs = st.sampled_from([LEFT_RIGHT, ARMS, LEGS])

operations = st.one_of(
    st.tuples(st.just("paint"), masks, ids),
    st.tuples(st.just("replace"), st.sampled_from(["fill_holes", "remove_islands"]), maps),
    st.tuples(st.just("swap_left_right"), pairs),
    st.tuples(st.just("merge"), ids, ids),
    st.tuples(st.just("to_neighbour"), masks),
    st.tuples(st.just("copy_previous"), maps),
    st.tuples(st.sampled_from(["undo", "redo", "leave"])),
    st.tuples(st.just("judge"), st.sampled_from(["accept", "agree", "reject"]), st.just("blurred")),
)
works = st.lists(operations, max_size=12)


@st.composite
def frames(draw) -> FrameLabels:
    depth, parts = draw(depths), draw(maps)
    return FrameLabels("f", depth, np.where(depth > 0, parts, BACKGROUND).astype(np.uint8))


def work(editor: Editor, operations) -> list[Stroke]:
    """Do one operation after the other; the strokes that had an effect."""
    done = [getattr(editor, name)(*arguments) for name, *arguments in operations]
    return [stroke for stroke in done if stroke is not None]


def blank(parts: np.ndarray, depth_mm: int = 1500) -> FrameLabels:
    return FrameLabels("f", np.full(parts.shape, depth_mm, np.uint16), parts)


# Laws over random work


@given(frame=frames(), operations=works)
@law
def test_undoing_everything_gives_the_original_and_redoing_it_the_result(frame, operations):
    editor, steps = Editor(frame, "ann"), 0
    work(editor, operations)
    result, redone = editor.parts.copy(), len(editor.history.undone)
    while editor.undo():
        steps += 1
    np.testing.assert_array_equal(editor.parts, frame.parts)
    assert all(editor.redo() for _ in range(steps)) and len(editor.history.undone) == redone
    np.testing.assert_array_equal(editor.parts, result)


@given(frame=frames(), operations=works)
@law
def test_recorded_work_replays_exactly_through_its_lines(frame, operations):
    strokes = []
    editor = Editor(frame, "ann", strokes.append)
    editor.locks = {2}
    assert work(editor, operations) == strokes
    read = [from_line(to_line(stroke)) for stroke in strokes]
    np.testing.assert_array_equal(after(frame, read, exact=True).parts, editor.parts)
    for cut in range(len(read)):
        # Saved labels may already hold the applied strokes.
        half = after(frame, read[: cut + 1])
        np.testing.assert_array_equal(after(half, read[cut // 2 :]).parts, editor.parts)
    history = History.of(read)
    for ours, theirs in ((history.done, editor.history.done), (history.undone, editor.history.undone)):
        assert [to_line(stroke) for stroke in ours] == [to_line(stroke) for stroke in theirs]


@given(frame=frames(), operations=works, locks=st.sets(ids, max_size=4))
@law
def test_locked_parts_and_pixels_without_depth_stay(frame, operations, locks):
    editor = Editor(frame, "ann")
    editor.locks = locks
    work(editor, operations)
    for part in locks:
        np.testing.assert_array_equal(editor.parts == part, frame.parts == part)
    assert not editor.parts[frame.depth_mm == 0].any()


@given(frame=frames(), only=ids, mask=masks, part=ids)
@law
def test_only_one_part_is_replaced_when_asked(frame, only, mask, part):
    editor = Editor(frame, "ann")
    editor.only = only
    editor.paint(mask, part)
    editor.swap_left_right()
    editor.copy_previous(swap_left_right(frame.parts))
    assert set(np.unique(frame.parts[editor.parts != frame.parts])) <= {only}


@given(old=maps, new=maps, mask=masks)
@law
def test_runs_are_the_difference_and_no_more(old, new, mask):
    pixels = np.flatnonzero(mask)
    runs = difference(pixels, old.ravel()[pixels], new.ravel()[pixels])
    stroke = Stroke("f", "paint", runs)
    changed = np.flatnonzero(mask & (old != new))
    np.testing.assert_array_equal(stroke.pixels, changed)
    np.testing.assert_array_equal(stroke.old, old.ravel()[changed])
    np.testing.assert_array_equal(stroke.new, new.ravel()[changed])
    parts = old.copy()
    stroke.apply_to(parts)
    np.testing.assert_array_equal(parts, np.where(mask, new, old))
    Stroke("f", "undo", stroke.inverse_runs()).apply_to(parts)
    np.testing.assert_array_equal(parts, old)
    # As few runs as can be: neighbours that could be one are one.
    ends = runs[:-1, 0] + runs[:-1, 1] == runs[1:, 0]
    assert not (ends & (runs[:-1, 2:] == runs[1:, 2:]).all(axis=1)).any()


# Operations


def test_painting_takes_masks_and_indices_in_any_order_and_more_than_once():
    mask = np.arange(H * W).reshape(H, W) % 3 == 0
    for pixels in (mask, np.concatenate([np.flatnonzero(mask)[::-1], [0, 0]])):
        editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann")
        editor.paint(pixels, 2)
        np.testing.assert_array_equal(editor.parts, np.where(mask, 2, 0))
        assert editor.paint(pixels, 2) is None and len(editor.history.done) == 1


@pytest.mark.parametrize(
    "wrong",
    [
        lambda e: e.paint(np.array([H * W]), 2),
        lambda e: e.paint(np.array([-1]), 2),
        lambda e: e.paint(np.ones((H, W + 1), np.bool_), 2),
        lambda e: e.paint(np.ones((H, W), np.bool_), 12),
        lambda e: e.merge(2, -1),
        lambda e: e.copy_previous(np.zeros((2, 2), np.uint8)),
        lambda e: e.judge("reject", "  "),
    ],
)
def test_a_mistake_changes_nothing(wrong):
    editor = Editor(blank(np.full((H, W), 2, np.uint8)), "ann")
    before = editor.parts.copy()
    with pytest.raises(CloudError):
        wrong(editor)
    np.testing.assert_array_equal(editor.parts, before)
    assert not editor.history.done


def test_the_shown_labels_are_read_only_and_follow_a_stroke_that_cannot_be_saved():
    def full(stroke):
        raise CloudError("disk full")

    editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann", full)
    shown = editor.parts
    with pytest.raises(ValueError, match="read-only"):
        shown[0, 0] = 1
    with pytest.raises(CloudError, match="full"):
        editor.paint(np.array([5]), 3)
    assert shown.flat[5] == 3 and len(editor.history.done) == 1


@given(parts=maps)
@law
def test_swapping_limbs_and_merging_take_these_parts_only(parts):
    editor = Editor(blank(parts), "ann")
    editor.swap_left_right(ARMS)
    legs_kept = np.isin(parts, np.array(LEGS))
    np.testing.assert_array_equal(editor.parts[legs_kept], parts[legs_kept])
    editor.swap_left_right(LEGS)
    np.testing.assert_array_equal(editor.parts, swap_left_right(parts))
    swapped = editor.parts.copy()
    editor.merge(3, 5)
    np.testing.assert_array_equal(editor.parts, np.where(swapped == 3, 5, swapped))


def test_a_selection_goes_to_the_neighbour_it_touches_most():
    parts = np.zeros((20, 30), np.uint8)
    parts[2:18, 2:14], parts[2:18, 14:20], parts[2:6, 20:28] = 2, 3, 5
    editor = Editor(blank(parts), "ann")
    edge = np.zeros(parts.shape, np.bool_)
    edge[2:18, 14:16] = True
    assert cleanup.neighbours(parts, np.flatnonzero(edge), PAPER)[::2] == [PART_ID["torso"], BACKGROUND]
    editor.to_neighbour(edge)
    assert (editor.parts[edge] == 2).all()
    editor.undo()
    # The second choice of the upper arm's outer edge: the forearm is in contact, then anatomy.
    edge = np.zeros(parts.shape, np.bool_)
    edge[2:18, 18:20] = True
    assert cleanup.neighbours(parts, np.flatnonzero(edge), PAPER)[:2] == [5, 2]
    assert editor.to_neighbour(np.ones(parts.shape, np.bool_)) is None


def test_an_undo_from_before_verdicts_could_be_taken_back_passes_over_them():
    paint = Stroke("f", "paint", np.array([[0, 2, 0, 1]], np.int64), 1)
    accept = Stroke("f", "accept", np.empty((0, 4), np.int64))
    history = History.of([paint, accept, Stroke("f", "undo", paint.inverse_runs())])
    assert not history.done and history.undone == [paint]


def test_a_copy_changes_what_is_of_the_body_in_both_frames():
    parts, before = np.full((2, 4), 2, np.uint8), np.full((2, 4), 7, np.uint8)
    parts[0, 0], before[0, 1], before[0, 2] = BACKGROUND, BACKGROUND, UNDEFINED
    editor = Editor(blank(parts), "ann")
    assert editor.copy_previous(before).operation == "copy_previous"
    np.testing.assert_array_equal(editor.parts, [[0, 2, 2, 7], [7, 7, 7, 7]])


def test_a_journal_with_strokes_that_were_carried_over_replays():
    carried = Stroke("f", "propagate", np.array([[0, 3, 2, 7]], np.int64))
    frame = blank(np.full((2, 4), 2, np.uint8))
    replayed = after(frame, [from_line(to_line(carried))], exact=True)
    np.testing.assert_array_equal(replayed.parts, [[7, 7, 7, 2], [2, 2, 2, 2]])


# Tidying


def test_holes_are_filled_but_not_the_wall_behind_them():
    parts, depth = np.zeros((60, 60), np.uint8), np.full((60, 60), 2000, np.uint16)
    parts[5:55, 5:55] = 2
    parts[10:14, 10:14] = 0  # a hole at the surface's depth
    parts[20:24, 20:24] = 3  # a speck of another part
    parts[30:34, 30:34], depth[30:34, 30:34] = 0, 2600  # the wall behind
    parts[53:58, 20:24] = 0  # a bay, open to the background
    parts[40:50, 40:44] = 0
    depth[36:54, 36:40] = 0  # half of its rim is unknown, still a hole
    editor = Editor(FrameLabels("f", depth, np.where(depth > 0, parts, 0).astype(np.uint8)), "ann")
    preview = editor.preview(cleanup.filled(editor.parts, depth, 2))
    stroke = editor.replace("fill_holes", cleanup.filled(editor.parts, depth, 2), 2)
    np.testing.assert_array_equal(stroke.pixels, preview)
    filled = np.zeros(parts.shape, np.bool_)
    filled[10:14, 10:14] = filled[20:24, 20:24] = filled[40:50, 40:44] = True
    np.testing.assert_array_equal(preview, np.flatnonzero(filled))
    assert not len(editor.preview(cleanup.filled(editor.parts, depth, 2)))


def test_a_large_hole_stays():
    parts = np.full((60, 60), 2, np.uint8)
    parts[10:40, 10:40] = 7
    np.testing.assert_array_equal(cleanup.filled(parts, blank(parts).depth_mm, 2), parts)


def test_islands_go_to_what_surrounds_them_and_the_largest_piece_stays():
    parts, depth = np.zeros((80, 80), np.uint8), np.full((80, 80), 3000, np.uint16)
    parts[5:60, 5:60] = 2
    parts[5:60, 45:60] = 3
    depth[5:60, 5:60] = 2000
    parts[10:14, 10:14] = 3  # an island in the torso
    parts[12, 12] = 5  # an island in the island
    parts[50:56, 50:56] = 2  # one in the arm
    parts[70:74, 70:74], depth[70:74, 70:74] = 2, 1000  # a speck in the air
    parts[40:44, 20:24] = UNDEFINED  # undefined stays
    parts[66:69, 5:8] = 8  # a part in one small piece: as good as it gets
    expected = parts.copy()
    expected[10:14, 10:14], expected[50:56, 50:56], expected[70:74, 70:74] = 2, 3, 0
    expected[12, 12] = 5
    np.testing.assert_array_equal(cleanup.without_islands(parts, depth), expected)


# Time


def test_idle_time_does_not_count():
    now = 0.0
    spent = ActiveTime(lambda: now)
    spent.mark("looking")
    steps = (3, IDLE_S, IDLE_S + 1, -5, 2)
    for step, kind in zip(steps, ("looking", *["painting"] * 2, *["navigating"] * 2), strict=True):
        now += step
        spent.mark(kind)
    assert spent.take() == {"looking": 3, "painting": IDLE_S, "navigating": 2}
    assert spent.take() == {}


def test_strokes_hold_person_time_gesture_and_seconds():
    now = 100.0
    editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann", time=ActiveTime(lambda: now))
    editor.time.mark("looking")
    now += 4
    gesture = Gesture("lasso", points=20, path_px=150.0)
    stroke = editor.paint(np.array([1]), 6, gesture)
    assert (stroke.who, stroke.how, stroke.part, stroke.seconds) == ("ann", gesture, 6, {"painting": 4})
    assert stroke.when == "1970-01-01T00:01:44.000+00:00"
    now += 2
    editor.time.mark("navigating")
    assert editor.leave().seconds == {"navigating": 2} and editor.leave() is None


# Strokes from outside


def test_an_undo_of_something_else_is_refused():
    stroke = Stroke("f", "paint", np.array([[0, 1, 0, 1]], np.int64))
    other = Stroke("f", "undo", np.array([[0, 2, 1, 0]], np.int64))
    for history in ([other], [stroke, other], [stroke, Stroke("f", "redo", stroke.runs)]):
        with pytest.raises(FormatError, match="last stroke"):
            History.of(history)


def test_a_run_beyond_the_image_is_refused_before_it_is_expanded():
    """152 bytes that claim 16 GiB of pixels."""
    with pytest.raises(FormatError, match="beyond every image"):
        Stroke("f", "relabel", np.array([[0, 2**31 - 1, 0, 1]], np.int64), reason="0001")
    largest = np.array([[0, MAX_IMAGE_SIDE**2, 0, 1]], np.int64)
    stroke = Stroke("f", "relabel", largest, reason="0001")
    frame = blank(np.zeros((H, W), np.uint8))
    for exact, fault in ((True, "do not fit"), (False, "reaches pixel")):
        tracemalloc.start()
        with pytest.raises(FormatError, match=fault):
            after(frame, [stroke], exact=exact)
        assert tracemalloc.get_traced_memory()[1] < 50_000_000
        tracemalloc.stop()
