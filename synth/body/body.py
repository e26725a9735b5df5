"""Baked body: mesh, parts, skeleton and skinning weights."""

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

import numba
import numpy as np

from annotate.array_types import Bool, Float32, Float64, Int32, Int64, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from sensors.errors import FormatError, fault_of
from sensors.files.atomic import replacing
from sensors.files.npz import load_arrays
from sensors.rig.camera import FloatArray
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, alignment, kinematics
from synth.data_files import shipped

REFERENCE_BODY = 4  # index of the shipped body of 1.70 m on which marker sets are stated
BONES_PER_VERTEX = 4  # strongest joints of anny that move a vertex
DENSITY_KG_M3 = 980.0  # as in anny's Anthropometry
MAX_BYTES = 50_000_000  # of an unpacked body or crowd: a shipped body has 0.8 MB, the crowd 3 MB


@dataclass(frozen=True, eq=False)
class Body:
    """Shape of one person at rest; equality is by identity.

    vertices_m: float32 (V, 3) rest pose, x to the person's left, y back, z up, soles at z = 0. faces: int32
    (F, 3). face_parts: uint8 (F,) part ids. joints_m: float64 (J, 3) at rest. bones: uint8 (V, 4) joint per
    influence. weights: float32 (V, 4), rows sum to 1. waist: int32 (n,) vertices of the waist ring. firm_m:
    float32 (V, 3) firm surface under thick cloth; None: the skin. Raises FormatError when shapes disagree.
    """

    name: str
    vertices_m: Float32
    faces: Int32
    face_parts: UInt8
    joints_m: Float64
    bones: UInt8
    weights: Float32
    waist: Int32
    firm_m: Float32 | None = None

    def __post_init__(self) -> None:
        v, f = len(self.vertices_m), len(self.faces)
        expected = {
            "vertices_m": (v, 3),
            "faces": (f, 3),
            "face_parts": (f,),
            "joints_m": (N_JOINTS, 3),
            "bones": (v, BONES_PER_VERTEX),
            "weights": (v, BONES_PER_VERTEX),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise FormatError(f"body {self.name}: {name} is {getattr(self, name).shape}; give {shape}")
        if (
            self.faces.size == 0
            or self.faces.min() < 0
            or self.faces.max() >= v
            or self.bones.max() >= N_JOINTS
            or ((self.waist < 0) | (self.waist >= v)).any()
        ):
            raise FormatError(
                f"body {self.name}: indices exceed its vertices; bake it again with 'synth bodies'"
            )

    @property
    def vertex_parts(self) -> UInt8:
        """Return the part id of each vertex (V,); on a border, the part of the last face."""
        parts = np.zeros(len(self.vertices_m), np.uint8)
        parts[self.faces.ravel()] = np.repeat(self.face_parts, 3)
        return parts

    @property
    def strongest_joints(self) -> UInt8:
        """Return the joint with the largest weight of each vertex (V,)."""
        return np.asarray(self.bones[np.arange(len(self.bones)), self.weights.argmax(axis=1)])

    @property
    def height_cm(self) -> float:
        return 100 * float(np.ptp(self.vertices_m[:, 2]))

    @property
    def weight_kg(self) -> float:
        """Return the body's weight: enclosed volume times the density of the human body."""
        return volume_m3(self.vertices_m, self.faces) * DENSITY_KG_M3

    @property
    def waist_breadth_cm(self) -> float:
        return 100 * float(np.ptp(self.vertices_m[self.waist, 0]))


def hair_faces(body: Body) -> Bool:
    """Return flags (F,) of the faces with hair: the head above the brow, and its back down to the neck."""
    on_head: Bool = body.face_parts == PAPER.table[Region.HEAD]
    _, y, z = body.vertices_m[body.faces[on_head]].mean(axis=1).T
    head = body.joints_m[JOINT_ID["head"]]
    top = body.vertices_m[:, 2].max()
    above = z > head[2] + 0.6 * (top - head[2])
    behind = (y > head[1] + 0.02) & (z > head[2])
    on_head[on_head] = above | behind
    return on_head


def volume_m3(vertices_m: FloatArray, faces: Int32) -> float:
    """Return the volume enclosed by a triangle mesh, in cubic metres (sum of signed tetrahedra)."""
    a, b, c = (vertices_m[faces[:, i]].astype(np.float64) for i in range(3))
    return abs(float(np.einsum("ij,ij->", np.cross(a, b), c))) / 6


def pose(body: Body, posture: Posture, only: Int64 | None = None) -> tuple[Float32, Float64]:
    """Return vertices float32 (V, 3) and joints (J, 3) of a posed body (linear blend skinning), world,
    metres.

    only: indices (n,) of the vertices to return; default all.
    """
    matrices, joints = _matrices(posture.angles_rad, posture.pelvis_m, body.joints_m, _aligned(body))
    own = slice(None) if only is None else only
    return _skin(body.vertices_m[own], body.bones[own], body.weights[own], matrices), joints


@lru_cache(maxsize=16)
def _aligned(body: Body) -> Float64:
    return alignment(body.joints_m)


@numba.njit(cache=True)
def _matrices(
    angles_rad: Float64, pelvis_m: Float64, rest_joints_m: Float64, aligned: Float64
) -> tuple[Float32, Float64]:
    """Return transforms float32 (J, 3, 4) from rest to world, and the joints (J, 3)."""
    _, frames, joints = kinematics(angles_rad, pelvis_m, rest_joints_m, aligned)
    matrices = np.empty((N_JOINTS, 3, 4), np.float32)
    for j in range(N_JOINTS):
        x, y, z = rest_joints_m[j]
        for a in range(3):
            moved = frames[j, a, 0] * x + frames[j, a, 1] * y + frames[j, a, 2] * z
            matrices[j, a, :3], matrices[j, a, 3] = frames[j, a], joints[j, a] - moved
    return matrices, joints


@numba.njit(cache=True)
def _skin(vertices: Float32, bones: UInt8, weights: Float32, matrices: Float32) -> Float32:
    result = np.empty_like(vertices)
    for v in range(len(vertices)):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        a, b, c = np.float32(0), np.float32(0), np.float32(0)
        for k in range(bones.shape[1]):
            w = weights[v, k]
            if w > 0:
                m = matrices[bones[v, k]]
                a += w * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3])
                b += w * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3])
                c += w * (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
        result[v, 0], result[v, 1], result[v, 2] = a, b, c
    return result


def save_body(path: Path, body: Body) -> None:
    """Write a naked body as a compressed npz without pickles."""
    arrays = {k: v for k, v in vars(body).items() if k not in ("name", "firm_m")}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_body(path: Path) -> Body:
    """Read a baked body. Raises FormatError when the file is damaged."""
    remedy = "bake it with 'synth bodies'"
    arrays = load_arrays(path, MAX_BYTES, remedy)
    try:
        return Body(path.stem, **arrays)
    except (TypeError, ValueError) as error:
        raise FormatError(f"body {path} cannot be read ({fault_of(error)}); {remedy}") from error


@cache
def shipped_bodies() -> tuple[Body, ...]:
    """Return the paper's eight bodies (Table 1), baked from anny."""
    return tuple(load_body(path) for path in sorted(shipped().glob("body_*.npz")))


def reference_body() -> Body:
    return shipped_bodies()[REFERENCE_BODY]


def blend(a: Body, b: Body, share: float) -> Body:
    """Interpolate two naked bodies of one topology, with the parts of ``a``; share of ``b`` in [0, 1]."""
    return replace(
        a,
        vertices_m=np.float32(1 - share) * a.vertices_m + np.float32(share) * b.vertices_m,
        joints_m=(1 - share) * a.joints_m + share * b.joints_m,
    )
