"""The frame on the desk and the tools beside it: what every key and stroke does. No window here."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.cleanup import filled, without_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction import select
from annotate.correction.doubtful_places import part_title as title
from annotate.correction.doubtful_places import pixels_text
from annotate.correction.edit import ARMS, LEGS, Editor
from annotate.correction.follow import followed
from annotate.correction.nearby import corrected_nearby, frames_text
from annotate.correction.propagate import FRAMES_COMPARED, CorrectedFrame, most_alike, propagate
from annotate.correction.replay import STATE_NAMES, rejected_by
from annotate.frame_labels import FrameLabels
from annotate.gui.state.drawing import Drawing
from annotate.gui.state.outcome import NOTHING, VERDICT_TITLES, Done, described, rejected_text
from annotate.gui.state.scene import FrameScene
from annotate.gui.state.view_state import Preview, Sight
from annotate.labelset.stroke import Gesture, Operation, Stroke
from annotate.parts import BACKGROUND
from sensors.errors import CloudError

Giver = Literal["part", "other", "before"]
"""What strokes give: the chosen part, or each pixel's part in the compared set or in the frame before."""


@dataclass(frozen=True)
class _Grown:
    """The piece painted last, which a click grows. part: its new part; parts: labels (h, w) before it."""

    part: int
    pixels: Int64
    parts: UInt8


@dataclass(frozen=True)
class Carried:
    """Labels of a frame by other frames' corrections. parts: (h, w).

    sources: ids of the corrected frames that voted.
    """

    parts: UInt8
    sources: tuple[str, ...]


