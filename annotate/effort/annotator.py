"""Simulated annotator: it corrects a frame's labels by the operations of the window and counts the time.

The annotator compares labels with a truth. It makes the repair that corrects most pixels per second, with
random errors of the drawing hand, and undoes failed repairs. The work ends at the goal or when no repair
helps. Constants are untuned unless a source is given.
"""

import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64, Int32, UInt8
from annotate.cleanup import filled, without_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.correction import Correction
from annotate.correction.edit import Editor
from annotate.correction.select import ScreenPoints, edit_supervoxels
from annotate.effort.agreement import Agreement
from annotate.effort.hand import drawn
from annotate.effort.keystrokes import MENTAL_S, Tools, gesture, gesture_s, move_s, moves_s
from annotate.effort.repairs import (
    SCALE,
    Move,
    Patch,
    Repair,
    View,
    in_one_go,
    patches,
    repairs,
    repairs_of_frame,
)
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import KEY, Activity, Gesture, Stroke
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import BACKGROUND

WHO = "simulated"
BEGAN_S = datetime(2026, 1, 5, 9, tzinfo=UTC).timestamp()  # fixed, so that equal work gives equal journals
AGREEMENT = 0.99  # share of the counted pixels that must be right
TOLERANCE_PX = 2  # at borders: neither a hand nor the depth is more exact (docs/adr/0004)
PATCHES_SEEN = 5  # worst patches among which a person chooses; if none helps, the next worst
LEAST_PX = (9, 3)  # wrong pixels of a patch worth a repair: at first (1 cm at 2 m), and at the end
MOST_REPAIRS = 60  # then the frame is accepted as it is
CTRL_KEY = Gesture("key", keys=2)


@dataclass(frozen=True)
class Effort:
    """Work on a frame: final labels, journal entries, a person's seconds, and final share of right pixels."""

    corrected: FrameLabels
    strokes: tuple[Stroke, ...]
    seconds: float
    agreement: float

    @property
    def repairs(self) -> int:
        """Return the number of operations other than accepting."""
        return sum(stroke.operation != "accept" for stroke in self.strokes)


class _Option(NamedTuple):
    """Repair that can be chosen, with its gain in right pixels and its duration in seconds."""

    repair: Repair
    gain: int
    seconds: float


class Annotator:
    """Simulated person at the window.

    goal: agreement at which the annotator accepts. tolerance_px: tolerance at borders, as in ``Agreement``.
    at_once: greatest number of patches of one part that are repaired after one mental preparation
    (``keystrokes``).
    """

    def __init__(self, goal: float = AGREEMENT, tolerance_px: int = TOLERANCE_PX, at_once: int = 1) -> None:
        self._now_s, self.goal, self.tolerance_px, self.at_once = BEGAN_S, goal, tolerance_px, at_once
        self._tools = Tools()

    def clock(self) -> float:
        """Return the annotator's time in seconds since the epoch, for editors and corrections."""
        return self._now_s

    def work(self, editor: Editor, truth: UInt8, supervoxels: Int32) -> None:
        """Correct one frame until the goal is reached or no repair helps, and accept it.

        editor: of that frame, with this annotator's clock. truth: uint8 (h, w). supervoxels: int32 (h, w).
        """
        agreement = Agreement(truth, editor.valid, self.tolerance_px)
        imagined, rng = np.random.default_rng(zlib.crc32(editor.frame_id.encode())).spawn(2)
        screen = ScreenPoints.of_image(editor.depth_mm, SCALE)
        view = View(editor, agreement, screen, supervoxels, imagined)
        editor.time.mark("looking")
        self._spend(editor, "looking", MENTAL_S)
        tried: set[object] = set()
        for _ in range(MOST_REPAIRS):
            if (best := self._choose(view, tried)) is None:
                break
            before = agreement.of(editor.parts)
            strokes = self._carry_out(view, best, rng)
            if agreement.of(editor.parts) <= before:
                self._undo(editor, strokes)
                tried.add(best.identity)
        self._spend(editor, "painting", gesture_s(KEY, 1.0))
        editor.judge("accept")

    def _choose(self, view: View, tried: set[object]) -> Repair | None:
        """Return the repair that corrects most pixels per second; None at the goal or without repairs.

        Pixels corrected beyond the goal do not count. tried: identities of failed repairs, which are left
        out.
        """
        parts, agreement = view.editor.parts, view.agreement
        needed = int(agreement.wrong(parts).sum()) - (1 - self.goal) * agreement.counted(parts)
        if needed <= 0:
            return None
        found = patches(parts, agreement)
        for least_px in LEAST_PX:
            worth = [patch for patch in found if patch.wrong >= least_px]
            for first in range(0, len(worth), PATCHES_SEEN):
                options = self._options(worth[first : first + PATCHES_SEEN], view, tried)
                if enough := [option for option in options if option.gain >= least_px]:
                    return max(enough, key=lambda option: min(option.gain, needed) / option.seconds).repair
        return None

    def _options(self, found: list[Patch], view: View, tried: set[object]) -> Iterator[_Option]:
        """Yield every untried repair of these patches, alone and joined with others of the same part.

        Repairs of the whole frame follow.
        """
        best: dict[int, list[tuple[float, Repair]]] = defaultdict(list)
        for patch in found:
            untried = (repair for repair in repairs(patch, view) if repair.identity not in tried)
            options = [self._priced(repair, view) for repair in untried]
            yield from options
            if options:
                rates = [option.gain / option.seconds for option in options]
                first = int(np.argmax(rates))
                best[patch.part].append((rates[first], options[first].repair))
        together = (
            in_one_go([repair for _, repair in sorted(some, key=lambda pair: -pair[0])[:count]])
            for some in best.values()
            for count in range(2, min(len(some), self.at_once) + 1)
        )
        for repair in chain(together, repairs_of_frame(view, {patch.part for patch in found})):
            if repair.identity not in tried:
                yield self._priced(repair, view)

    def _priced(self, repair: Repair, view: View) -> _Option:
        gain = int(view.agreement.gains(view.editor.parts, repair.pixels, repair.parts).sum())
        return _Option(repair, gain, moves_s(repair.moves, self._tools))

    def _carry_out(self, view: View, repair: Repair, rng: np.random.Generator) -> int:
        """Make a repair with random errors of the hand; return the number of its strokes."""
        editor, strokes = view.editor, 0
        self._spend(editor, "looking", MENTAL_S)
        for move in repair.moves:
            corners = None if move.corners is None else drawn(move.corners, move.hand, rng)
            tools = self._tools.set_for(move)
            how = gesture(move, corners, tools.keys(self._tools))
            self._spend(editor, "painting", move_s(move, how))
            self._tools = tools
            editor.only = move.only
            editor.locks = {BACKGROUND} if move.keep_outline else set()
            strokes += _apply(view, move, corners, how) is not None
            editor.only = None
        return strokes

    def _undo(self, editor: Editor, strokes: int) -> None:
        self._spend(editor, "looking", MENTAL_S)
        for _ in range(strokes):
            self._spend(editor, "painting", gesture_s(CTRL_KEY, 1.0))
            editor.undo(CTRL_KEY)

    def _spend(self, editor: Editor, activity: Activity, seconds: float) -> None:
        self._now_s += seconds
        editor.time.mark(activity)


