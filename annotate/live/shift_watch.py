"""Alignment of the running thermal camera: whether it has moved, in which direction and how far."""

from collections import deque

import numpy as np

from annotate.array_types import Bool, Float64
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.live.frame_warnings import shift_warning
from annotate.live.warning import LiveWarning
from annotate.person.alignment import TOLERABLE_DEG, is_warmer, misplacement_px, warm_contrasts
from annotate.person.warmth import WINDOW_C, find_window, warmth

EVERY_NS, FRAMES = 500_000_000, 8
"""Nanoseconds from one frame looked at to the next, and frames whose contrasts are added: four seconds, in
which people move. Untuned."""


class ShiftWatch:
    """Contrasts of the last frames at the silhouettes of what is warm, see ``annotate.person.alignment``."""

    def __init__(self) -> None:
        self._surfaces = deque[Float64](maxlen=FRAMES)
        self._looked_ns = 0
        self._complaint: LiveWarning | None = None

    def warning(self, cloud: ThermalCloud, person: Bool, now_ns: int) -> LiveWarning | None:
        """The complaint as of the last frame that was looked at. person: mask (h, w)."""
        if now_ns - self._looked_ns >= EVERY_NS and np.isfinite(cloud.temperature_c).any():
            self._looked_ns = now_ns
            surface = warm_contrasts(cloud)
            if surface is not None:
                self._surfaces.append(surface)
            self._complaint = self._judged(cloud, person)
        return self._complaint

    def _judged(self, cloud: ThermalCloud, person: Bool) -> LiveWarning | None:
        """A complaint about the shift that the last frames together tell, if it is far."""
        if len(self._surfaces) < FRAMES:
            return None
        shift_px = misplacement_px(np.mean(self._surfaces, axis=0))
        if shift_px is None:
            return None
        warm = warmth(cloud.temperature_c, find_window(cloud, cloud.valid) or WINDOW_C).clip(0, 1)
        if not is_warmer(warm, person, shift_px):
            return None
        return shift_warning(shift_px, cloud.camera, TOLERABLE_DEG)