@dataclass
class Desk(Sight):
    """One frame being corrected.

    giver: what strokes give. locks: parts that stay as they are. carrying: whether every frame that accepting
    opens gets the corrections of others without a key. keys: number of keys pressed since the last stroke.
    """

    giver: Giver = "part"
    locks: set[int] = field(default_factory=set)
    carrying: bool = False
    keys: int = 0
    _grown: _Grown | None = None
    _clouds: dict[str, ThermalCloud] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.put(self.scene, self.editor, self.before)

    def put(self, scene: FrameScene, editor: Editor | None, before: UInt8 | None) -> None:
        """Lay another frame on the desk; the tools stay as they are."""
        self.scene, self.editor, self.before = scene, editor, before
        self.preview, self._grown, self.keys, self._doubt = None, None, 0, -1
        self._clouds.pop(scene.labels.frame_id, None)
        self._clouds[scene.labels.frame_id] = scene.cloud
        for frame_id in list(self._clouds)[: -FRAMES_COMPARED - 1]:
            del self._clouds[frame_id]
        if editor:
            editor.locks = self.locks
        if self._given() is None:
            self.giver = "part"

    def toggle_lock(self, part: int) -> Done:
        """Lock a part, or unlock it."""
        self.locks ^= {part}
        state = "locked: it cannot gain or lose pixels" if part in self.locks else "unlocked"
        return Done(f"{title(part).capitalize()} {state}")

    # Strokes with the mouse

    def give_from(self, giver: Giver) -> Done:
        """Let strokes take over the parts of the other set or of the frame before; again: the chosen part."""
        wanted: Giver = "part" if self.giver == giver else giver
        old, self.giver = self.giver, wanted
        if self._given() is None:
            self.giver = old
            missing = {"other": self.scene.no_other, "before": "there is no frame before this one"}[giver]
            return Done(missing[:1].upper() + missing[1:], "warn")
        return Done("")

    def _given(self) -> UInt8 | None:
        """Parts (h, w) that strokes give; None where they are missing."""
        if self.giver == "other":
            return self.scene.other
        return self.before if self.giver == "before" else np.full(self.parts.shape, self.part, np.uint8)

    def stroke(self, drawing: Drawing, start: int | None, pixels: Int64) -> Done:
        """Give the pixels of a drawn shape the chosen part.

        start: the pixel under its first point, or None. Only pixels of the body change, so that no lasso
        includes the room behind; with ``drawing.room`` all do; with ``drawing.only`` those of the part at
        the start, even if that is the room.
        """
        self._editor()
        old = self.parts.ravel()[pixels]
        from_part = BACKGROUND if start is None else int(self.parts.ravel()[start])
        taken = old == from_part if drawing.only else drawing.room | (old != BACKGROUND)
        self._grown = None
        return self._did(
            self._paint(pixels[taken], self._gesture(drawing)), self._why_nothing(pixels, taken, drawing)
        )

    def piece(self, pixel: int | None, drawing: Drawing) -> Done:
        """Give the piece under a click the chosen part; grow the piece that was just painted."""
        self._editor()
        if pixel is None:
            return Done("There is no point here: click on the body", "warn")
        if grown := self._grows(pixel):
            return self._grow(grown, drawing)
        before = self.parts.copy()
        pixels = select.supervoxel(self.scene.pieces, before, pixel)
        if not len(pixels):
            return Done("There is no piece here: draw round it instead", "warn")
        done = self._did(self._paint(pixels, self._gesture(drawing)), self._already(int(before.flat[pixel])))
        self._grown = _Grown(self.part, pixels, before) if len(done.pixels) else None
        return done

    def would_take(self, pixel: int | None) -> Int64:
        """Pixels (n,) that a click of the piece tool would change: the piece, or what growing adds."""
        if pixel is None or self.editor is None:
            return NOTHING
        if grown := self._grows(pixel):
            return np.setdiff1d(self._larger(grown), grown.pixels, assume_unique=True)
        pixels = select.supervoxel(self.scene.pieces, self.parts, pixel)
        given = self._given()
        assert given is not None
        return np.asarray(pixels[given.ravel()[pixels] != self.parts.ravel()[pixels]])

    def _paint(self, pixels: Int64, how: Gesture) -> Stroke | None:
        given = self._given()
        if self.giver == "part" or given is None:
            return self._editor().paint(pixels, self.part, how)
        parts = self.parts.copy()
        parts.reshape(-1)[pixels] = given.ravel()[pixels]
        return self._editor().replace("paint", parts, None, how)

    def _grows(self, pixel: int) -> _Grown | None:
        """The piece that a click on this pixel grows."""
        grown = self._grown
        return grown if grown and grown.part == self.part and pixel in grown.pixels else None

    def _larger(self, grown: _Grown) -> Int64:
        return select.grow(self.scene.pieces, grown.parts, self.scene.labels.depth_mm, grown.pixels)

    def _grow(self, grown: _Grown, drawing: Drawing) -> Done:
        pixels = self._larger(grown)
        self.keys = 0
        self._grown = _Grown(self.part, pixels, grown.parts)
        return self._did(
            self._paint(pixels, drawing.gesture("grow")), "It cannot grow further: its part ends here"
        )

    # Keys that work on the place under the pointer

    def swap(self, pixel: int | None) -> Done:
        """Exchange left and right of the limb under the pointer."""
        part = BACKGROUND if pixel is None else int(self.parts.flat[pixel])
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
        self.part, self.giver = int(self.parts.flat[pixel]), "part"
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
        text = f"{pixels_text(len(pixels))} of {name} marked: the same key applies it, Esc cancels"
        return Done(text, "warn", np.union1d(dropped, pixels))

    # From other frames. What takes long is computed first, in a thread, and then applied.

    def copied(self, frame_id: str) -> Callable[[], UInt8]:
        """A computation of the parts (h, w) of another frame, moved onto this one."""
        target, camera = self._target(), self.scene.cloud.camera
        return lambda: followed(self._corrected([frame_id])[0], target, camera)

    def carried(self) -> Callable[[], Carried]:
        """Return a computation of the labels after corrections nearby (``corrected_nearby``)."""
        target, camera, cloud = self._target(), self.correction.labels.intrinsics, self.scene.cloud

        def compute() -> Carried:
            near = self._corrected(corrected_nearby(self.correction, target.frame_id))
            voting = most_alike(near, target)
            sources = tuple(frame.corrected.frame_id for frame in voting if frame.changed)
            return Carried(propagate(voting, target, camera, cloud), sources)

        return compute

    def copy_previous(self, parts: UInt8) -> Done:
        """Take over what ``copied`` has computed."""
        stroke = self._editor().copy_previous(parts, how=self._key(keys=2))
        return self._did(stroke, "The frame before has the same labels")

    def propagate(self, carried: Carried, keys: int = 2) -> Done:
        """Take over what ``carried`` has computed."""
        stroke = self._editor().propagate(carried.parts, self._key(keys=keys))
        if stroke is None:
            return Done("The corrections of the frames nearby change nothing here", "warn")
        done = self._did(stroke, "")
        sources = f"Carried over from {frames_text(carried.sources)}"
        return done._replace(text=done.text.replace("Carried over", sources, 1))

    def toggle_carrying(self) -> Done:
        """Carry corrections over to every frame that accepting opens, or only by the key."""
        self.carrying = not self.carrying
        how = "in each frame opened by Accept" if self.carrying else "only by the command"
        return Done(f"Corrections are carried over {how}")

    def _target(self) -> FrameLabels:
        self._editor()
        return replace(self.scene.labels, parts=self.parts.copy())

    def _corrected(self, frame_ids: Sequence[str]) -> list[CorrectedFrame]:
        correction = self.correction
        return [
            CorrectedFrame(correction.begun(i), correction.frame(i), self._clouds.get(i)) for i in frame_ids
        ]

    # Back and forth, verdicts

    def undo(self) -> Done:
        """Take back the last stroke or verdict."""
        if (cancelled := self.cancel()).text:
            return cancelled
        stroke = self._editor().undo(self._key(keys=2))
        if stroke and not stroke.changes:
            state = STATE_NAMES[self.correction.state(self.scene.labels.frame_id)]
            return Done(f"Verdict taken back: the frame is {state}", "good")
        return self._did(stroke, "Nothing to undo in this frame")

    def redo(self) -> Done:
        """Do again what was undone last."""
        editor = self._editor()
        stroke = editor.redo(self._key(keys=3))
        if stroke and not stroke.changes:
            return Done(f"{VERDICT_TITLES[editor.history.done[-1].operation]} again", "good")
        return self._did(stroke, "Nothing to redo in this frame")

    @property
    def rejected(self) -> bool:
        """Whether the frame stands rejected."""
        return self.correction.state(self.scene.labels.frame_id) == "rejected"

    def accept(self) -> Done:
        """Accept the frame, or agree with another person's verdict; a rejection stays."""
        editor, verdict = self._editor(), self.correction.next_verdict(self.scene.labels.frame_id)
        if verdict != "none":
            editor.judge(verdict)
        texts = {"accept": "Accepted", "agree": "Agreed", "none": "Already accepted"}
        if self.rejected:
            texts = {"agree": "Agreed with the rejection", "none": "It stays rejected"}
        return Done(texts[verdict], "good")

    def overrule(self) -> Done | None:
        """Accept a frame that stands rejected; None where it is not rejected."""
        if not self.rejected:
            return None
        rejection = rejected_by(self.correction.journal.strokes(self.scene.labels.frame_id))
        self._editor().judge("accept", how=Gesture("key", keys=3))
        whose = f" of {rejection.who}" if rejection else ""
        return Done(f"Accepted: the rejection{whose} is overruled", "good")

    def reject(self, reason: str) -> Done:
        """Reject the frame, for a reason."""
        self._editor().judge("reject", reason, Gesture("key", keys=2))
        return Done(rejected_text(reason), "warn")

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
                return "Nothing inside belongs to the part at the start"
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
