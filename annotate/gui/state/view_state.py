"""View state of the open frame: what is shown, in which colours, and where to look next."""

from dataclasses import dataclass, field

import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.correction.correction import Correction
from annotate.correction.doubtful_places import Doubt, doubts
from annotate.correction.doubtful_places import part_title as title
from annotate.correction.edit import Editor
from annotate.gui.state.outcome import Done
from annotate.gui.state.point_colors import Colors, Look, Painting, Visibility
from annotate.gui.state.scene import FrameScene
from annotate.labelset.stroke import Operation
from annotate.parts import BACKGROUND, PARTS, UNDEFINED

PREVIEW_RGB = (255, 255, 0)
"""Colour of the pixels that a clean-up would change: no part has it. Untuned."""


@dataclass(frozen=True)
class Preview:
    """A clean-up that was computed and not yet applied. parts: uint8 (h, w), the labels after it."""

    operation: Operation
    part: int | None
    parts: UInt8
    pixels: Int64


@dataclass
class Sight:
    """One frame and what is shown of it.

    editor: None where the set is open read-only. before: parts (h, w) of the frame before, or None.
    part: the chosen one. visibility: parts that are faded or hidden. alone: whether the chosen part is shown
    alone. onion: whether the outlines of the frame before are shown. preview: a clean-up to be applied.
    """

    correction: Correction
    scene: FrameScene
    editor: Editor | None
    before: UInt8 | None = None
    part: int = 1
    visibility: dict[int, Visibility] = field(default_factory=dict)
    alone: bool = False
    onion: bool = False
    preview: Preview | None = None
    _doubt: int = -1

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

    def painting(self, look: Look, ground: tuple[int, int, int]) -> Colors:
        """The colours of flat pixels at this moment, on a ground; a preview is marked."""
        before = self.before if self.onion else None
        plain = Painting(self.scene, self.parts, look, self.visibility, ground, before)
        shown = self.preview
        if shown is None:
            return plain

        def marked(pixels: Int64) -> UInt8:
            rgb = plain(pixels)
            rgb[np.isin(pixels, shown.pixels)] = PREVIEW_RGB
            return rgb

        return marked

    def read_out(self, pixel: int) -> str:
        """Read-out of a pixel: part, depth, temperature, confidence, and the other set's part."""
        scene, part = self.scene, int(self.parts.flat[pixel])
        facts = [title(part), f"{scene.labels.depth_mm.flat[pixel] / 1000:.2f} m"]
        if np.isfinite(celsius := float(scene.cloud.temperature_c.flat[pixel])):
            facts.append(f"{celsius:.1f} °C")
        if scene.labels.confidence is not None and part != BACKGROUND:
            facts.append(f"confidence {scene.labels.confidence.flat[pixel]:.2f}")
        if scene.other is not None:
            facts.append(f"other set: {title(int(scene.other.flat[pixel]))}")
        return "  ·  ".join(facts)

    def fade(self, part: int) -> Done:
        """Switch a part from shown to faded, to hidden, and to shown again."""
        turn: dict[Visibility, Visibility] = {"shown": "faded", "faded": "hidden", "hidden": "shown"}
        how = self.visibility[part] = turn[self.visibility.get(part, "shown")]
        changed = np.flatnonzero((self.parts == part) & (self.scene.labels.depth_mm > 0))
        return Done(f"{title(part).capitalize()} {how}", pixels=changed)

    # Doubtful places

    def doubts(self) -> list[Doubt]:
        """The doubtful places of the frame as it stands, the heaviest first."""
        scene, strokes = self.scene, self.editor.history.done if self.editor else ()
        return doubts(scene.labels, self.parts, scene.other, strokes)

    def next_doubt(self) -> tuple[Done, Doubt | None]:
        """The next doubtful place, in words and itself; None where there is none."""
        found = self.doubts()
        if not found:
            return Done("No doubtful place is left in this frame", "good"), None
        self._doubt = (self._doubt + 1) % len(found)
        doubt = found[self._doubt]
        return Done(f"Doubtful place {self._doubt + 1} of {len(found)}: {doubt.reason}", "warn"), doubt
