"""Open frame and its display: current labels, text on pixels, doubtful places, hidden parts."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.correction.doubtful_places import Doubt, doubts
from annotate.correction.edit import Editor
from annotate.gui.state.point_colors import Visibility
from annotate.gui.state.scene import FrameScene
from annotate.scheme.scheme import BACKGROUND, UNDEFINED

NEXT_VISIBILITY: dict[Visibility, Visibility] = {"shown": "faded", "faded": "hidden", "hidden": "shown"}


@dataclass(frozen=True)
class OpenFrame:
    """Frame under correction. editor: None where the set is read-only. before: parts (h, w) of the previous
    frame in time, or None.
    """

    scene: FrameScene
    editor: Editor | None
    before: UInt8 | None

    @property
    def frame_id(self) -> str:
        """Return the id of the frame in the label set."""
        return self.scene.labels.frame_id

    @property
    def parts(self) -> UInt8:
        """Return the current part ids (h, w)."""
        return self.editor.parts if self.editor else self.scene.labels.parts

    def counts(self) -> dict[int, int]:
        """Return the number of pixels with depth by part id."""
        numbers = np.bincount(self.parts[self.scene.labels.depth_mm > 0], minlength=256)
        return {part: int(numbers[part]) for part in (*self.scene.labels.scheme.by_id, UNDEFINED)}

    def read_out(self, pixel: int) -> str:
        """Return a text on a pixel: part, depth, temperature, confidence, and the other set's part."""
        scene, part = self.scene, int(self.parts.flat[pixel])
        title = scene.labels.scheme.title
        facts = [title(part), f"{scene.labels.depth_mm.flat[pixel] / 1000:.2f} m"]
        if np.isfinite(celsius := float(scene.cloud.temperature_c.flat[pixel])):
            facts.append(f"{celsius:.1f} °C")
        if scene.labels.confidence is not None and part != BACKGROUND:
            facts.append(f"confidence {scene.labels.confidence.flat[pixel]:.2f}")
        if scene.other is not None:
            facts.append(f"other set: {title(int(scene.other.flat[pixel]))}")
        return "  ·  ".join(facts)

    def doubts(self) -> list[Doubt]:
        """Return the doubtful places of the current labels, most expected wrong pixels first."""
        strokes = self.editor.history.done if self.editor else ()
        return doubts(self.scene.labels, self.parts, self.scene.other, strokes, self.scene.cloud)


@dataclass
class Display:
    """Display of the parts of every frame.

    visibility: of faded and hidden parts. alone: True to draw only the chosen part. onion: True to draw the
    outlines of the previous frame. witness: True to draw what a colour network shows.
    """

    visibility: dict[int, Visibility] = field(default_factory=dict)
    alone: bool = False
    onion: bool = False
    witness: bool = False

    def fade(self, part: int) -> Visibility:
        """Switch the visibility of a part: shown, faded, hidden, and shown again."""
        self.visibility[part] = NEXT_VISIBILITY[self.visibility.get(part, "shown")]
        return self.visibility[part]

    def shown(self, frame: OpenFrame, chosen: int) -> Bool:
        """Return flags (h * w,) of pixels that are drawn and can be chosen. chosen: the chosen part."""
        hidden = np.full(256, self.alone, np.bool_)
        hidden[chosen] = False
        hidden[[part for part, how in self.visibility.items() if how == "hidden"]] = True
        return np.asarray((frame.scene.labels.depth_mm.ravel() > 0) & ~hidden[frame.parts.ravel()])


def marked(
    colors: Callable[[Int64], UInt8], pixels: Int64, rgb: tuple[int, int, int]
) -> Callable[[Int64], UInt8]:
    """Return a colour function like ``colors`` that gives ``pixels`` the colour ``rgb``."""

    def with_mark(at: Int64) -> UInt8:
        drawn = colors(at)
        drawn[np.isin(at, pixels)] = rgb
        return drawn

    return with_mark
