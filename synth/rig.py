"""The virtual rig: people in a colour-coded suit on a sofa, seen by depth, colour and thermal cameras.

It is a ``FrameSource`` like any device, and knows the truth of every pixel. Scene, person, suit and
each camera's faults are apart: ``Difficulty`` says how bad each is.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from annotate.labels import FrameLabels
from annotate.parts import N_CLASSES, UNDEFINED
from annotate.registration import KINECT2_DEPTH, undistortion_index
from annotate.suit import DEFAULT_SUIT, Suit
from sensors.calibration import Pose, RigCalibration
from sensors.camera import Intrinsics, distort
from sensors.errors import CloudError
from sensors.frame import RigFrame
from synth.appearance import ColorNoise, Light, body_colors, photograph, shade, surface_colors
from synth.body import Body, shipped_bodies
from synth.motion import ACTIVITIES, Sitting, moments, sit
from synth.noise import DepthNoise, kinect
from synth.render import Mesh, ZBuffer, merge, rasterize
from synth.scene import Sofa, Surface, box, look_at, room
from synth.view import hair_faces
from synth.warmth import (
    SUPERSAMPLE,
    ThermalNoise,
    body_temperatures,
    surface_temperatures,
    thermograph,
)

FLYING_MM = 60.0
"""A reading further than this from the surface behind its pixel belongs to no surface: undefined."""
FRAMES_PER_SECOND = 2.0
AMBIENT_C = 20.5


@dataclass(frozen=True)
class Difficulty:
    """How hard the rig makes it: every strength is a factor on what a good room and device give (1)."""

    name: str
    light: float
    depth: DepthNoise
    color: ColorNoise
    thermal: ThermalNoise
    warmth_c: float
    clutter: bool


DIFFICULTIES = {
    d.name: d
    for d in (
        Difficulty(
            "clean",
            0.0,
            DepthNoise(axial=0, flying=0, grazing=0, dark=0, lateral_px=0),
            ColorNoise(sigma=0, blur_px=0),
            ThermalNoise(netd_c=0, blur_px=0),
            0.0,
            False,
        ),
        Difficulty("normal", 1.0, DepthNoise(), ColorNoise(), ThermalNoise(), 0.5, True),
        Difficulty(
            "hard",
            2.0,
            DepthNoise(axial=2, flying=1, grazing=0.9, dark=0.7, lateral_px=0.8, offset_mm=10),
            ColorNoise(sigma=8, blur_px=1.2, exposure=0.7),
            ThermalNoise(netd_c=0.16, blur_px=1.0, drift_c=1.5),
            1.0,
            True,
        ),
    )
}
SCENES = ("sofa",)

# A real Kinect v2 (serial 196605135147 of iai_kinect2, Apache-2.0): lens of the colour camera and its pose.
_KINECT_COLOR = Intrinsics(
    1920,
    1080,
    1081.37207,
    1081.37207,
    959.5,
    539.5,
    0.0562684,
    -0.0741991,
    0.00142508,
    -0.00169517,
    0.0241077,
)
_COLOR_FROM_DEPTH = Pose(
    Rotation.from_matrix(
        [
            [0.99979884, -0.01687134, -0.01084615],
            [0.0168911, 0.99985583, 0.00173301],
            [0.01081535, -0.00191586, 0.99993968],
        ]
    ).as_matrix(),
    np.array([-0.05205248, -0.00046314, 0.00088807]),
)
# Optris PI200 with its 72 degree lens, mounted 6 cm above the Kinect and tilted 2 degrees down.
_OPTRIS = Intrinsics(160, 120, 110.1, 110.1, 80.3, 59.2, -0.19, 0.04)
_THERMAL_FROM_DEPTH = Pose(
    Rotation.from_euler("x", -2, degrees=True).as_matrix(), np.array([0.012, 0.06, -0.01])
)

RIG_CALIBRATION = RigCalibration(
    KINECT2_DEPTH, _KINECT_COLOR, _COLOR_FROM_DEPTH, _OPTRIS, _THERMAL_FROM_DEPTH
)


@dataclass(frozen=True)
class Truth:
    """What a camera cannot know. parts: uint8 (h, w), raw depth image; joints_m: (J, 3), depth camera."""

    parts: NDArray[np.uint8]
    joints_m: NDArray[np.float64]
    subject: str


@dataclass(frozen=True)
class _Subject:
    """One person with their seat, clothes, light and the robot's place before them."""

    name: str
    body: Body
    sofa: Sofa
    furniture: Mesh
    body_rgb: NDArray[np.float64]
    furniture_rgb: NDArray[np.float64]
    celsius: NDArray[np.float64]
    light: Light
    camera_from_world: Pose


