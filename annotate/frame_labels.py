"""Labels of one depth image, validated at construction."""

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.errors import FormatError

Status = Literal["auto", "corrected", "reviewed", "truth"]


@dataclass(frozen=True)
class FrameLabels:
    """Part labels of one undistorted depth image.

    depth_mm: uint16 (h, w), 0 = no reading. parts: uint8 (h, w) part ids, 255 = undefined. confidence:
    float32 (h, w) in [0, 1], or None. subject: the person's name. notes: free JSON values. persons: uint8 (h,
    w), or None: 0 = no person, 1 the labelled one, others by track id. scheme: of the part ids. Raises
    FormatError for a field of another type, shape or range.
    """

    frame_id: str
    depth_mm: UInt16
    parts: UInt8
    confidence: Float32 | None = None
    status: Status = "auto"
    subject: str = ""
    notes: dict[str, Any] = field(default_factory=dict)
    persons: UInt8 | None = None
    scheme: Scheme = PAPER

    def __post_init__(self) -> None:
        for name, image, kind in (
            ("depth", self.depth_mm, "uint16"),
            ("parts", self.parts, "uint8"),
            ("confidence", self.confidence, "float"),
            ("persons", self.persons, "uint8"),
        ):
            shape = self.depth_mm.shape if self.depth_mm.ndim == 2 else "(h, w)"
            if image is not None and (image.shape != shape or kind not in image.dtype.name):
                raise self.error(f"{name} is {image.dtype} {image.shape}; give {kind} {shape}")
        if (unknown := self.scheme.unknown_ids(self.parts)).size:
            raise self.error(
                f"part id {unknown[0]} is unknown in scheme {self.scheme.name!r}; "
                f"use {self.scheme.label_text}"
            )
        if not isinstance(self.subject, str):
            raise self.error(f"subject is {str(self.subject)[:60]}; give a text")
        if not isinstance(self.notes, dict):
            raise self.error(f"notes is {str(self.notes)[:60]}; give an object")
        if self.status not in get_args(Status):
            raise self.error(f"status {self.status!r} is unknown; use {get_args(Status)}")

    @property
    def on_body(self) -> Bool:
        """Return the mask (h, w) of pixels labelled as a part of the body, not as a thing, background or
        undefined.
        """
        return self.scheme.on_body(self.parts)

    @property
    def on_person(self) -> Bool:
        """Return the mask (h, w) of pixels with a part of the body, or undefined."""
        return self.scheme.on_person(self.parts)

    def error(self, fault: str) -> FormatError:
        """Return an error that names the frame."""
        return FormatError(f"frame {self.frame_id}: {fault}")
