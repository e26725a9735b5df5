"""The duration of a person's work in seconds: the keystroke-level model, with a law for drawing.

Operators and times: Card, Moran & Newell, The Psychology of Human-Computer Interaction, 1983, chapter 8.
Keys lie under the left hand while the right one holds the mouse (``gui.keys``): no homing is charged.

Mental preparation is charged once for every look: one before each repaired patch, to find it and to choose
the repair, and a last one that finds nothing wrong. The rules of Card et al. charge less: a patch is an
argument, and pointing at one takes no preparation (rule 0), nor does the button that was anticipated while
pointing (rule 1); finding it would belong to acquiring the task, which their model leaves out. Here, as in
Kieras (Using the keystroke-level model to estimate execution times, 1993, revised 2001), it is charged for
finding something on the display and for a decision about strategy, since both are the work here. The looser
reading, in which one look takes in up to four patches of one part as a chunk (rules 1 and 2; as many as
people hold in mind at a time: Cowan, The magical number 4 in short-term memory, 2001), is
``Annotator(at_once=4)``; figures of both: docs/adr/0009.
"""

from dataclasses import dataclass

from annotate.array_types import Float64
from annotate.effort.hand import length_px
from annotate.effort.repairs import SCALE, Move
from annotate.labelset.stroke import Gesture
from annotate.parts import BACKGROUND

KEY_S = 0.2
"""A key struck (an average skilled typist); Ctrl or Shift is a key of its own."""
POINT_S = 1.1
"""Pointing with the mouse."""
BUTTON_S = 0.1
"""A mouse button pressed, or released."""
CLICK_S = 2 * BUTTON_S
NOTCH_S = KEY_S
"""The mouse wheel turned by one notch."""
MENTAL_S = 1.35
"""Mental preparation: looking at the frame, finding the next mistake and choosing its repair."""
STEER_S = 0.1
"""Seconds for a drawn path as long as it is wide: slope of the steering law T = b * length / width
(Accot & Zhai, Beyond Fitts' law, CHI 1997). Our assumption: the slope depends on device and person."""
EFFECTIVE_WIDTH = 4.133
"""Width of the path within which a hand stays, in standard deviations of its error: it leaves the path 4 % of
the time (MacKenzie, Fitts' law as a research and design tool, 1992). So drawing carefully takes longer."""
PREVIEWED = ("fill_holes", "remove_islands")
"""Operations with a preview, which takes one more look."""


@dataclass(frozen=True)
class Tools:
    """Settings of the window: the part to paint, the tool, the brush's radius on the screen, and whether
    strokes include the room."""

    part: int | None = None
    tool: str = ""
    radius_px: float = 0.0
    room: bool = False

    def set_for(self, move: Move) -> "Tools":
        """The settings that a move needs."""
        tool = "piece" if move.kind in ("supervoxel", "grow") else move.kind
        depends_on_room = move.corners is not None and move.only is None and move.part != BACKGROUND
        return Tools(
            self.part if move.part is None else move.part,
            self.tool if tool == "key" else tool,
            move.radius_px * move.hand.zoom or self.radius_px,
            not move.keep_outline if depends_on_room else self.room,
        )

    def keys(self, before: "Tools") -> int:
        """Keys to press for these settings: one for each, but Ctrl and one for the radius."""
        changed = (self.part != before.part) + (self.tool != before.tool) + (self.room != before.room)
        return changed + 2 * (self.radius_px != before.radius_px)


def gesture(move: Move, corners: Float64 | None, keys: int) -> Gesture:
    """The gesture of a move: ``keys`` for the settings, then drawn along corners (k, 2), or clicked."""
    keys += move.keys + (move.only is not None)
    if corners is not None:
        path_px = length_px(corners, closed=move.kind == "lasso") * SCALE * move.hand.zoom
        return Gesture(move.kind, points=len(corners), path_px=path_px, keys=keys)
    pointed = int(move.pixel is not None and move.kind != "supervoxel")
    return Gesture(move.kind, clicks=move.clicks, points=pointed, keys=keys)


def move_s(move: Move, how: Gesture) -> float:
    """Seconds of a move by this gesture, with zooming in and out and looking at its preview."""
    wheel_s = 2 * move.hand.notches * NOTCH_S
    preview_s = MENTAL_S if move.operation in PREVIEWED else 0.0
    return gesture_s(how, move.hand.sd_px * SCALE * move.hand.zoom) + wheel_s + preview_s


def moves_s(moves: tuple[Move, ...], tools: Tools) -> float:
    """Seconds to find a mistake and repair it by these moves, drawn exactly."""
    seconds = MENTAL_S
    for move in moves:
        needed = tools.set_for(move)
        seconds += move_s(move, gesture(move, move.corners, needed.keys(tools)))
        tools = needed
    return seconds


def gesture_s(how: Gesture, hand_sd_px: float) -> float:
    """Seconds that a gesture takes, without the mental preparation for it.

    hand_sd_px: standard deviation of the hand's error while drawing, in the pixels of ``how.path_px``.
    The single point of a key is the place under the pointer. A click that grows a piece needs no pointing.
    """
    seconds = how.keys * KEY_S + how.clicks * CLICK_S
    if how.kind in ("lasso", "brush"):
        return seconds + POINT_S + CLICK_S + STEER_S * how.path_px / (EFFECTIVE_WIDTH * hand_sd_px)
    if how.kind == "rectangle":
        return seconds + 2 * POINT_S
    if how.kind in ("supervoxel", "polygon"):
        return seconds + how.clicks * POINT_S
    return seconds + (POINT_S if how.points else 0.0)
