"""Soft surfaces: they puff up, dent under a body, and stay warm where it was."""

import cv2
import numpy as np

from annotate.array_types import Float32, Float64
from synth.surface.furniture import Side, Solid
from synth.surface.rasterize import Mesh, face_means, grid_faces, tagged

CELL_M = 0.025
"""Grid step: a thermal pixel covers 1.8 cm at 2 m."""
REACH_M = 0.09
"""What is deeper below the surface than that is not lying on it."""
CLEARANCE_M = 0.004
"""The cover stays that much below the skin, so that skin is what a camera sees."""
DRAPE = 0.85
"""Beside a dent the cover sags to this share of its smoothed depth; no source, looks like foam."""
CONTACT_C = 31.5
"""Of a seat under a clothed sitter: interfaces come to 30 to 34 C within half an hour (wheelchair cushion
studies; the exact value differs by cushion)."""
WARMING_S, COOLING_S = 60.0, 150.0
"""Time constants of a cover on foam, which stores little and leads badly; order of magnitude, no source."""

_LOCAL: dict[Side, tuple[int, int, int, int]] = {"top": (0, 1, 2, 1), "front": (0, 2, 1, -1)}
"""Axes along and across, axis of the normal and its sign, in the solid's own frame."""
_COVERED: dict[Side, tuple[int, int]] = {"top": (10, 11), "front": (4, 5)}
"""The two triangles of ``Solid.mesh`` that the cushion replaces."""


class Cushion:
    """One side of a solid as a grid of nodes with a dent and a heat each.

    heat: float64 (n, m) in [0, 1], how far a node is on its way from the room's temperature to the
    sitter's. mesh: the whole solid, world frame, at rest; its faces never change.
    """

    def __init__(self, solid: Solid, side: Side, puff_m: float) -> None:
        along, across, up, sign = _LOCAL[side]
        low, high = np.array(solid.low), np.array(solid.high)
        n, m = (max(2, round((high[k] - low[k]) / CELL_M)) + 1 for k in (along, across))
        u, v = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, m), indexing="ij")
        self._solid, self._axes, self._sign = solid, (along, across, up), sign
        self._level = high[up] if sign > 0 else -low[up]
        self._puff = puff_m * (1 - u**6) * (1 - v**6)
        nodes = np.empty((n, m, 3))
        nodes[..., along] = low[along] + (u + 1) / 2 * (high[along] - low[along])
        nodes[..., across] = low[across] + (v + 1) / 2 * (high[across] - low[across])
        nodes[..., up] = sign * self._level
        self._nodes = nodes @ solid.rotation.T + solid.translation
        self._normal = sign * solid.rotation[:, up]
        self._body = solid.mesh()
        self._kept = np.delete(np.arange(12), _COVERED[side])
        self.heat = np.zeros((n, m))
        self.mesh = self._whole()

    def press(self, points_m: Float32) -> Float64:
        """How deep (n, m) world points (N, 3) dent each node, metres from the puffed surface."""
        along, across, up = self._axes
        local = (points_m - self._solid.translation) @ self._solid.rotation
        low, high = np.array(self._solid.low), np.array(self._solid.high)
        height = self._sign * local[:, up] - self._level
        near = np.abs(height) < REACH_M
        near &= (local[:, along] > low[along]) & (local[:, along] < high[along])
        near &= (local[:, across] > low[across]) & (local[:, across] < high[across])
        n, m = self.heat.shape
        cell = [
            np.rint((local[near, k] - low[k]) / (high[k] - low[k]) * (count - 1)).astype(np.intp)
            for k, count in ((along, n), (across, m))
        ]
        depth = np.zeros((n, m), np.float32)
        deep = self._puff[cell[0], cell[1]] - height[near] + CLEARANCE_M
        np.maximum.at(depth, (cell[0], cell[1]), deep.astype(np.float32))
        return np.asarray(cv2.morphologyEx(depth, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), np.float64)

    def vertices(self, dent_m: Float64) -> Float32:
        """World vertices of ``mesh`` with these dents (n, m) in it."""
        sag = np.maximum(dent_m, DRAPE * cv2.GaussianBlur(dent_m, (0, 0), 2.0))
        for edge in (sag[0], sag[-1], sag[:, 0], sag[:, -1]):
            edge[:] = 0.0
        nodes = self._nodes + (self._puff - sag)[..., None] * self._normal
        return np.concatenate([self._body.vertices_m, nodes.reshape(-1, 3)]).astype(np.float32)

    def warm(self, dent_m: Float64, seconds: float) -> None:
        """Let a body press for so long: what it touches warms, the rest cools."""
        touched = dent_m > CLEARANCE_M / 2
        lag_s = np.where(touched, WARMING_S, COOLING_S)
        self.heat += (touched - self.heat) * (1 - np.exp(-seconds / lag_s))

    def leave_warm(self, dent_m: Float64, heat: float) -> None:
        """Somebody who pressed so has left: their place is still on its way back, ``heat`` in [0, 1]."""
        self.heat = np.maximum(self.heat, heat * (dent_m > CLEARANCE_M / 2))

    def celsius(self, room_c: float) -> Float64:
        """Temperature (F,) of every face of ``mesh`` in a room-warm solid."""
        heat = np.concatenate([np.zeros(8), cv2.GaussianBlur(self.heat, (0, 0), 1.0).ravel()])
        return np.asarray(room_c + (CONTACT_C - room_c) * face_means(heat, self.mesh.faces), np.float64)

    def _whole(self) -> Mesh:
        n, m = self.heat.shape
        faces = np.concatenate([self._body.faces[self._kept], grid_faces(n, m) + 8]).astype(np.int32)
        return tagged(self.vertices(np.zeros((n, m))), faces, self._solid.tag)
