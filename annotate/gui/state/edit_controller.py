"""Edits of the open frame: the effect of every key and stroke that changes labels. No GUI here."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.cleanup import filled, without_islands
from annotate.correction import select
from annotate.correction.correction import Correction
from annotate.correction.doubtful_places import Doubt, pixels_text
from annotate.correction.edit import Editor
from annotate.correction.replay import STATE_NAMES
from annotate.gui.state.drawing import Drawing
from annotate.gui.state.open_frame import Display, OpenFrame, marked
from annotate.gui.state.outcome import NOTHING, Outcome, described
from annotate.gui.state.point_colors import Colors, Look, Painting
from annotate.labelset.stroke import Gesture, Operation, Stroke
from annotate.scheme.colours import mark_rgb
from annotate.scheme.limbs import limb_names, limbs_of
from annotate.scheme.scheme import BACKGROUND, Scheme
from sensors.errors import CloudError

Giver = Literal["part", "other", "before"]
"""Source of the parts that strokes give: the chosen part, the compared set, or the frame before."""
VERDICT_TITLES = {"accept": "Accepted", "agree": "Agreed", "reject": "Rejected"}


@dataclass(frozen=True)
class _Preview:
    """Clean-up that was computed but not applied yet. parts: uint8 (h, w), the labels after it."""

    operation: Operation
    part: int | None
    parts: UInt8
    pixels: Int64


@dataclass(frozen=True)
class _Grown:
    """Piece that was painted last, and which the next click enlarges.

    part: its new part. parts: labels (h, w) before it was painted.
    """

    part: int
    pixels: Int64
    parts: UInt8


@dataclass
class EditController:
    """Edits of one frame, and the tools for them, which stay from frame to frame.

    part: the chosen part. giver: source of the parts that strokes assign. locks: parts that must not change.
    keys: number of keys pressed since the last stroke. preview: clean-up that waits for confirmation.
    """

    correction: Correction
    frame: OpenFrame
    scheme: Scheme = field(init=False)
    part: int = field(init=False)
    giver: Giver = "part"
    locks: set[int] = field(default_factory=set)
    display: Display = field(default_factory=Display)
    keys: int = 0
    preview: _Preview | None = None
    _grown: _Grown | None = None
    _doubt: int = -1

    def __post_init__(self) -> None:
        self.scheme = self.correction.labels.scheme
        self.part = self.scheme.parts[0].id
        self.open(self.frame)

    def open(self, frame: OpenFrame) -> None:
        """Switch to another frame; the tools keep their settings."""
        self.frame, self.preview, self._grown, self.keys, self._doubt = frame, None, None, 0, -1
        if frame.editor:
            frame.editor.locks = self.locks
        if self._given() is None:
            self.giver = "part"

    @property
    def parts(self) -> UInt8:
        """Return the current part ids (h, w) of the open frame."""
        return self.frame.parts

    # Display

    def shown(self) -> Bool:
        """Return flags (h * w,) of pixels that are drawn and can be chosen."""
        return self.display.shown(self.frame, self.part)

    def colors(self, look: Look, ground: tuple[int, int, int]) -> Colors:
        """Return a function from flat pixels to their current colours; a preview is marked. ground:
        background colour.
        """
        before = self.frame.before if self.display.onion else None
        painting = Painting(self.frame.scene, self.parts, look, self.display.visibility, ground, before)
        return marked(painting, self.preview.pixels, mark_rgb(self.scheme)) if self.preview else painting

    def fade(self, part: int) -> Outcome:
        """Switch the visibility of a part: shown, faded, hidden, and shown again."""
        how = self.display.fade(part)
        changed = np.flatnonzero((self.parts == part) & (self.frame.scene.labels.depth_mm > 0))
        return Outcome(f"{self.scheme.title(part).capitalize()} {how}", pixels=changed)

    def next_doubt(self) -> tuple[Outcome, Doubt | None]:
        """Return a text for the status line, and the next doubtfully labelled place; None if none is left."""
        if not (found := self.frame.doubts()):
            return Outcome("No doubtful place is left in this frame", "good"), None
        self._doubt = (self._doubt + 1) % len(found)
        doubt = found[self._doubt]
        return Outcome(f"Doubtful place {self._doubt + 1} of {len(found)}: {doubt.reason}", "warn"), doubt

    # Tools

    def toggle_lock(self, part: int) -> Outcome:
        """Lock a part, or unlock it."""
        self.locks ^= {part}
        state = "locked: it cannot gain or lose pixels" if part in self.locks else "unlocked"
        return Outcome(f"{self.scheme.title(part).capitalize()} {state}")

    def give_from(self, giver: Giver) -> Outcome:
        """Set the source of strokes' parts: the other set or the previous frame. The same source again resets
        it to the chosen part.
        """
        old, self.giver = self.giver, "part" if self.giver == giver else giver
        if self._given() is None:
            self.giver = old
            missing = {"other": self.frame.scene.no_other, "before": "no frame lies before this one"}[giver]
            return Outcome(missing[:1].upper() + missing[1:], "warn")
        return Outcome("")

    def _given(self) -> UInt8 | None:
        """Return the parts (h, w) that strokes assign; None where they are missing."""
        if self.giver == "other":
            return self.frame.scene.other
        return self.frame.before if self.giver == "before" else np.full(self.parts.shape, self.part, np.uint8)

    # Strokes with the mouse

    def stroke(self, drawing: Drawing, start: int | None, pixels: Int64) -> Outcome:
        """Assign the chosen part to the pixels of a drawn shape.

        start: the pixel under the first point, or None. Only pixels of the body change, because a lasso also
        includes the room behind. With ``drawing.room`` all pixels change. With ``drawing.only`` only the part
        at the start changes, even background.
        """
        self.editor()
        old = self.parts.ravel()[pixels]
        from_part = BACKGROUND if start is None else int(self.parts.ravel()[start])
        taken = old == from_part if drawing.only else drawing.room | (old != BACKGROUND)
        self._grown = None
        stroke = self._paint(pixels[taken], self._gesture(drawing))
        return self._outcome(stroke, self._why_nothing(pixels, taken, drawing))

    def piece(self, pixel: int | None, drawing: Drawing) -> Outcome:
        """Assign the chosen part to the supervoxel under a click; a second click there enlarges the piece."""
        self.editor()
        if pixel is None:
            return Outcome("No point lies here: click on the body", "warn")
        if grown := self._grows(pixel):
            return self._grow(grown, drawing)
        before = self.parts.copy()
        pixels = select.supervoxel(self.frame.scene.pieces, before, pixel)
        if not len(pixels):
            return Outcome("No piece lies here: draw round the place instead", "warn")
        done = self._outcome(
            self._paint(pixels, self._gesture(drawing)), self._already(int(before.flat[pixel]))
        )
        self._grown = _Grown(self.part, pixels, before) if len(done.pixels) else None
        return done

    def would_take(self, pixel: int | None) -> Int64:
        """Return the pixels (n,) that a click of the piece tool would change."""
        if pixel is None or self.frame.editor is None:
            return NOTHING
        if grown := self._grows(pixel):
            return np.setdiff1d(self._larger(grown), grown.pixels, assume_unique=True)
        pixels = select.supervoxel(self.frame.scene.pieces, self.parts, pixel)
        given = self._given()
        assert given is not None
        return np.asarray(pixels[given.ravel()[pixels] != self.parts.ravel()[pixels]])

    def _paint(self, pixels: Int64, how: Gesture) -> Stroke | None:
        given = self._given()
        if self.giver == "part" or given is None:
            return self.editor().paint(pixels, self.part, how)
        parts = self.parts.copy()
        parts.reshape(-1)[pixels] = given.ravel()[pixels]
        return self.editor().replace("paint", parts, None, how)

    def _grows(self, pixel: int) -> _Grown | None:
        """Return the last painted piece if a click on this pixel enlarges it."""
        grown = self._grown
        return grown if grown and grown.part == self.part and pixel in grown.pixels else None

    def _larger(self, grown: _Grown) -> Int64:
        scene = self.frame.scene
        return select.grow(scene.pieces, grown.parts, scene.labels.depth_mm, grown.pixels)

    def _grow(self, grown: _Grown, drawing: Drawing) -> Outcome:
        self.keys, pixels = 0, self._larger(grown)
        self._grown = _Grown(self.part, pixels, grown.parts)
        stroke = self._paint(pixels, drawing.gesture("grow"))
        return self._outcome(stroke, "It cannot grow further: its part ends here")

    # Keys for the place under the pointer

    def swap(self, pixel: int | None) -> Outcome:
        """Exchange left and right of the limb of which one side is under the pointer."""
        part = BACKGROUND if pixel is None else int(self.parts.flat[pixel])
        limb = next((limb for limb in limbs_of(self.scheme) if part in limb.ids), None)
        if limb is None:
            return Outcome(f"Point at {limb_names(self.scheme)} to swap left and right", "warn")
        stroke = self.editor().swap_left_right(limb.pairs, how=self._key(pixel))
        return self._outcome(stroke, f"This frame has no {limb.plural} to swap", limb.plural)

    def to_neighbour(self, pixel: int | None) -> Outcome:
        """Assign the connected patch under the pointer to the part with the longest contact."""
        if pixel is None or self.parts.flat[pixel] == BACKGROUND:
            return Outcome("Point at a patch of the body to give it to its neighbour", "warn")
        patch = select.patch(self.parts, self.frame.scene.labels.depth_mm, pixel)
        stroke = self.editor().to_neighbour(patch, how=self._key(pixel))
        return self._outcome(stroke, "It touches no other part")

    def merge(self, pixel: int | None) -> Outcome:
        """Assign the chosen part to all pixels of the part under the pointer."""
        source = BACKGROUND if pixel is None else int(self.parts.flat[pixel])
        if source in (BACKGROUND, self.part):
            return Outcome(f"Point at the part that should become {self.scheme.title(self.part)}", "warn")
        return self._outcome(self.editor().merge(source, self.part, how=self._key(pixel)), self._locked())

    def pick(self, pixel: int | None) -> Outcome:
        """Choose the part of the pixel under the pointer."""
        if pixel is None:
            return Outcome("Point at a part to choose it", "warn")
        self.part, self.giver = int(self.parts.flat[pixel]), "part"
        return Outcome(f"{self.scheme.title(self.part).capitalize()} chosen")

    # Whole frame; a clean-up is previewed first

    def fill_holes(self) -> Outcome:
        """Mark the holes of the chosen part at the first call, fill them at the second."""
        parts = filled(self.parts, self.editor().depth_mm, self.part)
        return self._previewed("fill_holes", self.part, parts)

    def remove_islands(self) -> Outcome:
        """Mark the islands of all parts at the first call, assign them to their surroundings at the
        second.
        """
        return self._previewed("remove_islands", None, without_islands(self.parts, self.editor().depth_mm))

    def copy_previous(self) -> Outcome:
        """Copy the parts of the previous frame to pixels that show the body in both frames."""
        if self.frame.before is None:
            return Outcome("No frame lies before this one", "warn")
        stroke = self.editor().copy_previous(self.frame.before, self._key(keys=2))
        return self._outcome(stroke, "The frame before has the same labels")

    def cancel(self) -> Outcome:
        """Drop a preview."""
        self._grown = None
        pixels = self._drop_preview()
        return Outcome("Preview cancelled" if len(pixels) else "", pixels=pixels)

    def undo(self) -> Outcome:
        """Undo the last stroke or verdict."""
        if (cancelled := self.cancel()).text:
            return cancelled
        stroke = self.editor().undo(self._key(keys=2))
        if stroke and not stroke.changes:
            state = STATE_NAMES[self.correction.state(self.frame.frame_id)]
            return Outcome(f"Verdict taken back: the frame is {state}", "good")
        return self._outcome(stroke, "Nothing to undo in this frame")

    def redo(self) -> Outcome:
        """Redo the last undone stroke or verdict."""
        editor = self.editor()
        stroke = editor.redo(self._key(keys=3))
        if stroke and not stroke.changes:
            return Outcome(f"{VERDICT_TITLES[editor.history.done[-1].operation]} again", "good")
        return self._outcome(stroke, "Nothing to redo in this frame")

    def editor(self) -> Editor:
        """Return the open frame's editor. Raises CloudError where the set is read-only."""
        if self.frame.editor is None:
            raise CloudError("This label set is open read-only: close it and open it without --read-only")
        return self.frame.editor

    # Outcomes

    def _previewed(self, operation: Operation, part: int | None, parts: UInt8) -> Outcome:
        editor, preview = self.editor(), self.preview
        self.keys += 1
        if preview and (preview.operation, preview.part) == (operation, part):
            self.preview = None
            stroke = editor.replace(operation, preview.parts, part, self._key(keys=self.keys))
            return self._outcome(stroke, "Nothing to change")
        dropped, pixels = self.cancel().pixels, editor.preview(parts)
        name = "holes" if operation == "fill_holes" else "islands"
        name += f" in {self.scheme.title(part)}" if part is not None else ""
        if not len(pixels):
            return Outcome(f"This frame has no {name}", pixels=dropped)
        self.preview = _Preview(operation, part, parts, pixels)
        text = f"{pixels_text(len(pixels))} of {name} marked: the same key applies it, Esc cancels"
        return Outcome(text, "warn", np.union1d(dropped, pixels))

    def _outcome(self, stroke: Stroke | None, nothing: str, limb: str = "") -> Outcome:
        """Return the outcome of an operation, and drop an outdated preview.

        nothing: text for an operation that changed nothing. limb: name of the limb, for a swap.
        """
        if stroke is None:
            return Outcome(nothing, "warn")
        pixels = np.union1d(stroke.pixels, self._drop_preview())
        return Outcome(described(stroke, self.scheme, limb), pixels=pixels)

    def _drop_preview(self) -> Int64:
        """Drop a preview; return the pixels (n,) that were marked."""
        preview, self.preview = self.preview, None
        return preview.pixels if preview else NOTHING

    def _why_nothing(self, pixels: Int64, taken: Bool, drawing: Drawing) -> str:
        if not len(pixels):
            return "No point lies inside"
        if not taken.any():
            if drawing.only:
                return "Nothing inside belongs to the part at the start"
            return "Only the room is inside: hold Shift and start on it to label it"
        return self._locked() if self.locks else self._already(self.part)

    def _already(self, part: int) -> str:
        return f"This is already {self.scheme.title(self.part)}" if part == self.part else self._locked()

    def _locked(self) -> str:
        names = ", ".join(self.scheme.title(part) for part in sorted(self.locks))
        locked = f"Nothing changed: {names} locked (Shift and the part's key unlocks)"
        return locked if names else "Nothing to change"

    def _key(self, pixel: int | None = None, keys: int = 1) -> Gesture:
        self.keys = 0
        return Gesture("key", points=int(pixel is not None), keys=keys)

    def _gesture(self, drawing: Drawing) -> Gesture:
        keys, self.keys = self.keys + drawing.held_keys, 0
        return drawing.gesture("supervoxel" if drawing.tool == "piece" else drawing.tool, keys)
