"""Pyrometer as the thermal camera's reference: its spot in the image, and the camera's temperature offset.

A bolometer camera drifts by kelvins while it warms up (Optris PI: accuracy of 2 K), all pixels alike; a
pyrometer is stable to tenths. At the right spot, reading minus image changes as slowly as drift does.
Constants are untuned unless a source is given.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

SPOT_RAD = 1 / 22  # the pyrometer's spot, diameter over distance: 22:1 of an Optris CT LT22 (from memory)
MARGIN = 0.2  # share of the image at each side without the spot
READINGS = 600  # kept, and taken of a recording: a minute at ten a second
LEAST_READINGS = 20
CLIP_K = 3.0  # bound of a counted change: an edge that passes is not evidence against a place
EXPLAINED = 0.5  # largest share of the readings' changes that remains at the spot
ALIKE = 1.15  # places whose changes are within this factor of the least may be the spot as well
UNSURE_K = 0.5  # K; half of 5 to 95 % of such places' offsets: the wanted accuracy
EVEN_K = 0.3  # K; standard deviation within the spot from which a reading counts for less
LEAST_KNOWN = 0.5  # share of the spot's pixels with a temperature
SMOOTH_S = 5.0  # s to each side within which offsets are averaged: drift takes minutes
SLOPE_K_S = 0.1  # K/s; standard deviation of a camera's drift

Celsius = NDArray[np.float32]
Floats = NDArray[np.float64]


class ThermalReference:
    """Readings of a pyrometer with simultaneous thermal images.

    focal_px: the thermal camera's focal length. Times must increase, on any one clock.
    """

    def __init__(self, focal_px: float) -> None:
        self._radius = max(1.0, focal_px * SPOT_RAD / 2)
        self._times_s = deque[float](maxlen=READINGS)
        self._read_c = deque[float](maxlen=READINGS)
        self._off_k = deque[Celsius](maxlen=READINGS)
        self._uneven_k = deque[Celsius](maxlen=READINGS)
        self._places = np.empty((0, 2), np.int64)

    def add(self, time_s: float, reading_c: float, thermal_c: Celsius) -> None:
        """Add a reading and the simultaneous image (h, w), degrees Celsius; NaN readings are ignored."""
        if not np.isfinite(reading_c):
            return
        if not len(self._places):
            step = max(1, round(self._radius / 2))
            sides = ([round(MARGIN * n), round((1 - MARGIN) * n)] for n in thermal_c.shape)
            rows, columns = (np.arange(first, end, step) for first, end in sides)
            self._places = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        # Differences from the reading, because squares of small numbers keep their digits.
        mean, square = self._over_disc(np.float32(reading_c) - thermal_c)
        self._times_s.append(time_s)
        self._read_c.append(reading_c)
        self._off_k.append(mean)
        self._uneven_k.append(np.sqrt(np.maximum(square - mean**2, 0)))

    def _over_disc(self, off_k: Celsius) -> tuple[Celsius, Celsius]:
        """Return the means (places,) of an image (h, w) and of its square over the known pixels of each disc.

        NaN where too little of a disc is known. Unknown pixels are filtered as 0, because OpenCV's Fourier
        transform (from 11 x 11 pixels on) spreads a NaN over much of the image.
        """
        import cv2

        known, at = np.isfinite(off_k), tuple(self._places.T[::-1])
        there = np.where(known, off_k, np.float32(0))
        share, mean, square = (
            cv2.filter2D(image, -1, self._disc)[at]
            for image in (known.astype(np.float32), there, there * there)
        )
        share = np.where(share >= LEAST_KNOWN, share, np.float32(np.nan))
        return np.asarray(mean / share, np.float32), np.asarray(square / share, np.float32)

    @property
    def _disc(self) -> Celsius:
        reach = int(self._radius)
        aside = np.arange(-reach, reach + 1)
        inside = np.hypot(aside[:, None], aside) <= self._radius
        return np.asarray(inside / inside.sum(), np.float32)

    def spot(self) -> int | None:
        """Return the candidate place of the pyrometer's spot, for ``offsets_k`` and ``pixel``.

        None where too little moved, or where equally likely places give different corrections.
        """
        if len(self._times_s) < LEAST_READINGS:
            return None
        off = np.stack(self._off_k)
        change = np.minimum(np.abs(np.diff(off, axis=0)), CLIP_K).mean(axis=0)
        own = np.minimum(np.abs(np.diff(self._read_c)), CLIP_K).mean()
        change[~np.isfinite(change)] = np.inf
        best = int(np.argmin(change))
        if not change[best] <= EXPLAINED * own:
            return None
        alike = np.median(off[:, change <= ALIKE * change[best]], axis=0)
        low, high = np.quantile(alike, (0.05, 0.95))
        return None if high - low > 2 * UNSURE_K else best

    def pixel(self, spot: int) -> tuple[int, int]:
        """Return column and row of a place in the thermal image."""
        column, row = self._places[spot].tolist()
        return column, row

    def offsets_k(self, spot: int, times_s: Floats) -> Floats:
        """Return the kelvins (n,) to add to the thermal images at times (n,).

        A line is fitted to the readings within SMOOTH_S, weighted by how even the spot is. Without such
        readings the nearest one is used.
        """
        start_s = self._times_s[0]
        known_s, asked_s = np.array(self._times_s) - start_s, times_s - start_s
        off, uneven = (np.array([at[spot] for at in kept], float) for kept in (self._off_k, self._uneven_k))
        weight = np.where(np.isfinite(off), 1 / (EVEN_K**2 + uneven**2), 0)
        off = np.nan_to_num(off)
        first, end = (np.searchsorted(known_s, asked_s + side) for side in (-SMOOTH_S, SMOOTH_S))
        alone = np.abs(known_s[:, None] - asked_s[end <= first]).argmin(axis=0)
        first[end <= first], end[end <= first] = alone, alone + 1

        def total(values: Floats) -> Floats:
            summed = np.r_[0, np.cumsum(weight * values)]
            return np.asarray(summed[end] - summed[first])

        ones, t, tt = total(np.ones_like(off)), total(known_s), total(known_s**2)
        k, kt = total(off), total(off * known_s)
        # Moments about the queried time; the slope's prior is added to the squares.
        spread = tt - 2 * asked_s * t + asked_s**2 * ones + 1 / SLOPE_K_S**2
        lean, turn = t - asked_s * ones, kt - asked_s * k
        return np.asarray((k * spread - lean * turn) / (ones * spread - lean**2), np.float64)
