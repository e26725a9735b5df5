"""Penetration of a posed body by itself, measured on its skin, and by furniture.

The skin is cut into the eleven parts, each closed by a fan over its open borders. A vertex of one part
inside another is as deep as its distance to that other part's skin (fans do not count); the deepest of all
counts. Where two parts meet skin folds and flesh is pressed flat, so vertices near the joint between them are
left out: ``FOLDS`` names the joint and the radius for every such pair, and no other pair has any relief.
"""

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
    ids = [part.id for part in BODY_PARTS]
    faces = {i: body.faces[body.face_parts == i] for i in ids}
    used = {i: np.unique(faces[i]) for i in ids}
    low = {i: vertices_m[used[i]].min(axis=0) for i in ids}
    high = {i: vertices_m[used[i]].max(axis=0) for i in ids}
    closed = {i: _scene(*_close(vertices_m, faces[i])) for i in ids}
    skin = {i: _scene(vertices_m, faces[i]) for i in ids}
    for a, b in permutations(ids, 2):
        points = vertices_m[np.setdiff1d(used[a], used[b])]
        points = points[((points > low[b]) & (points < high[b])).all(axis=1)]
        joints, radius = FOLDS.get(frozenset((a, b)), ((), 0.0))
        for joint in joints:
            points = points[np.linalg.norm(points - joints_m[joint], axis=1) > radius]
        if len(points) == 0:
            continue
        points = np.ascontiguousarray(points, np.float32)
        inside = closed[b].compute_occupancy(o3d.core.Tensor.from_numpy(points), nsamples=3).numpy() > 0
        if inside.any():
            found[a, b] = float(
                skin[b].compute_distance(o3d.core.Tensor.from_numpy(points[inside])).numpy().max()
            )
    return found


def _scene(vertices_m: NDArray[np.float32], faces: NDArray[np.int32]) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    vertices, triangles = (np.ascontiguousarray(a) for a in (vertices_m, faces.astype(np.uint32)))
    scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
    return scene


def _close(
    vertices_m: NDArray[np.float32], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The mesh with a fan from its middle over every open border."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, index, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    border = edges[index[count == 1]]
    loop = _components(border)
    middles = [vertices_m[np.unique(border[loop == k])].mean(axis=0) for k in range(loop.max(initial=-1) + 1)]
    fans = np.column_stack([border[:, ::-1], len(vertices_m) + loop]).astype(np.int32)
    return np.concatenate([vertices_m, np.array(middles, np.float32).reshape(-1, 3)]), np.concatenate(
        [faces, fans]
    )


def _components(edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """(E,) number of the connected piece each edge belongs to."""
    nodes, ends = np.unique(edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(len(nodes), len(nodes)))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)[ends[:, 0]]
