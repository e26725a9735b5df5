"""Penetration of a posed body by itself, measured on its skin, and by furniture.

The skin is cut into the eleven parts, each closed by a fan over its open borders. A vertex of one part
inside another is as deep as its distance to that other part's skin (fans do not count); the deepest of all
counts. Where two parts meet skin folds and flesh is pressed flat, so vertices near the joint between them are
left out: ``FOLDS`` names the joint and the radius for every such pair, and no other pair has any relief.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from annotate.array_types import Float32, Float64
from annotate.parts import BODY_PARTS, PART_ID
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.surface.furniture import Solid


def _folds() -> dict[frozenset[int], tuple[tuple[int, ...], float]]:
    folds: dict[frozenset[int], tuple[tuple[int, ...], float]] = {}

    def fold(a: str, b: str, radius_m: float, *joints: str) -> None:
        folds[frozenset((PART_ID[a], PART_ID[b]))] = (tuple(JOINT_ID[j] for j in joints), radius_m)

    fold("head", "torso", 0.14, "neck")
    fold("torso", "hip", 0.25, "spine_lower")
    fold("left_upper_leg", "right_upper_leg", 0.16, "left_hip", "right_hip")
    for side in ("left", "right"):
        fold("torso", f"{side}_upper_arm", 0.14, f"{side}_shoulder")
        fold("head", f"{side}_upper_arm", 0.14, f"{side}_shoulder")
        fold(f"{side}_upper_arm", f"{side}_forearm", 0.12, f"{side}_elbow")
        fold("hip", f"{side}_upper_leg", 0.20, f"{side}_hip")
        fold("torso", f"{side}_upper_leg", 0.20, f"{side}_hip")
        fold(f"{side}_upper_leg", f"{side}_lower_leg", 0.18, f"{side}_knee")
    return folds


FOLDS = _folds()
"""Pair of parts -> (joints between them, radius in metres within which their skins may fold)."""


def self_penetration_m(body: Body, vertices_m: NDArray[np.float32], joints_m: Float64) -> float:
    """Depth (m) of the deepest vertex of one part inside another of a posed body, 0 when there is none.

    vertices_m: (V, 3) posed skin; joints_m: (J, 3) its joints, the same frame.
    """
    return max(penetrations_m(body, vertices_m, joints_m).values(), default=0.0)


def furniture_penetration_m(vertices_m: Float32, solids: list[Solid]) -> float:
    """Depth of the deepest vertex (V, 3) in any solid beyond the give of that solid, 0 when there is none."""
    return max([0.0, *(float(s.depth_m(vertices_m).max()) - s.give_m for s in solids)])


def penetrations_m(
    body: Body, vertices_m: NDArray[np.float32], joints_m: Float64
) -> dict[tuple[int, int], float]:
    """Deepest vertex of the first part inside the second, for all pairs that touch."""
    found: dict[tuple[int, int], float] = {}
    cut = _pieces(body.faces.tobytes(), body.face_parts.tobytes())
    low = {i: vertices_m[piece.used].min(axis=0) for i, piece in cut.items()}
    high = {i: vertices_m[piece.used].max(axis=0) for i, piece in cut.items()}
    for a, b in permutations(cut, 2):
        points = vertices_m[cut[a].apart[b]]
        points = points[((points > low[b]) & (points < high[b])).all(axis=1)]
        joints, radius = FOLDS.get(frozenset((a, b)), ((), 0.0))
        for joint in joints:
            points = points[np.linalg.norm(points - joints_m[joint], axis=1) > radius]
        if len(points) == 0:
            continue
        points = np.ascontiguousarray(points, np.float32)
        closed = _scene(*cut[b].closed(vertices_m))
        inside = closed.compute_occupancy(o3d.core.Tensor.from_numpy(points), nsamples=3).numpy() > 0
        if inside.any():
            skin = _scene(vertices_m, cut[b].faces)
            found[a, b] = float(
                skin.compute_distance(o3d.core.Tensor.from_numpy(points[inside])).numpy().max()
            )
    return found


@dataclass(frozen=True)
class _Piece:
    """Skin of one part.

    used: ids of its vertices. borders: edges (E, 2) of its open borders. loops: number (E,) of the border of
    each edge. apart: ids of its vertices that another part lacks, by that part.
    """

    faces: NDArray[np.int32]
    used: NDArray[np.int32]
    borders: NDArray[np.int32]
    loops: NDArray[np.int64]
    apart: dict[int, NDArray[np.int32]]

    def closed(self, vertices_m: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return the vertices and faces with a fan from the middle of every open border over that border."""
        count = self.loops.max(initial=-1) + 1
        middles = [vertices_m[np.unique(self.borders[self.loops == k])].mean(axis=0) for k in range(count)]
        fans = np.column_stack([self.borders[:, ::-1], len(vertices_m) + self.loops]).astype(np.int32)
        vertices = np.concatenate([vertices_m, np.array(middles, np.float32).reshape(-1, 3)])
        return vertices, np.concatenate([self.faces, fans])


@lru_cache(maxsize=4)
def _pieces(faces: bytes, face_parts: bytes) -> dict[int, _Piece]:
    """Cut a body's skin into its parts. All poses and most bodies share their faces."""
    triangles, parts = np.frombuffer(faces, np.int32).reshape(-1, 3), np.frombuffer(face_parts, np.uint8)
    own = {part.id: triangles[parts == part.id] for part in BODY_PARTS}
    used = {i: np.unique(own[i]) for i in own}
    return {
        i: _Piece(own[i], used[i], *_borders(own[i]), {j: np.setdiff1d(used[i], used[j]) for j in own})
        for i in own
    }


def _scene(vertices_m: NDArray[np.float32], faces: NDArray[np.int32]) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    vertices, triangles = (np.ascontiguousarray(a) for a in (vertices_m, faces.astype(np.uint32)))
    scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
    return scene


def _borders(faces: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the edges (E, 2) that belong to one face, and the number (E,) of the loop of each edge."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, index, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    border = edges[index[count == 1]]
    return border, _components(border)


def _components(edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """(E,) number of the connected piece each edge belongs to."""
    nodes, ends = np.unique(edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(len(nodes), len(nodes)))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)[ends[:, 0]]
