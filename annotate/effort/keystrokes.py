"""Time of a person's work by the keystroke-level model, with the steering law for drawing.

Operators and times: Card, Moran & Newell, The Psychology of Human-Computer Interaction, 1983, chapter 8. Keys
lie under the left hand while the right one holds the mouse (``gui.state.keys``), so the model's homing time
is 0. Mental preparation is counted before each repaired patch, and once at the end. Source: Kieras, Using the
keystroke-level model to estimate execution times, 2001. ``Annotator(at_once=4)`` counts one preparation for
up to four patches of one part (Cowan, The magical number 4, 2001). docs/adr/0009 gives both results.
"""

from dataclasses import dataclass

from annotate.array_types import Float64
from annotate.effort.hand import length_px
from annotate.effort.repairs import SCALE, Move
from annotate.labelset.stroke import Gesture
from annotate.scheme.scheme import BACKGROUND

KEY_S = 0.2  # key of an average skilled typist; Ctrl or Shift is a key of its own; also a notch of the wheel
POINT_S = 1.1  # pointing with the mouse
CLICK_S = 0.2  # mouse button pressed and released
MENTAL_S = 1.35  # mental preparation
STEER_S = 0.1  # a path as long as wide: slope of the steering law (Accot & Zhai, CHI 1997); our assumption
EFFECTIVE_WIDTH = 4.133  # path's width in standard deviations of the hand's error (MacKenzie 1992)
PREVIEWED = ("fill_holes", "remove_islands")  # operations with a preview, which takes one more look


@dataclass(frozen=True)
class Tools:
    """Settings of the window: part, tool, brush radius on the screen. room: True if strokes change
    background.
    """

    part: int | None = None
    tool: str = ""
    radius_px: float = 0.0
    room: bool = False

    def set_for(self, move: Move) -> "Tools":
        """Return these settings, changed where the annotator must change them before a move."""
        tool = "piece" if move.kind in ("supervoxel", "grow") else move.kind
        depends_on_room = move.corners is not None and move.only is None and move.part != BACKGROUND
        return Tools(
            self.part if move.part is None else move.part,
            self.tool if tool == "key" else tool,
            move.radius_px * move.hand.zoom or self.radius_px,
            not move.keep_outline if depends_on_room else self.room,
        )

    def keys(self, before: "Tools") -> int:
        """Return the number of keys that change the settings ``before`` to these: one for each, two for the
        radius.
        """
        changed = (self.part != before.part) + (self.tool != before.tool) + (self.room != before.room)
        return changed + 2 * (self.radius_px != before.radius_px)


def gesture(move: Move, corners: Float64 | None, keys: int) -> Gesture:
    """Return the gesture of a move, as the journal stores it.

    corners: (k, 2) as drawn; None = clicks. keys: number of keys for the settings.
    """
    keys += move.keys + (move.only is not None)
    if corners is not None:
        path_px = length_px(corners, closed=move.kind == "lasso") * SCALE * move.hand.zoom
        return Gesture(move.kind, points=len(corners), path_px=path_px, keys=keys)
    pointed = int(move.pixel is not None and move.kind != "supervoxel")
    return Gesture(move.kind, clicks=move.clicks, points=pointed, keys=keys)


def move_s(move: Move, how: Gesture) -> float:
    """Return the seconds of a move by a gesture, including zooming in and out and the check of a preview."""
    wheel_s = 2 * move.hand.notches * KEY_S
    preview_s = MENTAL_S if move.operation in PREVIEWED else 0.0
    return gesture_s(how, move.hand.sd_px * SCALE * move.hand.zoom) + wheel_s + preview_s


def moves_s(moves: tuple[Move, ...], tools: Tools) -> float:
    """Return the seconds to find a mistake and repair it by moves, drawn without error."""
    seconds = MENTAL_S
    for move in moves:
        needed = tools.set_for(move)
        seconds += move_s(move, gesture(move, move.corners, needed.keys(tools)))
        tools = needed
    return seconds


def gesture_s(how: Gesture, hand_sd_px: float) -> float:
    """Return the seconds of a gesture without mental preparation.

    hand_sd_px: standard deviation of the drawing hand's error, in the pixels of ``how.path_px``. A key acts
    on the place under the pointer, so pointing is counted. A click that grows a piece needs no pointing.
    """
    seconds = how.keys * KEY_S + how.clicks * CLICK_S
    if how.kind in ("lasso", "brush"):
        return seconds + POINT_S + CLICK_S + STEER_S * how.path_px / (EFFECTIVE_WIDTH * hand_sd_px)
    if how.kind == "rectangle":
        return seconds + 2 * POINT_S
    if how.kind in ("supervoxel", "polygon"):
        return seconds + how.clicks * POINT_S
    return seconds + (POINT_S if how.points else 0.0)