def correct_set(
    correction: Correction,
    truth: LabelSet,
    annotator: Annotator,
    cloud_of: Callable[[str], ThermalCloud | None],
    order: Iterable[str] = (),
) -> Iterator[Effort]:
    """Let a simulated annotator correct a label set, and yield its effort on each frame.

    correction: must use the annotator's clock. cloud_of: function that returns the cloud of a frame, for its
    colours, or None. order: frame ids, read one by one; by time if empty. Raises FormatError for a truth that
    does not convert to the label set's scheme.
    """
    in_scheme = conversion_table(truth.scheme, correction.labels.scheme)
    for frame_id in order or correction.labels.frame_ids:
        automatic, true = correction.frame(frame_id), in_scheme[truth.read(frame_id).parts]
        cloud = cloud_of(frame_id)
        color_rgb = cloud.color_rgb if cloud is not None and cloud.color_valid.any() else None
        camera = correction.labels.intrinsics
        pieces = edit_supervoxels(automatic, camera, color_rgb)
        editor = correction.edit(frame_id)
        annotator.work(editor, true, pieces)
        corrected = replace(automatic, parts=editor.parts.copy(), status="corrected")
        strokes = tuple(correction.journal.strokes(frame_id))
        seconds = sum(stroke.active_seconds for stroke in strokes)
        agreement = Agreement(true, editor.valid, annotator.tolerance_px)
        yield Effort(corrected, strokes, seconds, agreement.of(corrected.parts))


def _apply(view: View, move: Move, corners: Float64 | None, how: Gesture) -> Stroke | None:
    """Apply a move with the editor; return None if nothing changed. corners: (k, 2) as (u, v), as drawn."""
    editor, part = view.editor, move.part
    if move.operation == "swap_left_right":
        return editor.swap_left_right(move.pairs, how)
    if move.operation == "remove_islands":
        return editor.replace("remove_islands", without_islands(editor.parts, editor.depth_mm), None, how)
    if move.operation == "to_neighbour":
        return editor.to_neighbour(view.chosen(move, corners), how)
    assert part is not None
    if move.operation == "fill_holes":
        return editor.replace("fill_holes", filled(editor.parts, editor.depth_mm, part), part, how)
    if move.operation == "merge":
        assert move.pixel is not None
        return editor.merge(int(editor.parts.flat[move.pixel]), part, how)
    return editor.paint(view.chosen(move, corners), part, how)
