"""The simulated annotator: the time that a person would need to correct a frame's labels.

It works with the operations of the window (``edit``), as strokes of the journal. It uses the truth only to
see, as a person would, what is wrong; it then makes the repair that corrects most pixels per second
(``keystrokes``), with a hand that errs (``hand``), undoes repairs that went wrong, and stops when the frame
is good enough or nothing helps.
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
from annotate.correction.propagate import FRAMES_COMPARED, CorrectedFrame, propagate
from annotate.correction.select import ScreenPoints, edit_supervoxels
from annotate.effort.agreement import Agreement
from annotate.effort.hand import drawn
from annotate.effort.keystrokes import MENTAL_S, Tools, gesture, gesture_s, move_s, moves_s
from annotate.effort.repairs import (
    SCALE,
    Identity,
    Move,
    Patch,
    Repair,
    Sight,
    in_one_go,
    patches,
    repairs,
    repairs_of_frame,
)
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import KEY, Activity, Gesture, Stroke
from annotate.parts import BACKGROUND

WHO = "simulated"
BEGAN_S = datetime(2026, 1, 5, 9, tzinfo=UTC).timestamp()
"""Start of the work, in seconds since the epoch: fixed, so that the same work gives the same journal."""
AGREEMENT = 0.99
"""Share of the counted pixels that must be right for the frame to be accepted. Chosen by eye."""
TOLERANCE_PX = 2
"""Tolerance at borders, in pixels: neither a hand nor the depth itself is more exact there. Chosen by eye
(docs/adr/0004)."""
PATCHES_SEEN = 5
"""Number of worst patches among which a person chooses the next repair; if none helps, the next worst. Chosen
by eye."""
LEAST_PX = (9, 3)
"""Least number of wrong pixels of a patch that is repaired at first (three by three, or 1 cm at 2 m), and
when nothing else is left. Chosen by eye."""
MOST_REPAIRS = 60
"""Number of repairs after which a frame is accepted as it is. Chosen by eye."""
REMEMBERED = 4 * FRAMES_COMPARED
"""Number of frames worked on last, of which those near in time are carried over. Chosen by eye."""
CTRL_KEY = Gesture("key", keys=2)
"""Gesture of undo: Ctrl and a letter."""
TAKE_BACK_S = MENTAL_S + gesture_s(CTRL_KEY, 1.0)
"""Seconds to see that a stroke went wrong, and to undo it."""
CARRIED = Gesture("key")
"""Gesture of corrections that the window carries over by itself when accepting a frame opens the next."""


@dataclass(frozen=True)
class Effort:
    """The work on a frame. corrected: its labels afterwards; strokes: its entries in the journal; seconds: of
    a person's work; agreement: share of right pixels afterwards."""

    corrected: FrameLabels
    strokes: tuple[Stroke, ...]
    seconds: float
    agreement: float

    @property
    def repairs(self) -> int:
        """Number of operations other than accepting and those that the window made by itself."""
        return sum(stroke.operation != "accept" and stroke.how != CARRIED for stroke in self.strokes)


class _Option(NamedTuple):
    """A repair, the number of pixels it corrects, and the seconds it takes."""

    repair: Repair
    gain: int
    seconds: float

    @property
    def rate(self) -> float:
        return self.gain / self.seconds


