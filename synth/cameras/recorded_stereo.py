"""Stereo camera as people record it: after the maker's filters, and aligned with colour."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Float32, Int32, UInt16
from sensors.rig.camera import Intrinsics
from synth.cameras.depth_filters import Fill, cell_of, decimate, fill_holes, smooth_between_edges
from synth.cameras.relief import FARTHEST_MM, Number
from synth.cameras.sensor import NOTHING, CleanDepth, Reading
from synth.cameras.stereo import Stereo
from synth.surface.rasterize import EXACT

UNFILTERED, LIGHTLY = 0.15, 0.55  # cumulative shares; the rest are strongly filtered; untuned
ALPHA = (0.35, 0.6)  # about librealsense's default, 0.5
DELTA_PX = (5 / 32, 50 / 32)  # of a light filter; librealsense's default is 20 steps of 1/32 px
MELTING_PX = (
    20.0  # the same default in librealsense's first versions, by steps of a pixel: nothing is an edge
)
STEADIED, DECIMATED = 0.5, 0.2  # shares with temporal filter, and with decimation by 2; untuned
TEMPORAL_SD = 0.5  # factor of the temporal filter on independent noise, at librealsense's alpha of 0.4
FILLS = (0.3, 0.2, 0.35, 0.15)  # shares of the modes of ``Fill``; FARTHEST is the default; untuned
REACH_PX = 16  # by which filled holes widen a cut-out person at most; untuned


@dataclass(frozen=True)
class RecordedStereo:
    """Stereo camera whose depth is decimated, smoothed, filled and resampled to the pixels of ``raw.camera``.

    cell_px: pixels of the image per pixel of the filtered image, from decimation and from alignment with a
    finer colour image. alpha, delta_px, passes: of ``smooth_between_edges``, delta in pixels of the filtered
    image's disparity; 0 passes leave depth unfiltered. fill: mode of hole filling.

    Alignment moves no pixel: the parallax between depth and colour is left out.
    """

    raw: Stereo
    cell_px: float = 1.0
    alpha: float = 0.5
    delta_px: float = 20 / 32
    passes: int = 2
    fill: Fill = Fill.FARTHEST
    kind: ClassVar[str] = "recorded stereo"

    @property
    def camera(self) -> Intrinsics:
        """Return the pinhole of the recorded image."""
        return self.raw.camera

    @property
    def model(self) -> str:
        """Return the name of the camera's model."""
        return self.raw.model

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "RecordedStereo":
        """Draw a camera of the model ``entry`` in ``sensors.toml``: lightly, strongly or not filtered."""
        raw, kind = Stereo.sample(rng, entry), rng.random()
        finer = max(1.0, raw.camera.fx / entry.get("depth_focal_px", raw.camera.fx))
        if finer > 1.0:
            raw = replace(raw, noise_px=raw.noise_px * finer, wave_px=raw.wave_px * finer)
            raw = replace(raw, steps=raw.steps / finer, banded=False)
        if kind < UNFILTERED:
            return RecordedStereo(raw, finer, passes=0, fill=Fill.NONE)
        if rng.random() < STEADIED:
            patches = raw.patches**4 + 4 * raw.patches**3 * (1 - raw.patches)
            raw = replace(raw, noise_px=raw.noise_px * TEMPORAL_SD, patches=patches)
        filters = RecordedStereo(
            raw,
            finer * (2 if rng.random() < DECIMATED else 1),
            alpha=float(rng.uniform(*ALPHA)),
            passes=int(rng.integers(1, 4)),
            fill=Fill(int(rng.choice(len(Fill), p=FILLS))),
        )
        if kind < LIGHTLY:
            return replace(filters, delta_px=float(np.exp(rng.uniform(*np.log(DELTA_PX)))))
        return replace(filters, passes=2, delta_px=MELTING_PX)

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the reading of a clean image, as ``Sensor.read``.

        Depth at a smoothed edge lies between the surfaces. The source stays the surface that the unfiltered
        camera measured at the pixel, or in the pixel's cell if its depth is nearer; in holes, the surface
        that filled the hole.
        """
        person = clean.person
        raw = self.raw.read(CleanDepth(clean.window, clean.behind(rng), clean.dark), rng)
        parallax = 1000 * clean.window.fx * self.raw.baseline_m / self.cell_px
        numbers = np.array((parallax, self.cell_px, self.alpha, self.delta_px), np.float32)
        reading = Reading(*_filtered(*raw, numbers, self.passes, self.fill))
        lost = ~clean.wanted(REACH_PX)
        if person is not None:
            lost |= ~person.ravel()[reading.source]
        reading.depth_mm[lost], reading.source[lost] = 0, NOTHING
        return reading


@numba.njit(cache=True, fastmath=EXACT)
def _filtered(
    depth_mm: UInt16, source: Int32, numbers: Float32, passes: int, fill: int
) -> tuple[UInt16, Int32]:
    """Return filtered depth and sources (h, w). numbers: millimetres times pixels of disparity, ``cell_px``,
    ``alpha``, ``delta_px``.
    """
    parallax, cell_px, alpha, delta = numbers
    small, origin = decimate(depth_mm.astype(np.float32), source, cell_px)
    before = small.copy()
    if passes > 0:
        _invert(small, parallax)
        smooth_between_edges(small, alpha, delta, passes)
        _invert(small, parallax)
    fill_holes(small, origin, fill)
    filtered, surface = np.zeros(depth_mm.shape, np.uint16), source.copy()
    for v in range(depth_mm.shape[0]):
        for u in range(depth_mm.shape[1]):
            i, j = cell_of(v, cell_px), cell_of(u, cell_px)
            mm = np.rint(small[i, j])
            if 0 < mm <= FARTHEST_MM:
                filtered[v, u] = int(mm)
                other = abs(mm - before[i, j]) < abs(mm - np.float32(depth_mm[v, u]))
                if source[v, u] == NOTHING or other:
                    surface[v, u] = origin[i, j]
            else:
                surface[v, u] = NOTHING
    return filtered, surface


@numba.njit(cache=True, fastmath=EXACT)
def _invert(image: Float32, parallax: Number) -> None:
    """Turn depth (h, w) into disparity or back, in place; 0 stays 0."""
    for row in image:
        for u in range(len(row)):
            if row[u] > 0:
                row[u] = parallax / row[u]
