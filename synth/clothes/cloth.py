"""Cloth on skin: normals, folds and room in the armpits."""

import numba
import numpy as np

from annotate.array_types import Float32, Float64, Int32, Int64
from synth.body.body import Body
from synth.clothes.skin_map import ARMS, Limb, SkinMap
from synth.surface.facets import cross, noise_tile, smooth_noise, wavelength_cells
from synth.surface.rasterize import EXACT

ROUNDS = 6  # of averaging normals over neighbours: keeps a calf; untuned
ROOM_SHARE = 0.4  # of the gap between facing skins, for the cloth on either
REACH_M = 0.15  # greatest gap between skins that limit their cloth


def smooth_normals(body: Body) -> Float32:
    """Return outward unit normals (V, 3), averaged over about 5 cm, so that displaced cloth does not
    intersect itself.
    """
    normals = _normals(body.vertices_m, body.faces)
    for _ in range(ROUNDS):
        normals = _averaged(normals, body.faces)
    return normals


@numba.njit(cache=True, fastmath=EXACT)
def _normals(vertices: Float32, faces: Int32) -> Float32:
    normals = np.zeros_like(vertices)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        # In float32, unlike ``facets.edge``.
        u = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        v = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        nx, ny, nz = cross(u, v)
        for k in (a, b, c):
            normals[k, 0] += nx
            normals[k, 1] += ny
            normals[k, 2] += nz
    _to_unit(normals)
    return normals


@numba.njit(cache=True, fastmath=EXACT)
def _averaged(normals: Float32, faces: Int32) -> Float32:
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
    """Return smooth normally distributed noise (V,) over vertices at rest, stretched to vertical folds."""
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


def hold_apart(body: Body, places: SkinMap, normals: Float32, off_m: Float32) -> Float32:
    """Return displacements ``off_m`` (V, 3), shortened in the armpits so that cloth does not intersect
    itself.
    """
    result = off_m.copy()
    high = (places.level > 0.3) & (places.level < 0.98)
    for limb, sign in zip(ARMS, (1, -1), strict=True):
        inwards = sign * normals[:, 0] < 0.3
        arm = np.flatnonzero((places.limb == limb) & (places.along < 0.9) & inwards)
        beside = sign * places.trunk.out[:, 0] > 0.5
        trunk = np.flatnonzero((places.limb == Limb.TRUNK) & high & beside)
        _shorten(body.vertices_m, normals, result, arm, trunk)
    return result


@numba.njit(cache=True, fastmath=EXACT)
def _shorten(vertices: Float32, normals: Float32, off: Float32, first: Int64, second: Int64) -> None:
    room_1, room_2 = np.full(len(first), REACH_M), np.full(len(second), REACH_M)
    for a in range(len(first)):
        i = first[a]
        for b in range(len(second)):
            j = second[b]
            dx = vertices[j, 0] - vertices[i, 0]
            dy = vertices[j, 1] - vertices[i, 1]
            dz = vertices[j, 2] - vertices[i, 2]
            squared = dx * dx + dy * dy + dz * dz
            if squared >= REACH_M * REACH_M:
                continue
            ahead = dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]
            behind = dx * normals[j, 0] + dy * normals[j, 1] + dz * normals[j, 2]
            gap = np.sqrt(squared)
            if ahead > 0.3 * gap and behind < -0.3 * gap:
                room_1[a], room_2[b] = min(room_1[a], gap), min(room_2[b], gap)
    _limit(off, first, room_1)
    _limit(off, second, room_2)


@numba.njit(cache=True, fastmath=EXACT)
def _limit(off: Float32, own: Int64, room: Float64) -> None:
    for a in range(len(own)):
        i = own[a]
        length = np.sqrt(off[i, 0] ** 2 + off[i, 1] ** 2 + off[i, 2] ** 2)
        if room[a] < REACH_M and length > ROOM_SHARE * room[a]:
            share = ROOM_SHARE * room[a] / length
            for k in range(3):
                off[i, k] *= np.float32(share)
