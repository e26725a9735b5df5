"""The correction core: all work can be undone and replayed to the bit, and no lock is ever broken."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from annotate import cleanup
from annotate.correction import select
from annotate.correction.edit import ARMS, IDLE_S, LEGS, ActiveTime, Editor
from annotate.correction.history import History
from annotate.correction.replay import after
from annotate.correction.select import edit_supervoxels
from annotate.frame_labels import FrameLabels
from annotate.gui.state.drawing import Drawing
from annotate.labelset.stroke import Gesture, Stroke, difference, from_line, to_line
from annotate.parts import BACKGROUND, LEFT_RIGHT, N_CLASSES, PART_ID, UNDEFINED, swap_left_right
from sensors.errors import CloudError, FormatError
from sensors.rig.camera import Intrinsics

law = settings(deadline=None, max_examples=60)

H, W = 9, 13
PART_IDS = [*range(N_CLASSES), UNDEFINED]
ids = st.sampled_from(PART_IDS)
maps = arrays(np.uint8, (H, W), elements=ids)
masks = arrays(np.bool_, (H, W))
depths = arrays(np.uint16, (H, W), elements=st.sampled_from([0, 1000, 1005, 1010, 2000]))
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
    editor = Editor(frame, "ann")
    work(editor, operations)
    result = editor.parts.copy()
    redone = len(editor.history.undone)
    steps = 0
    while editor.undo():
        steps += 1
    np.testing.assert_array_equal(editor.parts, frame.parts)
    for _ in range(steps):
        assert editor.redo()
    np.testing.assert_array_equal(editor.parts, result)
    assert len(editor.history.undone) == redone


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
        # Saved labels may already hold what is applied to them.
        half = after(frame, read[: cut + 1])
        np.testing.assert_array_equal(after(half, read[cut // 2 :]).parts, editor.parts)
    history = History.of(read)
    for ours, theirs in ((history.done, editor.history.done), (history.undone, editor.history.undone)):
        assert [to_line(stroke) for stroke in ours] == [to_line(stroke) for stroke in theirs]


@given(frame=frames(), operations=works, locks=st.sets(ids, max_size=4))
@law
def test_a_locked_part_neither_loses_nor_gains(frame, operations, locks):
    editor = Editor(frame, "ann")
    editor.locks = locks
    work(editor, operations)
    for part in locks:
        np.testing.assert_array_equal(editor.parts == part, frame.parts == part)


@given(frame=frames(), operations=works)
@law
def test_pixels_without_depth_never_get_a_part(frame, operations):
    editor = Editor(frame, "ann")
    work(editor, operations)
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


def test_a_new_stroke_leaves_nothing_to_redo():
    editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann")
    editor.paint(np.array([0]), 1)
    editor.undo()
    editor.paint(np.array([1]), 1)
    assert editor.redo() is None
    editor.undo()
    editor.judge("accept")
    assert editor.redo() is None, "what was accepted stays as it was accepted"
    assert editor.undo().operation == "undo" and editor.parts.flat[1] == 0


def test_painting_takes_masks_and_indices_in_any_order_and_more_than_once():
    parts = np.zeros((H, W), np.uint8)
    by_mask, by_index = Editor(blank(parts), "ann"), Editor(blank(parts), "ann")
    mask = np.arange(H * W).reshape(H, W) % 3 == 0
    by_mask.paint(mask, 2)
    by_index.paint(np.concatenate([np.flatnonzero(mask)[::-1], [0, 0]]), 2)
    np.testing.assert_array_equal(by_mask.parts, np.where(mask, 2, 0))
    np.testing.assert_array_equal(by_mask.parts, by_index.parts)
    assert by_mask.paint(mask, 2) is None
    assert len(by_mask.history.done) == 1


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


def test_the_labels_shown_cannot_be_written_to_but_follow():
    editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann")
    shown = editor.parts
    with pytest.raises(ValueError, match="read-only"):
        shown[0, 0] = 1
    editor.paint(np.array([0]), 1)
    assert shown[0, 0] == 1


def test_a_stroke_that_cannot_be_saved_has_its_effect():
    def full(stroke):
        raise CloudError("disk full")

    editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann", full)
    with pytest.raises(CloudError, match="full"):
        editor.paint(np.array([5]), 3)
    assert editor.parts.flat[5] == 3
    assert len(editor.history.done) == 1


@given(parts=maps)
@law
def test_swapping_limbs(parts):
    editor = Editor(blank(parts), "ann")
    editor.swap_left_right(ARMS)
    legs_kept = np.isin(parts, np.array(LEGS))
    np.testing.assert_array_equal(editor.parts[legs_kept], parts[legs_kept])
    editor.swap_left_right(LEGS)
    np.testing.assert_array_equal(editor.parts, swap_left_right(parts))


def test_merging_takes_one_part_only():
    editor = Editor(blank(np.repeat(np.array([[3, 5, 7]], np.uint8), 4, axis=0)), "ann")
    editor.merge(3, 5)
    np.testing.assert_array_equal(editor.parts, [[5, 5, 7]] * 4)


def test_a_selection_goes_to_the_neighbour_it_touches_most():
    parts = np.zeros((20, 30), np.uint8)
    parts[2:18, 2:14], parts[2:18, 14:20], parts[2:6, 20:28] = 2, 3, 5
    editor = Editor(blank(parts), "ann")
    edge = np.zeros(parts.shape, np.bool_)
    edge[2:18, 14:16] = True
    assert cleanup.neighbours(parts, np.flatnonzero(edge))[::2] == [PART_ID["torso"], BACKGROUND]
    editor.to_neighbour(edge)
    assert (editor.parts[edge] == 2).all()
    editor.undo()
    # The second choice of the upper arm's outer edge: the forearm is in contact, then anatomy.
    edge = np.zeros(parts.shape, np.bool_)
    edge[2:18, 18:20] = True
    assert cleanup.neighbours(parts, np.flatnonzero(edge))[:2] == [5, 2]
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


def test_holes_are_filled_but_not_what_is_seen_through_them():
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


def test_a_large_hole_is_no_slip():
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
    parts[40:44, 20:24] = UNDEFINED  # nobody asked
    parts[66:69, 5:8] = 8  # a part in one small piece: as good as it gets
    expected = parts.copy()
    expected[10:14, 10:14], expected[50:56, 50:56], expected[70:74, 70:74] = 2, 3, 0
    expected[12, 12] = 5
    np.testing.assert_array_equal(cleanup.without_islands(parts, depth), expected)


# Selections


def view_of(points_m: np.ndarray, size_px: tuple[int, int] = (200, 150)) -> select.ScreenPoints:
    """A pinhole view of points (n, 3)."""
    xy = 100 * points_m[:, :2] / points_m[:, 2:] + np.array([100, 75])
    return select.ScreenPoints(xy.astype(np.float32), points_m[:, 2].astype(np.float32), size_px)


def scattered(n: int = 3000, seed: int = 0) -> select.ScreenPoints:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-20, 220, (n, 2)).astype(np.float32)
    xy[:50] = np.nan
    return select.ScreenPoints(xy, np.full(n, 2, np.float32), (200, 150))


def rectangle(view: select.ScreenPoints, corner_px, opposite_px, through: bool = False) -> np.ndarray:
    return Drawing("rectangle", corner_px, through=through, points_px=[corner_px, opposite_px]).pixels(view)


def on_screen(view: select.ScreenPoints) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return (view.xy_px >= 0).all(axis=1) & (view.xy_px < view.size_px).all(axis=1)


def test_a_brush_takes_the_points_near_its_path():
    view = scattered()
    start, end = np.array([30.0, 20.0]), np.array([150.0, 110.0])
    along = np.clip((view.xy_px - start) @ (end - start) / np.square(end - start).sum(), 0, 1)
    away = np.linalg.norm(view.xy_px - start - along[:, None] * (end - start), axis=1)
    found = np.zeros(len(away), np.bool_)
    found[select.brush(view, np.stack([start, end]), 15.0, through=True)] = True
    assert not found[~on_screen(view)].any()
    # The screen's pixels decide: what is farther than a pixel's diagonal from the rim is certain.
    np.testing.assert_array_equal(found[on_screen(view) & (away < 13)], True)
    assert not found[away > 17].any()


def test_a_lasso_takes_the_points_inside():
    view = scattered(seed=1)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    found = np.zeros(len(view.xy_px), np.bool_)
    corners = np.stack([100 + 50 * np.cos(angle), 75 + 50 * np.sin(angle)], axis=1)
    found[select.polygon(view, corners, through=True)] = True
    away = np.linalg.norm(view.xy_px - np.array([100, 75]), axis=1)
    assert found[away < 48.5].all()
    assert not found[away > 51.5].any()


def test_a_rectangle_on_the_depth_pane_takes_its_pixels():
    view = select.ScreenPoints.of_image(np.full((H, W), 1000, np.uint16), 4.0)
    found = rectangle(view, (8.5, 12.5), (23.5, 4.5))
    expected = np.zeros((H, W), np.bool_)
    expected[1:3, 2:6] = True
    np.testing.assert_array_equal(found, np.flatnonzero(expected))
    assert select.nearest(view, (4 * 5 + 2, 4 * 3 + 2)) == 3 * W + 5
    beyond = np.array([[-1e9, -1e9], [1e9, -1e9], [0, 1e9]])
    np.testing.assert_array_equal(select.polygon(view, beyond), np.arange(H * W))


def test_what_lies_behind_is_left_alone_unless_asked():
    v, u = np.mgrid[0:1:40j, 0:1:50j]
    front = np.stack([u.ravel() - 0.5, v.ravel() - 0.5, np.full(u.size, 1.0)], axis=1)
    back = front * 1.5
    hidden = np.arange(u.size, 2 * u.size)
    view = view_of(np.concatenate([front, back]))
    all_of_it = (0.0, 0.0), (200.0, 150.0)
    found = rectangle(view, *all_of_it)
    assert set(found) >= set(range(u.size)) and not set(found) & set(hidden)
    np.testing.assert_array_equal(rectangle(view, *all_of_it, through=True), np.arange(2 * u.size))
    assert select.nearest(view, (100, 75)) < u.size
    assert select.nearest(view, (2, 2)) is None


def test_a_click_takes_a_piece_and_the_next_one_what_it_touches():
    piece = np.full((20, 40), -1, np.int32)
    piece[:, :10], piece[:, 10:20], piece[:, 20:30] = 0, 1, 2
    parts = np.full((20, 40), 2, np.uint8)
    parts[:10, 10:20] = 3
    depth = np.full((20, 40), 1000, np.uint16)
    depth[:, 20:] = 1500
    first = select.supervoxel(piece, parts, 15 * 40 + 12)
    expected = np.zeros((20, 40), np.bool_)
    expected[10:, 10:20] = True
    np.testing.assert_array_equal(first, np.flatnonzero(expected))
    # Again: the piece beside it with the same part; not what is deeper, not the other part.
    expected[:, :10] = True
    np.testing.assert_array_equal(select.grow(piece, parts, depth, first), np.flatnonzero(expected))
    assert not len(select.supervoxel(piece, parts, 39))
    assert not len(select.grow(piece, parts, depth, np.empty(0, np.int64)))


def test_one_click_mends_one_patch():
    camera = Intrinsics(160, 120, 360, 360, 79.5, 59.5)
    v, u = np.mgrid[:120, :160]
    depth = np.where((abs(u - 80) < 30) & (abs(v - 60) < 45), 1500, 2500).astype(np.uint16)
    depth += np.random.default_rng(0).integers(0, 6, depth.shape, np.uint16)
    depth[::7, ::5] = 0
    truth = np.where(depth < 2000, np.where(v < 60, 2, 7), 0).astype(np.uint8)
    truth[depth == 0] = 0
    parts = truth.copy()
    parts[(truth == 2) & (v > 45) & (u > 90)] = 7
    colors = np.where((truth == 2)[..., None], [200, 30, 30], [30, 30, 200]).astype(np.uint8)
    pieces = edit_supervoxels(depth, parts, camera, colors)
    assert pieces.shape == parts.shape and pieces.dtype == np.int32
    assert (pieces[truth > 0] >= 0).all()
    assert (pieces[(depth == 0) | (depth > 2000)] == -1).all()
    editor = Editor(FrameLabels("f", depth, parts), "ann")
    wrong = editor.parts != truth
    clicks = 0
    for piece in np.unique(pieces[wrong]):
        inside = (pieces == piece) & (parts == 7)
        if wrong[inside].mean() > 0.5:
            at = int(np.flatnonzero(inside)[0])
            editor.paint(select.supervoxel(pieces, editor.parts, at), 2, Gesture("supervoxel", 1))
            clicks += 1
    # What is left are pixels on the border that share a voxel of 12 mm.
    assert (editor.parts != truth).sum() < 0.15 * wrong.sum()
    assert clicks <= wrong.sum() / 15
    empty = edit_supervoxels(depth, np.zeros_like(parts), camera)
    assert (empty == -1).all()


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
    assert spent.now() == "1970-01-01T00:04:01.000+00:00"


def test_strokes_say_who_when_how_and_how_long():
    now = 100.0
    editor = Editor(blank(np.zeros((H, W), np.uint8)), "ann", time=ActiveTime(lambda: now))
    editor.time.mark("looking")
    now += 4
    gesture = Gesture("lasso", points=20, path_px=150.0)
    stroke = editor.paint(np.array([1]), 6, gesture)
    assert (stroke.who, stroke.how, stroke.part) == ("ann", gesture, 6)
    assert stroke.when == "1970-01-01T00:01:44.000+00:00"
    assert stroke.seconds == {"painting": 4}
    now += 2
    editor.time.mark("navigating")
    assert editor.leave().seconds == {"navigating": 2}
    assert editor.leave() is None


# Strokes from outside


def test_an_undo_of_something_else_is_refused():
    stroke = Stroke("f", "paint", np.array([[0, 1, 0, 1]], np.int64))
    other = Stroke("f", "undo", np.array([[0, 2, 1, 0]], np.int64))
    for history in ([other], [stroke, other], [stroke, Stroke("f", "redo", stroke.runs)]):
        with pytest.raises(FormatError, match="last stroke"):
            History.of(history)
