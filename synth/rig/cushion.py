"""Cushions: soft surfaces that bulge, dent under a body and stay warm after it."""

import cv2
import numpy as np

from annotate.array_types import Float32, Float64
from synth.surface.furniture import Side, Solid
from synth.surface.rasterize import face_means, grid_faces, tagged

CELL_M = 0.025  # grid step; a thermal pixel covers 1.8 cm at 2 m
REACH_M = 0.09  # greatest depth below the surface of a body that lies on it
CLEARANCE_M = 0.004  # of the cover below the skin, so that cameras see the skin
DRAPE = 0.85  # sag beside a dent, share of its smoothed depth; untuned
CONTACT_C = 31.5  # of a seat under a clothed sitter: 30 to 34 C within half an hour (wheelchair cushions)
WARMING_S, COOLING_S = 60.0, 150.0  # time constants of a cover on foam; untuned
# Axes along, across and normal to a side in the solid's frame, and the normal's sign.
_LOCAL: dict[Side, tuple[int, int, int, int]] = {"top": (0, 1, 2, 1), "front": (0, 2, 1, -1)}
# The two triangles of ``Solid.mesh`` that the cushion replaces.
_COVERED: dict[Side, tuple[int, int]] = {"top": (10, 11), "front": (4, 5)}


class Cushion:
    """Soft side of a solid as a grid of nodes (n, m).

    heat: 0 at the room's temperature, 1 at the sitting person's. mesh: the whole solid at rest, world frame.
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
        kept = np.delete(np.arange(12), _COVERED[side])
        self.heat = np.zeros((n, m))
        faces = np.concatenate([self._body.faces[kept], grid_faces(n, m) + 8]).astype(np.int32)
        self.mesh = tagged(self.vertices(np.zeros((n, m))), faces, solid.tag)

    def press(self, points_m: Float32) -> Float64:
        """Return the dent (n, m) made by world points (N, 3), metres below the bulging surface."""
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
        """Return the world vertices of ``mesh`` with dents (n, m)."""
        sag = np.maximum(dent_m, DRAPE * cv2.GaussianBlur(dent_m, (0, 0), 2.0))
        for edge in (sag[0], sag[-1], sag[:, 0], sag[:, -1]):
            edge[:] = 0.0
        nodes = self._nodes + (self._puff - sag)[..., None] * self._normal
        return np.concatenate([self._body.vertices_m, nodes.reshape(-1, 3)]).astype(np.float32)

    def warm(self, dent_m: Float64, seconds: float) -> None:
        """Update ``heat`` after some seconds: touched nodes warm, the others cool."""
        touched = dent_m > CLEARANCE_M / 2
        lag_s = np.where(touched, WARMING_S, COOLING_S)
        self.heat += (touched - self.heat) * (1 - np.exp(-seconds / lag_s))

    def leave_warm(self, dent_m: Float64, heat: float) -> None:
        """Raise the heat of dented nodes to at least ``heat``, in [0, 1], as on a seat that was just left."""
        self.heat = np.maximum(self.heat, heat * (dent_m > CLEARANCE_M / 2))

    def celsius(self, room_c: float) -> Float64:
        """Return the temperature (F,), degrees Celsius, of every face of ``mesh``."""
        heat = np.concatenate([np.zeros(8), cv2.GaussianBlur(self.heat, (0, 0), 1.0).ravel()])
        return np.asarray(room_c + (CONTACT_C - room_c) * face_means(heat, self.mesh.faces), np.float64)