class VirtualRig:
    """Frames of ``subjects`` people, one after another; deterministic in the seed.

    Raises CloudError for counts without sense or an unknown difficulty or scene.
    """

    def __init__(self, frames: int, subjects: int, difficulty: str, seed: int, scene: str = "sofa") -> None:
        if not 1 <= subjects <= frames <= 1_000_000:
            raise CloudError(
                f"{frames} frames of {subjects} subjects are impossible; give at least one frame each"
            )
        if difficulty not in DIFFICULTIES:
            raise CloudError(f"difficulty {difficulty!r} is unknown; use {', '.join(DIFFICULTIES)}")
        if scene not in SCENES:
            raise CloudError(f"scene {scene!r} is unknown; use {', '.join(SCENES)}")
        self.name = f"virtual-{scene}-{difficulty}-{seed}"
        self.calibration = RIG_CALIBRATION
        self.suit: Suit = DEFAULT_SUIT
        self.difficulty = DIFFICULTIES[difficulty]
        self.frames, self.subjects, self.seed = frames, subjects, seed
        self._depth = _optics(KINECT2_DEPTH, 1)
        self._color = _optics(_KINECT_COLOR, 1)
        self._thermal = _optics(_OPTRIS, SUPERSAMPLE)

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[RigFrame]:
        return (frame for frame, _ in self.with_truth())

    def with_truth(self) -> Iterator[tuple[RigFrame, Truth]]:
        """Yield every frame with its truth."""
        current, subject = -1, None
        motion: Iterator[Sitting] = iter(())
        for index in range(self.frames):
            if (number := index * self.subjects // self.frames) != current:
                current = number
                subject, motion = self._meet(number), self._motion(number)
            assert subject is not None
            yield self._shoot(subject, next(motion), index)

    def _motion(self, number: int) -> Iterator[Sitting]:
        rng = np.random.default_rng((self.seed, number, 7))
        return moments(rng, FRAMES_PER_SECOND, tuple(ACTIVITIES))

    def _meet(self, number: int) -> _Subject:
        rng = np.random.default_rng((self.seed, number))
        bodies = shipped_bodies()
        body = bodies[(number + self.seed) % len(bodies)]
        sofa = Sofa.sample(rng)
        furniture = _furniture(sofa, self.difficulty.clutter, rng)
        skin, hair = (
            rng.uniform((150, 100, 80), (230, 180, 150)),
            rng.uniform(20, 110) * np.array([1, 0.85, 0.7]),
        )
        eye = _robot_eye(rng)
        return _Subject(
            f"subject-{number}",
            body,
            sofa,
            furniture,
            body_colors(body, self.suit, skin, hair),
            surface_colors(furniture),
            np.concatenate(
                [
                    body_temperatures(body, rng, self.difficulty.warmth_c),
                    surface_temperatures(furniture, rng, self.difficulty.warmth_c),
                ]
            ),
            Light.sample(rng, self.difficulty.light),
            look_at(eye, np.array([0, 0.0, 0.68]) + rng.normal(0, 0.05, 3), np.radians(rng.normal(0, 1.5))),
        )

    def _shoot(self, subject: _Subject, moment: Sitting, index: int) -> tuple[RigFrame, Truth]:
        rng = np.random.default_rng((self.seed, index, 11))
        vertices, joints = sit(subject.body, subject.sofa, moment)
        person = Mesh(vertices, subject.body.faces, subject.body.face_parts.astype(np.int32))
        scene = merge([person, subject.furniture])
        in_depth = subject.camera_from_world.apply(scene.vertices_m)
        depth_mm, parts = self._see_depth(subject, scene, in_depth, rng)
        color = self._see_color(subject, scene, in_depth, rng)
        thermal = self._see_thermal(subject, scene, in_depth, rng)
        frame = RigFrame(index, round(index * 1e9 / FRAMES_PER_SECOND), depth_mm, color, thermal)
        return frame, Truth(parts, subject.camera_from_world.apply(joints), subject.name)

    def _see_depth(
        self, subject: _Subject, scene: Mesh, in_depth: NDArray[np.float64], rng: np.random.Generator
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
        seen = self._depth.render(in_depth, scene.faces)
        hit = seen.face >= 0
        tags = np.where(hit, scene.tags[seen.face], 0)
        hair = np.zeros(len(scene.faces) + 1, bool)
        hair[: len(subject.body.faces)] = hair_faces(subject.body)
        noisy = kinect(KINECT2_DEPTH, seen.depth_m, hair[seen.face], self.difficulty.depth, rng)
        parts = np.where(tags < N_CLASSES, tags, 0).astype(np.uint8)
        off_mm = np.abs(noisy - (self.difficulty.depth.offset_mm + 1000 * np.nan_to_num(seen.depth_m)))
        parts[(noisy > 0) & (off_mm > FLYING_MM)] = UNDEFINED
        parts[noisy == 0] = 0
        return noisy, parts

    def _see_color(
        self, subject: _Subject, scene: Mesh, in_depth: NDArray[np.float64], rng: np.random.Generator
    ) -> bytes:
        seen = self._color.render_pinhole(_COLOR_FROM_DEPTH.apply(in_depth), scene.faces)
        lit = shade(scene, np.concatenate([subject.body_rgb, subject.furniture_rgb]), subject.light)
        return photograph(seen, lit, self.difficulty.color, self._color.maps, rng)

    def _see_thermal(
        self, subject: _Subject, scene: Mesh, in_depth: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.float32]:
        seen = self._thermal.render_pinhole(_THERMAL_FROM_DEPTH.apply(in_depth), scene.faces)
        return thermograph(seen, subject.celsius, AMBIENT_C, self.difficulty.thermal, self._thermal.maps, rng)


class _Optics:
    """Renders through a distorting lens: a wider pinhole image, and where each real pixel looks in it."""

    def __init__(self, camera: Intrinsics, supersample: int) -> None:
        scaled = replace(
            camera,
            width=camera.width * supersample,
            height=camera.height * supersample,
            fx=camera.fx * supersample,
            fy=camera.fy * supersample,
            cx=(camera.cx + 0.5) * supersample - 0.5,
            cy=(camera.cy + 0.5) * supersample - 0.5,
        )
        u, v = np.meshgrid(np.arange(scaled.width), np.arange(scaled.height))
        distorted = np.stack([(u - scaled.cx) / scaled.fx, (v - scaled.cy) / scaled.fy], axis=-1)
        ideal = _undistort_fast(scaled, distorted)
        x, y = ideal[..., 0] * scaled.fx + scaled.cx, ideal[..., 1] * scaled.fy + scaled.cy
        left, top = max(0, int(np.ceil(-x.min()))), max(0, int(np.ceil(-y.min())))
        wide = replace(
            scaled.undistorted(),
            width=int(np.ceil(x.max())) + left + 1,
            height=int(np.ceil(y.max())) + top + 1,
            cx=scaled.cx + left,
            cy=scaled.cy + top,
        )
        self.pinhole = wide
        self.maps = ((x + left).astype(np.float32), (y + top).astype(np.float32))

    def render_pinhole(self, points: NDArray[np.float64], faces: NDArray[np.int32]) -> ZBuffer:
        """The wide pinhole image, camera frame."""
        return rasterize(self.pinhole, points.astype(np.float32), faces)

    def render(self, points: NDArray[np.float64], faces: NDArray[np.int32]) -> ZBuffer:
        """The image through the lens, every pixel taking the nearest pinhole pixel."""
        wide = self.render_pinhole(points, faces)
        u, v = (np.rint(m).astype(np.intp) for m in self.maps)
        return ZBuffer(wide.depth_m[v, u], wide.face[v, u])


_optics = lru_cache(maxsize=4)(_Optics)
"""Every rig has the same cameras, and the colour camera's map takes a second."""


def _undistort_fast(camera: Intrinsics, distorted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fixed-point inverse of the lens model in few steps: enough for mild lenses (error under 0.01 px)."""
    ideal = distorted.copy()
    for _ in range(12):
        ideal += distorted - distort(camera, ideal)
    return ideal


def _furniture(sofa: Sofa, clutter: bool, rng: np.random.Generator) -> Mesh:
    """The sofa in its room, and with ``clutter`` a radiator, a table and a hot mug on it."""
    back = sofa.depth + 0.9 + rng.uniform(0, 0.5)
    meshes = [sofa.mesh(), room(back)]
    if clutter:
        side = rng.choice((-1, 1))
        x = side * (sofa.width / 2 + sofa.arm_width + 0.45)
        meshes += [
            box((x - 0.22, -0.1, 0.46), (x + 0.22, 0.34, 0.5), Surface.TABLE),
            box((x - 0.04, 0.05, 0.5), (x + 0.04, 0.13, 0.6), Surface.MUG),
            box((-x - 0.4, back - 0.12, 0.15), (-x + 0.4, back - 0.02, 0.75), Surface.RADIATOR),
        ]
    return merge(meshes)


def _robot_eye(rng: np.random.Generator) -> NDArray[np.float64]:
    azimuth, distance = np.radians(rng.uniform(-40, 40)), rng.uniform(1.9, 2.5)
    return np.array([distance * np.sin(azimuth), -distance * np.cos(azimuth), rng.uniform(1.0, 1.35)])


def truth_labels(frame: RigFrame, truth: Truth) -> FrameLabels:
    """The truth over the undistorted depth image, undistorted exactly as fusion does it."""
    source = undistortion_index(KINECT2_DEPTH)
    depth_mm, parts = (
        np.where(source >= 0, image.ravel()[source], 0) for image in (frame.depth_mm, truth.parts)
    )
    parts[depth_mm == 0] = 0
    notes = {"joints_mm": np.rint(truth.joints_m * 1000).astype(int).tolist()}
    return FrameLabels(
        f"{frame.index:06d}",
        depth_mm.astype(np.uint16),
        parts.astype(np.uint8),
        subject=truth.subject,
        status="truth",
        notes=notes,
    )
