"""The virtual rig: people in a colour-coded suit before depth, colour and heat cameras on furniture or floor.

It is a ``FrameSource`` like any device, with the truth of every pixel. Scene, person, suit and each
camera's faults are apart; ``Difficulty`` holds the strength of each.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64, Int32
from annotate.parts import N_CLASSES
from annotate.suit.palette import DEFAULT_SUIT, Suit
from sensors.errors import CloudError
from sensors.recording.rig_templates import REFERENCE
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from synth.appearance.color_camera import RESTING
from synth.appearance.photograph import ColorCamera
from synth.cameras.multipath import STRIDE, multipath_m
from synth.cameras.optics import lens_of
from synth.cameras.pyrometer import Pyrometer
from synth.cameras.sensor import CleanDepth, Sensor
from synth.cameras.thermal_camera import ThermalState, thermograph, through_lens, warmth_seen
from synth.cameras.time_of_flight import TimeOfFlight
from synth.choices import check_rig
from synth.random_stream import stream
from synth.rig.difficulty import DIFFICULTIES
from synth.rig.episode import Cast, Stay, Tableau
from synth.rig.locations import SCENES
from synth.rig.rig_variants import twin_named
from synth.rig.truth import Truth, camera_hardships, scene_hardships, whose_readings
from synth.surface.rasterize import Mesh, ZBuffer

FRAMES_PER_SECOND = 2.0
"""Of a simulated session: few, so that postures differ from frame to frame. Chosen by eye."""
FASTEST = 0.95
"""Share of a body that is slower than what counts as its speed."""
DRAFT_PX, DRAFT_STRIDE = 700, 24
"""Width of a draft's colour images at most, and its `synth.cameras.multipath.STRIDE`: both for speed. Chosen
by eye."""
JUMP_M_S = 4.0
"""Nothing in a living room moves faster; what does was put elsewhere between two frames."""
FLAG_CLOSED = "thermal flag closed"
"""The event of a frame whose temperatures the flag has hidden."""


class _Cameras(NamedTuple):
    """The faults and states of one recording's cameras."""

    depth: Sensor
    color: ColorCamera
    thermal: ThermalState


