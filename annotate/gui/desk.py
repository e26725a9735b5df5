"""The frame on the desk and the tools beside it: what every key and stroke does. No window here."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.cleanup import filled, without_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction import select
from annotate.correction.correction import Correction
from annotate.correction.edit import ARMS, LEGS, Editor
from annotate.correction.propagate import FRAMES_COMPARED, CorrectedFrame, propagate
from annotate.gui.colors import Colouring, Visibility, colourings, point_colors
from annotate.gui.drawing import Drawing
from annotate.gui.outcome import NOTHING, Done, described, title
from annotate.gui.scene import FrameScene
from annotate.labelset.stroke import Gesture, Operation, Stroke
from annotate.parts import BACKGROUND, PARTS, UNDEFINED
from sensors.errors import CloudError

PREVIEW_RGB = (255, 255, 0)
"""Colour of the pixels that a clean-up would change: no part has it. Chosen by eye."""


@dataclass(frozen=True)
class Preview:
    """A clean-up that was computed and not yet applied. parts: uint8 (h, w), the labels after it."""

    operation: Operation
    part: int | None
    parts: UInt8
    pixels: Int64


@dataclass(frozen=True)
class _Grown:
    """The piece painted last, which a click grows. part: its new part; parts: labels (h, w) before it."""

    part: int
    pixels: Int64
    parts: UInt8


@dataclass
class Desk:
    """One frame being corrected.

    editor: None where the set is open read-only. part: the chosen one. visibility: parts that are faded or
    hidden. alone: whether the chosen part is shown alone. carrying: whether every frame that accepting opens
    gets the corrections of others without a key. keys: number of keys pressed since the last stroke.
    """

    correction: Correction
    scene: FrameScene
    editor: Editor | None
    part: int = 1
    colouring: Colouring = "part"
    visibility: dict[int, Visibility] = field(default_factory=dict)
    locks: set[int] = field(default_factory=set)
    alone: bool = False
    carrying: bool = False
    keys: int = 0
    preview: Preview | None = None
    _grown: _Grown | None = None
    _clouds: dict[str, ThermalCloud] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.put(self.scene, self.editor)

    def put(self, scene: FrameScene, editor: Editor | None) -> None:
        """Lay another frame on the desk; the tools stay as they are."""
        self.scene, self.editor, self.preview, self._grown, self.keys = scene, editor, None, None, 0
        self._clouds.pop(scene.labels.frame_id, None)
        self._clouds[scene.labels.frame_id] = scene.cloud
        for frame_id in list(self._clouds)[: -FRAMES_COMPARED - 1]:
            del self._clouds[frame_id]
        if editor:
            editor.locks = self.locks
        if self.colouring not in colourings(scene):
            self.colouring = "part"

    @property
    def parts(self) -> UInt8:
        """Part ids (h, w) as they stand."""
        return self.editor.parts if self.editor else self.scene.labels.parts

    def counts(self) -> dict[int, int]:
        """Pixels with depth by part id."""
        numbers = np.bincount(self.parts[self.scene.labels.depth_mm > 0], minlength=256)
        return {part: int(numbers[part]) for part in (*range(len(PARTS)), UNDEFINED)}

    def shown(self) -> Bool:
        """Pixels (h * w,) that are drawn and can be chosen."""
        hidden = np.zeros(256, np.bool_)
        if self.alone:
            hidden[:] = True
            hidden[self.part] = False
        hidden[[part for part, how in self.visibility.items() if how == "hidden"]] = True
        return np.asarray((self.scene.labels.depth_mm.ravel() > 0) & ~hidden[self.parts.ravel()])

    def colors(self, pixels: Int64, ground: tuple[int, int, int]) -> UInt8:
        """Colours (n, 3) of flat pixels (n,) on a ground, a preview marked."""
        rgb = point_colors(self.scene, self.parts, pixels, self.colouring, self.visibility, ground)
        if self.preview:
            rgb[np.isin(pixels, self.preview.pixels)] = PREVIEW_RGB
        return rgb

    def next_colouring(self) -> Colouring:
        """The next colouring for which the frame has data."""
        there = colourings(self.scene)
        return there[(there.index(self.colouring) + 1) % len(there)]

    def toggle_lock(self, part: int) -> Done:
        """Lock a part, or unlock it."""
        self.locks ^= {part}
        state = "locked: it cannot gain or lose pixels" if part in self.locks else "unlocked"
        return Done(f"{title(part).capitalize()} {state}")

    def fade(self, part: int) -> Done:
        """Switch a part from shown to faded, to hidden, and to shown again."""
        turn: dict[Visibility, Visibility] = {"shown": "faded", "faded": "hidden", "hidden": "shown"}
        how = self.visibility[part] = turn[self.visibility.get(part, "shown")]
        changed = np.flatnonzero((self.parts == part) & (self.scene.labels.depth_mm > 0))
        return Done(f"{title(part).capitalize()} {how}", pixels=changed)

    # Strokes with the mouse

    def stroke(self, drawing: Drawing, start: int | None, pixels: Int64) -> Done:
        """Give the pixels of a drawn shape the chosen part.

        start: the pixel under its first point, or None. Only pixels of the body change, so that no lasso
        includes the room behind; with ``drawing.room`` all do; with ``drawing.only`` those of the part at
        the start, even if that is the room.
        """
        editor = self._editor()
        old = self.parts.ravel()[pixels]
        from_part = BACKGROUND if start is None else int(self.parts.ravel()[start])
        taken = old == from_part if drawing.only else drawing.room | (old != BACKGROUND)
        self._grown = None
        stroke = editor.paint(pixels[taken], self.part, self._gesture(drawing))
        return self._did(stroke, self._why_nothing(pixels, taken, drawing))

    def piece(self, pixel: int | None, drawing: Drawing) -> Done:
        """Give the piece under a click the chosen part; grow the piece that was just painted."""
        editor = self._editor()
        if pixel is None:
            return Done("There is no point here: click on the body", "warn")
        if self._grown and self._grown.part == self.part and pixel in self._grown.pixels:
            return self._grow(self._grown, drawing)
        before = self.parts.copy()
        pixels = select.supervoxel(self.scene.pieces, before, pixel)
        if not len(pixels):
            return Done("There is no piece here: draw round it instead", "warn")
        stroke = editor.paint(pixels, self.part, self._gesture(drawing))
        done = self._did(stroke, self._already(int(before.flat[pixel])))
        self._grown = _Grown(self.part, pixels, before) if len(done.pixels) else None
        return done

    def _grow(self, grown: _Grown, drawing: Drawing) -> Done:
        pixels = select.grow(self.scene.pieces, grown.parts, self.scene.labels.depth_mm, grown.pixels)
        self.keys = 0
        self._grown = _Grown(self.part, pixels, grown.parts)
        stroke = self._editor().paint(pixels, self.part, drawing.gesture("grow"))
        return self._did(stroke, "It cannot grow further: its part ends here")

    # Keys that work on the place under the pointer

    def swap(self, pixel: int | None) -> Done:
        """Exchange left and right: of the limb under the pointer, or else of the chosen part's."""
        part = self.part if pixel is None or not self.parts.flat[pixel] else int(self.parts.flat[pixel])
        pairs = next((limb for limb in (ARMS, LEGS) if part in np.ravel(limb)), None)
        if pairs is None:
            return Done("Point at an arm or a leg to swap left and right", "warn")
        limb = "arms" if pairs is ARMS else "legs"
        stroke = self._editor().swap_left_right(pairs, how=self._key(pixel))
        return self._did(stroke, f"There are no {limb} to swap", limb)

    def to_neighbour(self, pixel: int | None) -> Done:
        """Give the connected patch under the pointer to the part it touches most."""
        if pixel is None or self.parts.flat[pixel] == BACKGROUND:
            return Done("Point at a patch of the body to give it to its neighbour", "warn")
        patch = select.patch(self.parts, self.scene.labels.depth_mm, pixel)
        return self._did(self._editor().to_neighbour(patch, how=self._key(pixel)), "It touches no other part")

    def merge(self, pixel: int | None) -> Done:
        """Turn the part under the pointer into the chosen one."""
        source = BACKGROUND if pixel is None else int(self.parts.flat[pixel])
        if source in (BACKGROUND, self.part):
            return Done(f"Point at the part that should become {title(self.part)}", "warn")
        return self._did(self._editor().merge(source, self.part, how=self._key(pixel)), self._locked())

    def pick(self, pixel: int | None) -> Done:
        """Choose the part under the pointer."""
        if pixel is None:
            return Done("Point at a part to choose it", "warn")
        self.part = int(self.parts.flat[pixel])
        return Done(f"{title(self.part).capitalize()} chosen")

    # Clean-up, previewed first

    def fill_holes(self) -> Done:
        """Show the holes of the chosen part at the first call, fill them at the second."""
        parts = filled(self.parts, self._editor().depth_mm, self.part)
        return self._previewed("fill_holes", self.part, parts)

    def remove_islands(self) -> Done:
        """Show the islands of all parts at the first call, give them to their surroundings at the second."""
        return self._previewed("remove_islands", None, without_islands(self.parts, self._editor().depth_mm))

    def cancel(self) -> Done:
        """Drop a preview."""
        self._grown = None
        pixels = self._drop_preview()
        return Done("Preview cancelled" if len(pixels) else "", pixels=pixels)

    def _previewed(self, operation: Operation, part: int | None, parts: UInt8) -> Done:
        editor, shown = self._editor(), self.preview
        self.keys += 1
        if shown and (shown.operation, shown.part) == (operation, part):
            self.preview = None
            stroke = editor.replace(operation, shown.parts, part, self._key(keys=self.keys))
            return self._did(stroke, "Nothing to change")
        dropped = self.cancel().pixels
        pixels = editor.preview(parts)
        name = "holes" if operation == "fill_holes" else "islands"
        name += f" in {title(part)}" if part is not None else ""
        if not len(pixels):
            return Done(f"There are no {name}", pixels=dropped)
        self.preview = Preview(operation, part, parts, pixels)
        text = f"{len(pixels):,} pixels of {name} marked: the same key applies it, Esc cancels"
        return Done(text, "warn", np.union1d(dropped, pixels))

    # From other frames

    def copy_previous(self, frame_id: str) -> Done:
        """Take the parts of another frame where it shows the same surface."""
        previous = self.correction.frame(frame_id)
        stroke = self._editor().copy_previous(previous, how=self._key(keys=2))
        return self._did(stroke, "The previous frame has the same labels")

    def toggle_carrying(self) -> Done:
        """Carry corrections over to every frame that accepting opens, or only by the key."""
        self.carrying = not self.carrying
        where = "to every next frame" if self.carrying else "only by the key"
        return Done(f"Corrections are carried over {where}")

    def carry(self, frame_ids: Sequence[str]) -> Done:
        """As ``propagate``, for a frame that was just opened and that nobody edited: without a key."""
        if self.correction.state(self.scene.labels.frame_id) != "auto":
            return Done("")
        return self.propagate(frame_ids, keys=0)

    def propagate(self, frame_ids: Sequence[str], keys: int = 2) -> Done:
        """Carry the corrections of other frames over, the nearest first."""
        labels, target = self.correction.labels, replace(self.scene.labels, parts=self.parts.copy())
        automatic = (labels.read(i, original=labels.has_original(i)) for i in frame_ids)
        frames = [
            CorrectedFrame(before, self.correction.frame(i), self._clouds.get(i))
            for before, i in zip(automatic, frame_ids, strict=True)
        ]
        parts = propagate(frames, target, labels.intrinsics, self.scene.cloud)
        stroke = self._editor().propagate(parts, self._key(keys=keys))
        return self._did(stroke, "The corrections of the frames nearby change nothing here")

    # Back and forth, verdicts

    def undo(self) -> Done:
        """Take back the last stroke."""
        if (cancelled := self.cancel()).text:
            return cancelled
        return self._did(self._editor().undo(self._key(keys=2)), "Nothing to undo")

    def redo(self) -> Done:
        """Do again what was undone last."""
        return self._did(self._editor().redo(self._key(keys=3)), "Nothing to redo")

    def accept(self) -> Done:
        """Accept the frame, or agree where another person accepted it."""
        editor, verdict = self._editor(), self.correction.next_verdict(self.scene.labels.frame_id)
        if verdict != "none":
            editor.judge(verdict)
        texts = {"accept": "Accepted", "agree": "Agreed", "none": "Already accepted"}
        return Done(texts[verdict], "good")

    def reject(self, reason: str) -> Done:
        """Reject the frame, for a reason."""
        self._editor().judge("reject", reason, Gesture("key", keys=2))
        return Done(f"Rejected: {reason}", "warn")

    # Within

    def _editor(self) -> Editor:
        if self.editor is None:
            raise CloudError("This label set is open read-only: close it and open it without --read-only")
        return self.editor

    def _did(self, stroke: Stroke | None, nothing: str, limb: str = "") -> Done:
        """The outcome of an operation; a preview of the labels before it is no longer valid."""
        if stroke is None:
            return Done(nothing, "warn")
        return Done(described(stroke, limb), pixels=np.union1d(stroke.pixels, self._drop_preview()))

    def _drop_preview(self) -> Int64:
        """The pixels (n,) that were marked."""
        shown, self.preview = self.preview, None
        return shown.pixels if shown else NOTHING

    def _why_nothing(self, pixels: Int64, taken: Bool, drawing: Drawing) -> str:
        if not len(pixels):
            return "There is no point inside"
        if not taken.any():
            if drawing.only:
                return "Nothing inside is of the part at the start"
            return "Only the room is inside: hold Shift and start on it to add it to the body"
        return self._locked() if self.locks else self._already(self.part)

    def _already(self, part: int) -> str:
        return f"This is already {title(self.part)}" if part == self.part else self._locked()

    def _locked(self) -> str:
        names = ", ".join(title(part) for part in sorted(self.locks))
        locked = f"Nothing changed: {names} locked (Shift and the part's key unlocks)"
        return locked if names else "Nothing to change"

    def _key(self, pixel: int | None = None, keys: int = 1) -> Gesture:
        self.keys = 0
        return Gesture("key", points=int(pixel is not None), keys=keys)

    def _gesture(self, drawing: Drawing) -> Gesture:
        keys, self.keys = self.keys + drawing.held_keys, 0
        return drawing.gesture("supervoxel" if drawing.tool == "piece" else drawing.tool, keys)
