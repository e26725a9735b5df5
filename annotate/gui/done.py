"""The outcome of a key or a stroke."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from annotate.array_types import Int64

Tone = Literal["plain", "good", "warn", "bad"]
NOTHING: Int64 = np.empty(0, np.int64)
"""No pixels."""


@dataclass(frozen=True)
class Done:
    """An outcome. pixels: flat indices (n,) that look different now. text: a sentence for the status line."""

    pixels: Int64
    text: str
    tone: Tone = "plain"
