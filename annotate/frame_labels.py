"""Labels of one depth image, checked once."""

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from annotate.array_types import Float32, UInt8, UInt16
from annotate.parts import N_CLASSES, UNDEFINED
from sensors.errors import FormatError

Status = Literal["auto", "corrected", "reviewed", "truth"]


@dataclass(frozen=True)
class FrameLabels:
    """Part labels of one undistorted depth image, pixel by pixel.

    depth_mm: uint16 (h, w), 0 = no reading. parts: uint8 (h, w) part ids, 255 = undefined.
    confidence: float32 (h, w) in [0, 1], or None. subject: the person's name, "" if unknown.
    notes: free JSON values (omissions, difficulties).
    persons: uint8 (h, w), or None: 0 nobody, 1 the labelled person, 2 and on everybody else.
    Raises FormatError with the wrong shape or value.
    """

    frame_id: str
    depth_mm: UInt16
    parts: UInt8
    confidence: Float32 | None = None
    status: Status = "auto"
    subject: str = ""
    notes: dict[str, Any] = field(default_factory=dict)
    persons: UInt8 | None = None

    def __post_init__(self) -> None:
        if self.depth_mm.ndim != 2 or self.depth_mm.dtype != np.uint16:
            raise FormatError(
                f"frame {self.frame_id}: depth is {self.depth_mm.dtype} {self.depth_mm.shape}; "
                "give uint16 (h, w)"
            )
        if self.parts.shape != self.depth_mm.shape or self.parts.dtype != np.uint8:
            raise FormatError(
                f"frame {self.frame_id}: parts are {self.parts.dtype} {self.parts.shape} "
                f"over depth {self.depth_mm.shape}; give uint8 of the same shape"
            )
        if self.confidence is not None and self.confidence.shape != self.parts.shape:
            raise FormatError(
                f"frame {self.frame_id}: confidence is {self.confidence.shape}; give {self.parts.shape}"
            )
        if self.persons is not None and (
            self.persons.shape != self.parts.shape or self.persons.dtype != np.uint8
        ):
            raise FormatError(
                f"frame {self.frame_id}: persons are {self.persons.dtype} {self.persons.shape}; "
                f"give uint8 {self.parts.shape}"
            )
        unknown = self.parts[(self.parts >= N_CLASSES) & (self.parts != UNDEFINED)]
        if unknown.size:
            raise FormatError(
                f"frame {self.frame_id}: part id {int(unknown[0])} is unknown; "
                "use 0 to 11, or 255 for undefined"
            )
        if not isinstance(self.subject, str) or not isinstance(self.notes, dict):
            raise FormatError(
                f"frame {self.frame_id}: subject is a {type(self.subject).__name__}, notes are a "
                f"{type(self.notes).__name__}; give a text and an object"
            )
        if self.status not in get_args(Status):
            raise FormatError(
                f"frame {self.frame_id}: status {self.status!r} is unknown; use {get_args(Status)}"
            )