class VirtualRig(FrameSource):
    """Frames of ``subjects`` people, one after another; deterministic in the seed.

    rig: which cameras (``sensors.recording.rig_templates``). A seed has the same people before every rig.
    pyrometer: whether one stands beside the thermal camera; it changes nothing else. draft: whether colour
    images are small and light that bounces is coarse, which takes half the time: to train on.
    Raises CloudError for counts without sense or an unknown difficulty, scene or rig.
    """

    def __init__(
        self,
        frames: int,
        subjects: int,
        difficulty: str,
        seed: int,
        scene: str = "sofa",
        frames_per_second: float = FRAMES_PER_SECOND,
        rig: str = REFERENCE,
        pyrometer: bool = False,
        suit: Suit = DEFAULT_SUIT,
        draft: bool = False,
    ) -> None:
        check_rig(frames, subjects, scene, difficulty)
        if not 0.1 <= frames_per_second <= 30:
            raise CloudError(f"{frames_per_second} frames a second are impossible; give 0.1 to 30")
        kind = "" if rig == REFERENCE else f"{rig}-"
        self.name = f"virtual-{kind}{scene}-{difficulty}-{seed}"
        self.rig, self._twin = rig, twin_named(rig)
        self.calibration = _drafted(self._twin.calibration) if draft else self._twin.calibration
        self._stride = DRAFT_STRIDE if draft else STRIDE
        self.suit = suit
        self.difficulty = DIFFICULTIES[difficulty]
        self.frames, self.subjects, self.seed, self.scene = frames, subjects, seed, scene
        self.frames_per_second = frames_per_second
        self.times_ns = np.rint(np.arange(frames) / frames_per_second * 1e9).astype(np.int64)
        depth, color, color_pose, thermal, thermal_pose, _ = vars(self.calibration).values()
        self._depth, self._color = lens_of(depth, 1), lens_of(color, 1)
        self._thermal = lens_of(thermal, self._twin.supersample)
        self._pyrometer = Pyrometer.drawn(thermal, stream(seed, "pyrometer")) if pyrometer else None
        self._color_from_depth: Pose = color_pose
        self._thermal_from_depth: Pose = thermal_pose

    def __iter__(self) -> Iterator[RigFrame]:
        return (frame for frame, _ in self.with_truth())

    def _frame(self, index: int) -> RigFrame:
        # Cameras drift and people settle: a frame depends on those before it.
        return next(islice(self, index, None))

    def with_truth(self) -> Iterator[tuple[RigFrame, Truth]]:
        """Yield every frame with its truth."""
        rng, faults = stream(self.seed, "unit of the cameras"), self.difficulty
        offset_mm, scale = rng.normal(0, faults.unit_mm), rng.normal(1, faults.unit_scale)
        depth = self._twin.sensor(faults)
        if isinstance(depth, TimeOfFlight):
            depth = replace(depth, offset_mm=float(offset_mm), scale=float(scale))
        thermal = ThermalState(self._twin.thermal(faults.thermal), rng)
        for number, stay in enumerate(self._stays()):
            first, end = (-(-n * self.frames // self.subjects) for n in (number, number + 1))
            cameras = _Cameras(depth, self._color_camera(stay.cast), thermal)
            for index, tableau in zip(range(first, end), stay.tableaux(), strict=False):
                yield self._shoot(stay.cast, tableau, index, cameras)

    def _stays(self) -> Iterator[Stay]:
        """The people one after another; the next one settles while the one before is recorded."""
        with ThreadPoolExecutor(1) as beside:
            coming = beside.submit(self._stay, 0)
            for number in range(self.subjects):
                stay = coming.result()
                if number + 1 < self.subjects:
                    coming = beside.submit(self._stay, number + 1)
                yield stay

    def _stay(self, number: int) -> Stay:
        place = SCENES[self.scene]
        return Stay(place, self.difficulty, self.suit, self.seed, number, self.frames_per_second)

    def _color_camera(self, cast: Cast) -> ColorCamera:
        lens, pose = self._color, self._color_from_depth @ cast.camera_from_world
        return ColorCamera(lens.pinhole, lens.maps, pose, cast.setting, self.difficulty.color.camera)

    def _shoot(self, cast: Cast, tableau: Tableau, index: int, cameras: _Cameras) -> tuple[RigFrame, Truth]:
        rng, time_s = stream(self.seed, "shot", index), index / self.frames_per_second
        in_depth = cast.camera_from_world.apply(tableau.vertices_m)
        seen = self._see_distance(in_depth, cast.faces, cameras.depth)
        clean = CleanDepth(self.calibration.depth, seen.depth_m, cast.dark[seen.face])
        reading = cameras.depth.read(clean, rng)
        velocity = _velocity_m_s(tableau, self.frames_per_second)
        scene = Mesh(tableau.vertices_m, cast.faces, cast.tags)
        color = cameras.color.photograph(scene, cast.outfits, rng, velocity)
        drift_c, spot_c, temperatures = cameras.thermal.drift_c(time_s), np.nan, None
        noise, closed = cameras.thermal.noise, cameras.thermal.flag_closed(time_s)
        if not closed or self._pyrometer:
            warm = self._warmth(cast, tableau, velocity, [0.0] if closed else noise.delays_s(rng))
            warm = through_lens(warm, self._thermal)
            if self._pyrometer:
                spot_c = self._pyrometer.read_c(warm, stream(self.seed, "pyrometer's reading", index))
            if not closed:
                temperatures = thermograph(warm, noise, drift_c, rng)
        frame = RigFrame(index, round(time_s * 1e9), reading.depth_mm, color, temperatures)
        parts, persons = whose_readings(seen, cast.tags, reading, cameras.depth)
        alone = self._depth.render(in_depth[: cast.subject], cast.faces[cast.tags < N_CLASSES])
        hard = scene_hardships(cast, tableau, seen, alone, self.calibration.depth)
        speed = np.quantile(np.linalg.norm(velocity[: cast.subject], axis=1), FASTEST)
        hard += camera_hardships(float(speed), cameras.color.state or RESTING, drift_c)
        hard += [FLAG_CLOSED] * (temperatures is None)
        joints = cast.camera_from_world.apply(tableau.joints_m)
        return frame, Truth(parts, persons, joints, cast.name, tuple(hard), drift_c, spot_c)

    def _see_distance(self, in_depth: Float64, faces: Int32, sensor: Sensor) -> ZBuffer:
        """What the depth camera would read without noise."""
        seen = self._depth.render(in_depth, faces)
        if self.difficulty.reflectance == 0 or not isinstance(sensor, TimeOfFlight):
            return seen
        longer_m = multipath_m(
            self.calibration.depth, seen.depth_m, self.difficulty.reflectance, self._stride
        )
        return ZBuffer(seen.depth_m + longer_m, seen.face)

    def _warmth(self, cast: Cast, tableau: Tableau, velocity: Float64, delays_s: list[float]) -> Float32:
        """Temperatures in the thermal camera's wide pinhole: the mean of what was there each delay ago."""
        pose = self._thermal_from_depth @ cast.camera_from_world
        images = []
        for delay_s in delays_s:
            points = tableau.vertices_m - delay_s * velocity if delay_s else tableau.vertices_m
            seen = self._thermal.render_pinhole(pose.apply(points), cast.faces)
            images.append(warmth_seen(seen, tableau.celsius, cast.room_c))
        return np.mean(images, axis=0, dtype=np.float32) if len(images) > 1 else images[0]


def _drafted(calibration: RigCalibration) -> RigCalibration:
    """The calibration with a colour camera of few pixels."""
    color = calibration.color
    assert color is not None
    by = min(1.0, DRAFT_PX / color.width)
    small = replace(
        color,
        width=round(color.width * by),
        height=round(color.height * by),
        fx=color.fx * by,
        fy=color.fy * by,
        cx=(color.cx + 0.5) * by - 0.5,
        cy=(color.cy + 0.5) * by - 0.5,
    )
    return replace(calibration, color=small)


def _velocity_m_s(tableau: Tableau, frames_per_second: float) -> Float64:
    """How fast all vertices (V, 3) move; what is put down elsewhere stands still until then."""
    velocity = (tableau.following_m - tableau.vertices_m).astype(np.float64) * frames_per_second
    velocity[np.linalg.norm(velocity, axis=1) > JUMP_M_S] = 0.0
    return velocity
