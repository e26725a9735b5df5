"""The frame on the desk and the tools beside it: what every key and stroke does. No window here."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from annotate.cleanup import filled, without_islands
from annotate.cloud.grid import components
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction import select
from annotate.correction.correction import Correction
from annotate.correction.edit import ARMS, LEGS, Editor
from annotate.correction.propagate import FRAMES_COMPARED, CorrectedFrame, propagate
from annotate.frame_labels import FrameLabels
from annotate.gui.colors import Colouring, Visibility, colourings, point_colors
from annotate.gui.drawing import Drawing
from annotate.gui.scene import Scene
from annotate.gui.sentences import title, told
from annotate.labelset.stroke import VERDICTS, Gesture, Operation, Stroke
from annotate.parts import BACKGROUND, PARTS, UNDEFINED
from sensors.errors import CloudError

Tone = Literal["plain", "good", "warn", "bad"]
PREVIEW_RGB = (255, 255, 0)
"""What a clean-up would change: no part has this colour."""
NOTHING: NDArray[np.int64] = np.empty(0, np.int64)


@dataclass(frozen=True)
class Done:
    """What came of a key or a stroke: the pixels (n,) that look different now, and a sentence."""

    pixels: NDArray[np.int64]
    says: str
    tone: Tone = "plain"


@dataclass(frozen=True)
class Preview:
    """A clean-up that was computed and not yet applied. parts: uint8 (h, w) it leads to."""

    operation: Operation
    part: int | None
    parts: NDArray[np.uint8]
    pixels: NDArray[np.int64]


@dataclass(frozen=True)
class _Grown:
    """The piece given ``part`` last: a click on it again grows it over the labels (h, w) from before."""

    part: int
    pixels: NDArray[np.int64]
    parts: NDArray[np.uint8]


@dataclass
class Desk:
    """One frame under work.

    editor: None where the set is open read-only. part: the chosen one. visibility: parts that are faded or
    hidden. alone: whether the chosen part is shown alone. carrying: whether corrections are carried over to
    every frame that accepting opens. keys: pressed since the last stroke.
    """

    correction: Correction
    scene: Scene
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

    def put(self, scene: Scene, editor: Editor | None) -> None:
        """Lay another frame on the desk; the tools stay as they are."""
        self.scene, self.editor, self.preview, self._grown, self.keys = scene, editor, None, None, 0
        self._remember(scene)
        if editor:
            editor.locks = self.locks
        if self.colouring not in colourings(scene):
            self.colouring = "part"

    def _remember(self, scene: Scene) -> None:
        """Keep the looks of the frames laid here last: corrections that are carried over follow them."""
        self._clouds.pop(scene.labels.frame_id, None)
        self._clouds[scene.labels.frame_id] = scene.cloud
        while len(self._clouds) > FRAMES_COMPARED + 1:
            del self._clouds[next(iter(self._clouds))]

    @property
    def parts(self) -> NDArray[np.uint8]:
        """Part ids (h, w) as they stand."""
        return self.editor.parts if self.editor else self.scene.labels.parts

    def counts(self) -> dict[int, int]:
        """Pixels with depth by part id."""
        numbers = np.bincount(self.parts[self.scene.labels.depth_mm > 0], minlength=256)
        return {part: int(numbers[part]) for part in (*range(len(PARTS)), UNDEFINED)}

    def shown(self) -> NDArray[np.bool_]:
        """Pixels (h * w,) that are drawn and can be chosen."""
        hidden = np.zeros(256, np.bool_)
        if self.alone:
            hidden[:] = True
            hidden[self.part] = False
        hidden[[part for part, how in self.visibility.items() if how == "hidden"]] = True
        return np.asarray((self.scene.labels.depth_mm.ravel() > 0) & ~hidden[self.parts.ravel()])

    def colors(self, pixels: NDArray[np.int64], ground: tuple[int, int, int]) -> NDArray[np.uint8]:
        """Colours (n, 3) of flat pixels (n,) on a ground, a preview marked."""
        rgb = point_colors(self.scene, self.parts, pixels, self.colouring, self.visibility, ground)
        if self.preview:
            rgb[np.isin(pixels, self.preview.pixels)] = PREVIEW_RGB
        return rgb

    def next_colouring(self) -> None:
        """Colour by the next thing that the frame has data for."""
        there = colourings(self.scene)
        self.colouring = there[(there.index(self.colouring) + 1) % len(there)]

    def toggle_lock(self, part: int) -> Done:
        """Lock a part, or unlock it."""
        self.locks ^= {part}
        says = "locked: it neither gains nor loses" if part in self.locks else "unlocked"
        return Done(NOTHING, f"{title(part).capitalize()} {says}")

    def fade(self, part: int) -> Done:
        """Shown, faded, hidden, and shown again."""
        turn: dict[Visibility, Visibility] = {"shown": "faded", "faded": "hidden", "hidden": "shown"}
        how = self.visibility[part] = turn[self.visibility.get(part, "shown")]
        return Done(NOTHING, f"{title(part).capitalize()} {how}")

    # Strokes with the mouse

    def stroke(self, drawing: Drawing, start: int | None, pixels: NDArray[np.int64]) -> Done:
        """A drawn shape: its pixels get the chosen part.

        start: the pixel under its first point, or None. Takes the body's pixels alone, so that no lasso
        catches the room behind; with ``drawing.room`` everything; with ``drawing.only`` those of the part
        it started on, be it the room.
        """
        editor = self._editor()
        old = self.parts.ravel()[pixels]
        from_part = BACKGROUND if start is None else int(self.parts.ravel()[start])
        taken = old == from_part if drawing.only else drawing.room | (old != BACKGROUND)
        how = self._gesture(drawing)
        self._grown = None
        return self._did(
            editor.paint(pixels[taken], self.part, how), self._why_nothing(pixels, taken, drawing)
        )

    def piece(self, pixel: int | None, drawing: Drawing) -> Done:
        """A click: the piece under it gets the chosen part; a click on the piece just painted grows it."""
        editor = self._editor()
        if pixel is None:
            return Done(NOTHING, "No point there: click on the body", "warn")
        if self._grown and self._grown.part == self.part and pixel in self._grown.pixels:
            return self._grow(editor, self._grown, drawing)
        before = self.parts.copy()
        pixels = select.supervoxel(self.scene.pieces, before, pixel)
        if not len(pixels):
            return Done(NOTHING, "No piece there: draw round it instead", "warn")
        done = self._did(
            editor.paint(pixels, self.part, self._gesture(drawing)), self._already(int(before.flat[pixel]))
        )
        self._grown = _Grown(self.part, pixels, before) if len(done.pixels) else None
        return done

    def _grow(self, editor: Editor, grown: _Grown, drawing: Drawing) -> Done:
        pixels = select.grow(self.scene.pieces, grown.parts, self.scene.labels.depth_mm, grown.pixels)
        self.keys = 0
        done = self._did(
            editor.paint(pixels, self.part, drawing.gesture("grow")), "It cannot grow: its part ends here"
        )
        self._grown = _Grown(self.part, pixels, grown.parts)
        return done

    # Keys that work on the place under the pointer

    def swap(self, pixel: int | None) -> Done:
        """Exchange left and right: of the limb under the pointer, or else of the chosen part's."""
        part = self.part if pixel is None or not self.parts.flat[pixel] else int(self.parts.flat[pixel])
        pairs = next((limb for limb in (ARMS, LEGS) if part in np.ravel(limb)), None)
        if pairs is None:
            return Done(NOTHING, "Point at an arm or a leg to swap left and right", "warn")
        limb = "arms" if pairs is ARMS else "legs"
        return self._did(
            self._editor().swap_left_right(pairs, how=self._key(pixel)), f"No {limb} to swap", limb
        )

    def to_neighbour(self, pixel: int | None) -> Done:
        """Give the connected patch under the pointer to the part it touches most."""
        patch = self._patch(pixel)
        if not len(patch):
            return Done(NOTHING, "Point at a patch of the body to give it to its neighbour", "warn")
        return self._did(self._editor().to_neighbour(patch, how=self._key(pixel)), "It touches no other part")

    def merge(self, pixel: int | None) -> Done:
        """Turn the part under the pointer into the chosen one."""
        source = BACKGROUND if pixel is None else int(self.parts.flat[pixel])
        if source in (BACKGROUND, self.part):
            return Done(NOTHING, f"Point at the part that should become {title(self.part)}", "warn")
        return self._did(self._editor().merge(source, self.part, how=self._key(pixel)), self._locked())

    def pick(self, pixel: int | None) -> Done:
        """Choose the part under the pointer."""
        if pixel is None:
            return Done(NOTHING, "Point at a part to take it", "warn")
        self.part = int(self.parts.flat[pixel])
        return Done(NOTHING, f"{title(self.part).capitalize()} chosen")

    # Clean-up, previewed first

    def fill_holes(self) -> Done:
        """Holes of the chosen part: the first call shows them, the second fills them."""
        return self._previewed(
            "fill_holes", self.part, filled(self.parts, self._editor().depth_mm, self.part)
        )

    def remove_islands(self) -> Done:
        """Islands of all parts: the first call shows them, the second gives them to what is around."""
        return self._previewed("remove_islands", None, without_islands(self.parts, self._editor().depth_mm))

    def cancel(self) -> Done:
        """Drop a preview."""
        self._grown = None
        pixels = self.cancel_preview()
        return Done(pixels, "Dropped" if len(pixels) else "")

    def cancel_preview(self) -> NDArray[np.int64]:
        """Drop a preview; the pixels (n,) that were marked."""
        pixels = self.preview.pixels if self.preview else NOTHING
        self.preview = None
        return pixels

    def _previewed(self, operation: Operation, part: int | None, parts: NDArray[np.uint8]) -> Done:
        editor, shown = self._editor(), self.preview
        self.keys += 1
        if shown and (shown.operation, shown.part) == (operation, part):
            self.preview = None
            stroke = editor.replace(operation, shown.parts, part, Gesture("key", keys=self._take_keys()))
            return self._did(stroke, "Nothing to change")
        dropped = self.cancel().pixels
        pixels = editor.preview(parts)
        what = "hole" if operation == "fill_holes" else "island"
        whose = f" in {title(part)}" if part is not None else ""
        if not len(pixels):
            return Done(dropped, f"No {what}s{whose}")
        self.preview = Preview(operation, part, parts, pixels)
        says = f"{len(pixels):,} pixels of {what}s{whose} marked: the same key applies, Esc drops"
        return Done(np.union1d(dropped, pixels), says, "warn")

    # From the frame before

    def copy_previous(self, frame_id: str) -> Done:
        """Take the parts of another frame where it shows the same surface."""
        previous = self.correction.frame(frame_id)
        stroke = self._editor().copy_previous(previous, how=self._key(None, 2))
        return self._did(stroke, "The frame before says the same")

    def toggle_carrying(self) -> Done:
        """Carry corrections over to every frame that accepting opens, or leave it to the key."""
        self.carrying = not self.carrying
        now = "carried over to every next frame" if self.carrying else "carried over by the key alone"
        return Done(NOTHING, f"Corrections are {now}")

    def carry(self, frame_ids: Sequence[str]) -> Done:
        """As ``propagate``, to a frame just opened on which nobody worked: no key is pressed for it."""
        if self.correction.state(self.scene.labels.frame_id) != "auto":
            return Done(NOTHING, "")
        return self.propagate(frame_ids, keys=0)

    def propagate(self, frame_ids: Sequence[str], keys: int = 2) -> Done:
        """Carry the corrections of other frames over, the nearest first."""
        labels, now = self.correction.labels, self.scene.labels
        target = replace(now, parts=self.parts.copy())
        worked = [
            CorrectedFrame(self._automatic(i), self.correction.frame(i), self._clouds.get(i))
            for i in frame_ids
        ]
        parts = propagate(worked, target, labels.intrinsics, self.scene.cloud).parts
        return self._did(
            self._editor().propagate(parts, self._key(None, keys)), "No frame near has a correction for here"
        )

    # Back and forth, verdicts

    def undo(self) -> Done:
        """Take back the last stroke."""
        self._grown = None
        dropped = self.cancel().pixels
        if len(dropped):
            return Done(dropped, "Dropped")
        return self._did(self._editor().undo(self._key(None, 2)), "Nothing to undo")

    def redo(self) -> Done:
        """Do again what was undone last."""
        return self._did(self._editor().redo(self._key(None, 3)), "Nothing to redo")

    def accept(self) -> Done:
        """Right as it is: an annotator accepts, and who looks at the accepted work of others agrees."""
        editor, how = self._editor(), Gesture("key", keys=1)
        verdict = self.next_verdict()
        if verdict == "accept":
            editor.accept(how)
        elif verdict == "agree":
            editor.agree(how)
        said = {"accept": "Accepted", "agree": "Agreed", "none": "Accepted already"}
        return Done(NOTHING, said[verdict], "good")

    def next_verdict(self) -> Literal["accept", "agree", "none"]:
        """What accepting would say now; nothing where this person said it before."""
        frame_id = self.scene.labels.frame_id
        if self.correction.state(frame_id) not in ("accepted", "reviewed"):
            return "accept"
        verdicts = [s for s in self.correction.journal.strokes(frame_id) if s.operation in VERDICTS]
        return "none" if verdicts and verdicts[-1].who == self.correction.who else "agree"

    def reject(self, reason: str) -> Done:
        """Not to be used."""
        self._editor().reject(reason, Gesture("key", keys=2))
        return Done(NOTHING, f"Rejected: {reason}", "warn")

    # Within

    def _editor(self) -> Editor:
        if self.editor is None:
            raise CloudError("This label set is open read-only: close it and open it without --read-only")
        return self.editor

    def _did(self, stroke: Stroke | None, nothing: str, what: str = "") -> Done:
        """What came of an operation; a preview of the labels before it is no longer true."""
        if stroke is None:
            return Done(NOTHING, nothing, "warn")
        return Done(np.union1d(stroke.pixels, self.cancel_preview()), told(stroke, what))

    def _automatic(self, frame_id: str) -> FrameLabels:
        labels = self.correction.labels
        return labels.read(frame_id, original=labels.has_original(frame_id))

    def _patch(self, pixel: int | None) -> NDArray[np.int64]:
        if pixel is None or self.parts.flat[pixel] == BACKGROUND:
            return NOTHING
        mask = (self.parts == self.parts.flat[pixel]) & (self.scene.labels.depth_mm > 0)
        pieces, _ = components(mask, self.scene.labels.depth_mm.astype(np.float32))
        return np.flatnonzero(pieces == pieces.flat[pixel]) if pieces.flat[pixel] else NOTHING

    def _why_nothing(self, pixels: NDArray[np.int64], taken: NDArray[np.bool_], drawing: Drawing) -> str:
        if not len(pixels):
            return "No point in there"
        if not taken.any():
            hint = "" if drawing.only else ": hold Shift and start on it to add it to the body"
            return f"Only the room is in there{hint}" if not drawing.only else "Not the part it started on"
        return self._locked() if self.locks else self._already(self.part)

    def _already(self, part: int) -> str:
        return f"That is {title(self.part)} already" if part == self.part else self._locked()

    def _locked(self) -> str:
        names = ", ".join(title(part) for part in sorted(self.locks))
        return (
            f"Nothing changed: {names} locked (Shift and the part's key unlocks)"
            if names
            else "Nothing to change"
        )

    def _take_keys(self) -> int:
        keys, self.keys = self.keys, 0
        return keys

    def _key(self, pixel: int | None, keys: int = 1) -> Gesture:
        self._take_keys()
        return Gesture("key", points=int(pixel is not None), keys=keys)

    def _gesture(self, drawing: Drawing) -> Gesture:
        held = drawing.held_keys
        kind = "supervoxel" if drawing.tool == "piece" else drawing.tool
        return drawing.gesture(kind, self._take_keys() + held)
