"""Plain meshes: boxes, sheets and grids of triangles."""

import numpy as np

from annotate.array_types import Float32, Float64, Int32
from synth.surface.rasterize import Mesh


def tagged(vertices_m: Float32, faces: Int32, tag: int) -> Mesh:
    """A mesh of one tag."""
    return Mesh(vertices_m, faces, np.full(len(faces), tag, np.int32))


def box(low: tuple[float, float, float], high: tuple[float, float, float], tag: int) -> Mesh:
    """Axis-aligned box as 12 triangles."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([(a, b, c) for a in x for b in y for c in z], np.float32)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return tagged(corners, faces, tag)


def sheet(origin: Float64, along: Float64, across: Float64, tag: int) -> Mesh:
    """Rectangle cut into quarter-metre cells, so that a cell behind the camera can be dropped alone."""
    n, m = (max(1, int(np.ceil(np.linalg.norm(side) / 0.25))) for side in (along, across))
    i, j = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    vertices = (origin + i[..., None] * along + j[..., None] * across).reshape(-1, 3).astype(np.float32)
    return tagged(vertices, grid_faces(n + 1, m + 1), tag)


def grid_faces(rows: int, columns: int) -> Int32:
    """Triangles (2 (rows - 1) (columns - 1), 3) between the nodes of a grid, numbered row by row."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b = a + columns
    halves = [np.stack([a, a + 1, b + 1], axis=1), np.stack([a, b + 1, b], axis=1)]
    return np.concatenate(halves).astype(np.int32)
