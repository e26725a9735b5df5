"""Furniture, room and cameras. World frame: z up, metres; the person faces -y towards the robot."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sensors.calibration import Pose
from synth.render import Mesh, merge


class Surface(IntEnum):
    """Tags of rendered faces that are no body part (body faces carry their part id, 1 to 11)."""

    FLOOR = 16
    WALL = 17
    SOFA = 18
    BED = 19
    TABLE = 20
    RADIATOR = 21
    MUG = 22
    HAIR = 23


@dataclass(frozen=True)
class Sofa:
    """Where a person sits. Metres; the seat's front edge is at y = 0, the back rest starts at y = depth."""

    seat_height: float = 0.42
    depth: float = 0.56
    width: float = 1.7
    back_height: float = 0.48
    back_tilt_rad: float = 0.26
    arm_height: float = 0.20
    arm_width: float = 0.18

    @staticmethod
    def sample(rng: np.random.Generator) -> "Sofa":
        """A sofa or arm-chair of common furniture dimensions."""
        return Sofa(
            seat_height=rng.uniform(0.38, 0.47),
            depth=rng.uniform(0.48, 0.62),
            width=rng.uniform(0.62, 2.0),
            back_height=rng.uniform(0.35, 0.75),
            back_tilt_rad=rng.uniform(0.12, 0.38),
            arm_height=rng.uniform(0.12, 0.26),
        )

    def back_y(self, z_m: NDArray[np.floating]) -> NDArray[np.floating]:  # type: ignore[type-arg]
        """Where the back rest's front face lies at height z (world)."""
        return self.depth + np.tan(self.back_tilt_rad) * np.maximum(z_m - self.seat_height, 0)

    def mesh(self) -> Mesh:
        """Seat, back rest and arm rests as boxes."""
        half, h = self.width / 2, self.seat_height
        back = box((-half, 0, 0), (half, 0.16, self.back_height), Surface.SOFA)
        tilt = Rotation.from_euler("x", -self.back_tilt_rad).as_matrix()
        back = _moved(back, tilt, np.array([0, self.depth, h]))
        seat = box((-half, 0, 0.05), (half, self.depth + 0.16, h), Surface.SOFA)
        arms = [
            box((x, 0, 0.05), (x + self.arm_width, self.depth + 0.1, h + self.arm_height), Surface.SOFA)
            for x in (-half - self.arm_width, half)
        ]
        return merge([seat, back, *arms])


def box(low: tuple[float, float, float], high: tuple[float, float, float], tag: int) -> Mesh:
    """Axis-aligned box as 12 triangles."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([(a, b, c) for a in x for b in y for c in z], np.float32)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh(corners, faces, np.full(len(faces), tag, np.int32))


def sheet(origin: NDArray[np.float64], along: NDArray[np.float64], across: NDArray[np.float64], tag: int) -> Mesh:
    """Rectangle cut into quarter-metre cells, so that a cell behind the camera can be dropped alone."""
    n, m = (max(1, int(np.ceil(np.linalg.norm(side) / 0.25))) for side in (along, across))
    i, j = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    vertices = (origin + i[..., None] * along + j[..., None] * across).reshape(-1, 3).astype(np.float32)
    a = (np.arange(n)[:, None] * (m + 1) + np.arange(m)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + 1, a + m + 2], axis=1), np.stack([a, a + m + 2, a + m + 1], axis=1)]
    ).astype(np.int32)
    return Mesh(vertices, faces, np.full(len(faces), tag, np.int32))


def room(back_wall_y: float, half_width: float = 2.5, front_y: float = -3.5, height: float = 2.5) -> Mesh:
    """Floor, back wall and two side walls."""
    depth = np.array([0, back_wall_y - front_y, 0])
    width, up = np.array([2 * half_width, 0, 0]), np.array([0, 0, height])
    corner = np.array([-half_width, front_y, 0])
    return merge(
        [
            sheet(corner, width, depth, Surface.FLOOR),
            sheet(corner + depth, width, up, Surface.WALL),
            sheet(corner, depth, up, Surface.WALL),
            sheet(corner + width, depth, up, Surface.WALL),
        ]
    )


def look_at(eye_m: NDArray[np.float64], target_m: NDArray[np.float64], roll_rad: float = 0.0) -> Pose:
    """``camera_from_world`` of a camera at ``eye_m`` whose axis meets ``target_m``; x stays level but for roll."""
    forward = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    rotation = Rotation.from_euler("z", roll_rad).as_matrix() @ level
    return Pose(rotation, -rotation @ eye_m)


def _moved(mesh: Mesh, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> Mesh:
    return Mesh((mesh.vertices_m @ rotation.T + translation).astype(np.float32), mesh.faces, mesh.tags)
