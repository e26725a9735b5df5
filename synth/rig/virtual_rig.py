"""Virtual rig: a ``FrameSource`` of people in a colour-coded suit, with the truth of every pixel."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64, Int32
from annotate.parts import PAPER
from annotate.scheme.regions import N_REGIONS
from annotate.scheme.scheme import Scheme
from annotate.suit.palette import Suit
from sensors.errors import CloudError
from sensors.recording.rig_templates import REFERENCE
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from synth.appearance.color_camera import RESTING
from synth.appearance.photograph import ColorCamera
from synth.appearance.random_suit import suit_of
from synth.body.body import Body
from synth.cameras.multipath import STRIDE, multipath_m
from synth.cameras.optics import lens_of
from synth.cameras.pyrometer import Pyrometer
from synth.cameras.sensor import CleanDepth, Sensor
from synth.cameras.thermal_camera import ThermalState, thermograph, through_lens, warmth_seen
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import CASTS, JUDGE, TRAINING, Cast, check_choice
from synth.own_camera import OwnCamera
from synth.random_stream import stream
from synth.rig.difficulty import DIFFICULTIES
from synth.rig.episode import Episode, EpisodeSetup, Scene, SceneState
from synth.rig.locations import SCENES, located
from synth.rig.rig_variants import variant_named, with_camera
from synth.rig.truth import Truth, camera_hardships, scene_hardships, whose_readings
from synth.surface.rasterize import Mesh, ZBuffer

FASTEST = 0.95  # share of a body's vertices slower than its speed
DRAFT_PX, DRAFT_STRIDE = 700, 24  # greatest width of a draft's colour images, and stride of its multipath
JUMP_M_S = 4.0  # a faster vertex was placed elsewhere between two frames
FLAG_CLOSED = "thermal flag closed"


@dataclass(frozen=True)
class RigOptions:
    """Options of a virtual rig.

    scene: a key of ``locations.SCENES``. rig: template name of the cameras in
    ``sensors.recording.rig_templates``; the people depend on cast and seed alone. pyrometer: add one beside
    the thermal camera. suit: None = the cast's own, or one drawn by the seed in another scheme than
    ``paper``. draft: small colour images and coarse multipath, in half the time. wearers: bodies of the
    people; None = all of the cast's. scheme: of the truth's parts; images depend on it through the suit
    alone. camera: depth camera in the place of the rig's. warm_things: share of subjects beside whom a
    laptop, a heating pad or a pet lies.
    """

    scene: str = "sofa"
    frames_per_second: float = 2.0
    rig: str = REFERENCE
    pyrometer: bool = False
    suit: Suit | None = None
    draft: bool = False
    cast: Cast = TRAINING
    wearers: tuple[Body, ...] | None = None
    scheme: Scheme = PAPER
    camera: OwnCamera | None = None
    warm_things: float = 0.0

    def __post_init__(self) -> None:
        check_choice("cast", self.cast, CASTS)
        check_choice("scene", self.scene, SCENES)
        if not 0.1 <= self.frames_per_second <= 30:
            raise CloudError(f"{self.frames_per_second} frames a second are impossible; give 0.1 to 30")


class _Cameras(NamedTuple):
    """Faults and states of the cameras of one recording."""

    depth: Sensor
    color: ColorCamera
    thermal: ThermalState


class VirtualRig(FrameSource):
    """Frames of ``subjects`` people, one after another; deterministic in the seed.

    Raises CloudError for impossible counts or an unknown difficulty.
    """

    def __init__(
        self, frames: int, subjects: int, difficulty: str, seed: int, options: RigOptions = RigOptions()
    ) -> None:
        if not 1 <= subjects <= frames <= 1_000_000:
            raise CloudError(
                f"{frames} frames of {subjects} subjects are impossible; give a frame or more for each "
                "subject, at most 1000000"
            )
        check_choice("difficulty", difficulty, DIFFICULTIES)
        rig, draft, self.scene = options.rig, options.draft, options.scene
        kind = "" if rig == REFERENCE else f"{rig}-"
        self.cast: Cast = options.cast
        kind = f"{JUDGE}-{kind}" if self.cast == JUDGE else kind
        self.name = f"virtual-{kind}{self.scene}-{difficulty}-{seed}"
        self.rig, self._variant = rig, variant_named(rig)
        if (own := options.camera) is not None:
            self._variant = with_camera(self._variant, own, stream(seed, "own camera"))
            self.name = f"{self.name}-own-camera"
        self.calibration = _drafted(self._variant.calibration) if draft else self._variant.calibration
        self._stride = DRAFT_STRIDE if draft else STRIDE
        self.scheme = options.scheme
        self.suit = options.suit or suit_of(self.cast, seed, self.scheme)
        self.difficulty = DIFFICULTIES[difficulty]
        self.frames, self.subjects, self.seed = frames, subjects, seed
        self.frames_per_second = fps = options.frames_per_second
        self._setup = EpisodeSetup(
            located(self.scene, self.cast),
            self.difficulty,
            self.suit,
            seed,
            fps,
            cast=self.cast,
            wearers=options.wearers,
            warm_things=options.warm_things,
        )
        self.times_ns = np.rint(np.arange(frames) / fps * 1e9).astype(np.int64)
        depth, color, color_pose, thermal, thermal_pose, _ = vars(self.calibration).values()
        self._depth, self._color = lens_of(depth, 1), lens_of(color, 1)
        self._thermal = lens_of(thermal, self._variant.supersample)
        self._pyrometer = Pyrometer.drawn(thermal, stream(seed, "pyrometer")) if options.pyrometer else None
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
        depth = self._variant.sensor(faults)
        if isinstance(depth, TimeOfFlight):
            depth = replace(depth, offset_mm=float(offset_mm), scale=float(scale))
        thermal = ThermalState(self._variant.thermal(faults.thermal), rng)
        for number, episode in enumerate(self._episodes()):
            first, end = (-(-n * self.frames // self.subjects) for n in (number, number + 1))
            cameras = _Cameras(depth, self._color_camera(episode.scene), thermal)
            for index, state in zip(range(first, end), episode.states(), strict=False):
                yield self._shoot(episode.scene, state, index, cameras)

    def _episodes(self) -> Iterator[Episode]:
        """Yield the episodes; a thread prepares the next one."""
        with ThreadPoolExecutor(1) as pool:
            following = pool.submit(Episode, self._setup, 0)
            for number in range(self.subjects):
                episode = following.result()
                if number + 1 < self.subjects:
                    following = pool.submit(Episode, self._setup, number + 1)
                yield episode

    def _color_camera(self, scene: Scene) -> ColorCamera:
        lens, pose = self._color, self._color_from_depth @ scene.camera_from_world
        return ColorCamera(lens.pinhole, lens.maps, pose, scene.setting, self.difficulty.color.camera)

    def _shoot(
        self, scene: Scene, state: SceneState, index: int, cameras: _Cameras
    ) -> tuple[RigFrame, Truth]:
        rng, time_s = stream(self.seed, "shot", index), index / self.frames_per_second
        in_depth = scene.camera_from_world.apply(state.vertices_m)
        seen = self._see_distance(in_depth, scene.faces, cameras.depth)
        clean = CleanDepth(self.calibration.depth, seen.depth_m, scene.dark[seen.face])
        reading = cameras.depth.read(clean, rng)
        velocity = _velocity_m_s(state, self.frames_per_second)
        mesh = Mesh(state.vertices_m, scene.faces, scene.tags)
        color = cameras.color.photograph(mesh, scene.outfits, rng, velocity)
        drift_c, spot_c, temperatures = cameras.thermal.drift_c(time_s), np.nan, None
        noise, closed = cameras.thermal.noise, cameras.thermal.flag_closed(time_s)
        if not closed or self._pyrometer:
            warm = self._warmth(scene, state, velocity, [0.0] if closed else noise.delays_s(rng))
            warm = through_lens(warm, self._thermal)
            if self._pyrometer:
                spot_c = self._pyrometer.read_c(warm, stream(self.seed, "pyrometer's reading", index))
            if not closed:
                temperatures = thermograph(warm, noise, drift_c, rng)
        frame = RigFrame(index, round(time_s * 1e9), reading.depth_mm, color, temperatures)
        owners = whose_readings(seen, scene.tags, reading, cameras.depth)
        alone = self._depth.render(in_depth[: scene.subject], scene.faces[scene.tags <= N_REGIONS])
        hard = scene_hardships(scene, state, seen, alone, self.calibration.depth)
        speed = np.quantile(np.linalg.norm(velocity[: scene.subject], axis=1), FASTEST)
        hard += camera_hardships(float(speed), cameras.color.state or RESTING, drift_c)
        hard += [FLAG_CLOSED] * (temperatures is None)
        joints = scene.camera_from_world.apply(state.joints_m)
        return frame, Truth(*owners, joints, scene.name, scene.bodies, tuple(hard), drift_c, spot_c)

    def _see_distance(self, in_depth: Float64, faces: Int32, sensor: Sensor) -> ZBuffer:
        """Return depth and faces of the depth image without noise. in_depth: vertices in the depth camera's
        frame.
        """
        seen = self._depth.render(in_depth, faces)
        if self.difficulty.reflectance == 0 or not isinstance(sensor, TimeOfFlight):
            return seen
        longer_m = multipath_m(
            self.calibration.depth, seen.depth_m, self.difficulty.reflectance, self._stride
        )
        return ZBuffer(seen.depth_m + longer_m, seen.face)

    def _warmth(self, scene: Scene, state: SceneState, velocity: Float64, delays_s: list[float]) -> Float32:
        """Return the mean of temperature images, each as old as one of the delays, in the thermal camera's
        wide pinhole.
        """
        pose = self._thermal_from_depth @ scene.camera_from_world
        images = []
        for delay_s in delays_s:
            points = state.vertices_m - delay_s * velocity if delay_s else state.vertices_m
            seen = self._thermal.render_pinhole(pose.apply(points), scene.faces)
            images.append(warmth_seen(seen, state.celsius, scene.room_c))
        return np.mean(images, axis=0, dtype=np.float32) if len(images) > 1 else images[0]


def _drafted(calibration: RigCalibration) -> RigCalibration:
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


def _velocity_m_s(state: SceneState, frames_per_second: float) -> Float64:
    """Return the velocity (V, 3) of the vertices; 0 for a vertex whose position jumps."""
    velocity = (state.following_m - state.vertices_m).astype(np.float64) * frames_per_second
    velocity[np.linalg.norm(velocity, axis=1) > JUMP_M_S] = 0.0
    return velocity