class Annotator:
    """A simulated person at the window.

    goal: the agreement at which they accept. tolerance_px: at borders. at_once: number of patches of one
    part that they see with one look (``keystrokes``).
    """

    def __init__(self, goal: float = AGREEMENT, tolerance_px: int = TOLERANCE_PX, at_once: int = 1) -> None:
        self._now_s, self.goal, self.tolerance_px, self.at_once = BEGAN_S, goal, tolerance_px, at_once
        self._tools = Tools()

    def clock(self) -> float:
        """Their time, in seconds since the epoch, for the editors and corrections they work in."""
        return self._now_s

    def work(self, editor: Editor, truth: UInt8, supervoxels: Int32, propagated: UInt8 | None = None) -> None:
        """Work on one frame until it is right enough or nothing helps, and accept it.

        editor: of that frame, with this annotator's clock. truth: uint8 (h, w). supervoxels: int32 (h, w).
        propagated: parts (h, w) that the window carried over when it opened the frame.
        """
        agreement = Agreement(truth, editor.valid, self.tolerance_px)
        imagined, rng = np.random.default_rng(zlib.crc32(editor.frame_id.encode())).spawn(2)
        view = ScreenPoints.of_image(editor.depth_mm, SCALE)
        sight = Sight(editor, agreement, view, supervoxels, imagined)
        editor.time.mark("looking")
        automatic = editor.parts.copy()
        carried = propagated is not None and editor.propagate(propagated, CARRIED) is not None
        self._spend(editor, "looking", MENTAL_S)
        tried: set[Identity] = set()
        for _ in range(MOST_REPAIRS):
            best = self._choose(sight, tried)
            if carried and self._harmed(editor.parts, automatic, best, agreement):
                self._take_back(editor, 1)
                best = self._choose(sight, tried)
            carried = False
            if best is None:
                break
            before = agreement.of(editor.parts)
            strokes = self._carry_out(sight, best.repair, rng)
            if agreement.of(editor.parts) <= before:
                self._take_back(editor, strokes)
                tried.add(best.repair.identity)
        self._spend(editor, "painting", gesture_s(KEY, 1.0))
        editor.judge("accept")

    def _choose(self, sight: Sight, tried: set[Identity]) -> _Option | None:
        """The repair that corrects most pixels per second; pixels beyond the goal do not count."""
        parts, agreement = sight.editor.parts, sight.agreement
        needed = self._needed(parts, agreement)
        if needed <= 0:
            return None
        found = patches(parts, agreement)
        for least_px in LEAST_PX:
            worth = [patch for patch in found if patch.wrong >= least_px]
            for first in range(0, len(worth), PATCHES_SEEN):
                options = self._options(worth[first : first + PATCHES_SEEN], sight, tried)
                enough = [option for option in options if option.gain >= least_px]
                if enough:
                    return max(enough, key=lambda option: min(option.gain, needed) / option.seconds)
        return None

    def _needed(self, parts: UInt8, agreement: Agreement) -> float:
        """Number of pixels of labels (h, w) to correct until the goal."""
        return int(agreement.wrong(parts).sum()) - (1 - self.goal) * agreement.counted(parts)

    def _options(self, found: list[Patch], sight: Sight, tried: set[Identity]) -> Iterator[_Option]:
        """Every untried repair of these patches, alone and together with others of the same part."""
        best: dict[int, list[_Option]] = defaultdict(list)
        for patch in found:
            options = [
                self._priced(repair, sight)
                for repair in repairs(patch, sight)
                if repair.identity not in tried
            ]
            yield from options
            if options:
                best[patch.part].append(max(options, key=lambda option: option.rate))
        together = (
            in_one_go([option.repair for option in sorted(some, key=lambda o: -o.rate)[:count]])
            for some in best.values()
            for count in range(2, min(len(some), self.at_once) + 1)
        )
        for repair in chain(together, repairs_of_frame(sight, {patch.part for patch in found})):
            if repair.identity not in tried:
                yield self._priced(repair, sight)

    def _priced(self, repair: Repair, sight: Sight) -> _Option:
        gain = int(sight.agreement.gains(sight.editor.parts, repair.pixels, repair.parts).sum())
        return _Option(repair, gain, moves_s(repair.moves, self._tools))

    def _carry_out(self, sight: Sight, repair: Repair, rng: np.random.Generator) -> int:
        """Make a repair; returns the number of its strokes."""
        editor, strokes = sight.editor, 0
        self._spend(editor, "looking", MENTAL_S)
        for move in repair.moves:
            corners = None if move.corners is None else drawn(move.corners, move.hand, rng)
            tools = self._tools.set_for(move)
            how = gesture(move, corners, tools.keys(self._tools))
            self._spend(editor, "painting", move_s(move, how))
            self._tools = tools
            editor.only = move.only
            editor.locks = {BACKGROUND} if move.keep_outline else set()
            strokes += _apply(sight, move, corners, how) is not None
            editor.only = None
        return strokes

    def _harmed(self, carried: UInt8, automatic: UInt8, best: _Option | None, agreement: Agreement) -> bool:
        """Whether undoing what was carried over corrects more pixels per second than the best repair."""
        needed = self._needed(carried, agreement)
        gain = int(agreement.wrong(carried).sum()) - int(agreement.wrong(automatic).sum())
        if needed <= 0 or gain <= 0:
            return False
        undoing = min(gain, needed) / TAKE_BACK_S
        return best is None or undoing > min(best.gain, needed) / best.seconds

    def _take_back(self, editor: Editor, strokes: int) -> None:
        """Undo strokes that went wrong."""
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
    propagating: bool = False,
    order: Iterable[str] = (),
) -> Iterator[Effort]:
    """Let a simulated annotator correct a label set, frame by frame.

    correction: with the annotator's clock. cloud_of: colours and temperatures of a frame, if there
    are any. propagating: whether a frame begins with the corrections of those before it of the same person,
    the nearest in time. order: of frame ids, asked for one by one; none is that of time.
    """
    worked: dict[int, CorrectedFrame] = {}
    person = None
    place = {frame_id: n for n, frame_id in enumerate(correction.labels.frame_ids)}
    for frame_id in order or place:
        automatic, true = correction.frame(frame_id), truth.read(frame_id)
        camera = correction.labels.intrinsics
        cloud = cloud_of(frame_id)
        color_rgb = cloud.color_rgb if cloud is not None and cloud.color_valid.any() else None
        pieces = edit_supervoxels(automatic.depth_mm, automatic.parts, camera, color_rgb)
        if true.subject != person:
            worked, person = {}, true.subject
        near = [worked[n] for n in sorted(worked, key=lambda n: abs(n - place[frame_id]))][:FRAMES_COMPARED]
        propagated = None
        if propagating and any(w.changed for w in near):
            found = propagate(near, automatic, camera, cloud)
            propagated = found if (found != automatic.parts).any() else None
        editor = correction.edit(frame_id)
        annotator.work(editor, true.parts, pieces, propagated)
        corrected = replace(automatic, parts=editor.parts.copy(), status="corrected")
        strokes = tuple(correction.journal.strokes(frame_id))
        seconds = sum(stroke.active_seconds for stroke in strokes)
        agreement = Agreement(true.parts, editor.valid, annotator.tolerance_px)
        yield Effort(corrected, strokes, seconds, agreement.of(corrected.parts))
        worked[place[frame_id]] = CorrectedFrame(automatic, corrected, cloud)
        if len(worked) > REMEMBERED:
            del worked[next(iter(worked))]


def _apply(sight: Sight, move: Move, corners: Float64 | None, how: Gesture) -> Stroke | None:
    """Make a move with the editor."""
    editor = sight.editor
    if move.operation == "swap_left_right":
        return editor.swap_left_right(move.pairs, how=how)
    if move.operation == "remove_islands":
        cleaned = without_islands(editor.parts, editor.depth_mm)
        return editor.replace("remove_islands", cleaned, None, how)
    if move.operation == "fill_holes":
        assert move.part is not None
        whole = filled(editor.parts, editor.depth_mm, move.part)
        return editor.replace("fill_holes", whole, move.part, how)
    if move.operation == "merge":
        assert move.part is not None and move.pixel is not None
        return editor.merge(int(editor.parts.flat[move.pixel]), move.part, how=how)
    pixels = sight.chosen(move, corners)
    if move.operation == "to_neighbour":
        return editor.to_neighbour(pixels, how=how)
    assert move.part is not None
    return editor.paint(pixels, move.part, how)
