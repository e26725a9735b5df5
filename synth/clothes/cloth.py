"""Cloth on skin: the directions it stands off in, and its folds."""

import numba
import numpy as np

from annotate.array_types import Float32, Int32
from synth.body.body import Body
from synth.surface.facets import noise_tile, smooth_noise, wavelength_cells
from synth.surface.rasterize import EXACT

ROUNDS = 6
"""Times that normals are averaged over neighbours. Chosen by eye: a seam of the buttocks closes, a calf
stays."""


def smooth_normals(body: Body) -> Float32:
    """Unit normals (V, 3) outwards, averaged over about 5 cm of skin, so that cloth along them does not
    cross."""
    normals = _normals(body.vertices_m, body.faces)
    for _ in range(ROUNDS):
        normals = _averaged(normals, body.faces)
    return normals


@numba.njit(cache=True, fastmath=EXACT)
def _normals(vertices: Float32, faces: Int32) -> Float32:
    normals = np.zeros_like(vertices)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in (a, b, c):
            normals[k, 0] += nx
            normals[k, 1] += ny
            normals[k, 2] += nz
    _to_unit(normals)
    return normals


@numba.njit(cache=True, fastmath=EXACT)
def _averaged(normals: Float32, faces: Int32) -> Float32:
    """Unit means of each normal and its neighbours' (V, 3)."""
    means = normals.copy()
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for i in range(3):
            total = normals[a, i] + normals[b, i] + normals[c, i]
            means[a, i] += total - normals[a, i]
            means[b, i] += total - normals[b, i]
            means[c, i] += total - normals[c, i]
    _to_unit(means)
    return means


@numba.njit(cache=True, fastmath=EXACT)
def _to_unit(vectors: Float32) -> None:
    for i in range(len(vectors)):
        length = np.sqrt(vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2) + np.float32(1e-12)
        for k in range(3):
            vectors[i, k] /= length


def fold_heights(vertices_m: Float32, rng: np.random.Generator) -> Float32:
    """Smooth noise (V,) of mean 0 and standard deviation 1 over the skin at rest, longer down than across."""
    across = wavelength_cells(rng.uniform(0.07, 0.16))
    stretch = np.array([across, across, across / rng.uniform(1.0, 2.5)], np.float32)
    return _noise(noise_tile(), vertices_m, stretch, rng.uniform(0, 64, 3).astype(np.float32))


@numba.njit(cache=True, fastmath=EXACT)
def _noise(tile: Float32, vertices: Float32, scale: Float32, shift: Float32) -> Float32:
    heights = np.empty(len(vertices), np.float32)
    for i in range(len(vertices)):
        heights[i] = smooth_noise(
            tile,
            vertices[i, 0] * scale[0] + shift[0],
            vertices[i, 1] * scale[1] + shift[1],
            vertices[i, 2] * scale[2] + shift[2],
        )
    return heights
