"""Recorded motion on the virtual rig: a person in a suit in a room, 30 frames a second."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Float64
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from synth.body.body import Body, pose
from synth.markers.motion_file import Motion
from synth.markers.person_fit import person_body
from synth.motion.grounded import ground, resampled
from synth.motion.placed import Performance, perform
from synth.pose.pose_parameters import Moment, Posed
from synth.rig.difficulty import Clutter
from synth.rig.locations import Location
from synth.rig.virtual_rig import RigOptions, VirtualRig
from synth.surface.furniture import Ground
from synth.surface.rasterize import beside, look_at
from synth.surface.room import PLAIN_ROOM

FRAMES_PER_SECOND = 30.0  # of a Kinect
SHORTEST_S = 0.3  # of a motion; untuned
DISTANCES_M = (1.9, 2.2, 2.5, 2.8, 3.1)  # of the camera; the first with the whole motion in view; untuned
IN_VIEW = 0.84  # share of the depth image that holds the motion: the colour camera's view is flatter
BEHIND_M = 0.6  # between the motion and the wall; untuned


@dataclass(frozen=True, eq=False)
class PlayedActivity:
    """Recorded performance as an activity; its pose parameter is a frame number."""

    performance: Performance

    def draw(self, rng: np.random.Generator) -> Moment:
        """Draw the pose parameter of a random frame."""
        return {"frame": float(rng.integers(len(self.performance.postures)))}

    def stream(self, rng: np.random.Generator, frames_per_second: float) -> Iterator[Moment]:
        """Yield all frames in order, then repeat the last."""
        last = len(self.performance.postures) - 1
        frame = 0
        while True:
            yield {"frame": float(min(frame, last))}
            frame += 1

    def pose(self, body: Body, moment: Moment) -> Posed:
        """Return the performer's vertices and joints in a frame."""
        return pose(body, self.performance.postures[int(moment["frame"])])


class FilmRig(VirtualRig):
    """Virtual rig that records one motion, on a body of the recorded person's size; deterministic in the
    seed. scheme: of the truth's parts.

    Raises CloudError for a short motion or an unknown difficulty.
    """

    def __init__(self, name: str, motion: Motion, difficulty: str, seed: int, scheme: Scheme = PAPER) -> None:
        seconds = len(motion) / motion.frames_per_second
        if seconds < SHORTEST_S or len(motion) < 3:
            raise CloudError(
                f"{name} has {len(motion)} frames in {seconds:.2f} s; give {SHORTEST_S} s and 3 frames "
                "or more"
            )
        body = person_body(motion.bones_m)
        self._played = PlayedActivity(perform(body, ground(resampled(motion, FRAMES_PER_SECOND))))
        frames = len(self._played.performance.postures)
        options = RigOptions(frames_per_second=FRAMES_PER_SECOND, scheme=scheme)
        super().__init__(frames, 1, difficulty, seed, options)
        self.name, self.scene = f"film-{name}-{difficulty}-{seed}", "motion"
        calm = Clutter(radiator=self.difficulty.clutter.radiator, window=self.difficulty.clutter.window)
        self.difficulty = replace(self.difficulty, clutter=calm)
        self._setup = self._setup._replace(
            location=self._location, difficulty=self.difficulty, body=self._played.performance.body
        )

    def _location(self, rng: np.random.Generator) -> Location:
        """Draw a room with the wall behind the person and the robot in front."""
        performance = self._played.performance
        joints = np.concatenate([pose(performance.body, p)[1] for p in performance.postures[::5]])
        azimuth = float(np.radians(rng.uniform(-30, 30)))
        eye, target = _eye(self.calibration.depth, joints, azimuth, float(rng.uniform(1.0, 1.5)))

        def view(rng: np.random.Generator, stray: float) -> tuple[Float64, Float64]:
            return eye, target + stray * rng.normal(0, 0.03, 3)

        furniture = performance.seat or Ground(length=0.0, width=0.0)
        behind = max(float(joints[:, 1].max()), furniture.footprint.back_y)
        return Location(furniture, behind + BEHIND_M, self._played, False, view)


def _eye(
    camera: Intrinsics, joints_m: Float64, azimuth_rad: float, height_m: float
) -> tuple[Float64, Float64]:
    """Return eye and target (3,) of the nearest camera in the room with all joints (n, 3) in view."""
    target = (joints_m.min(axis=0) + joints_m.max(axis=0)) / 2
    half = np.array([camera.width, camera.height]) / 2 * IN_VIEW
    for distance in DISTANCES_M:
        eye = beside(target, azimuth_rad, distance, height_m)
        eye[1] = max(eye[1], PLAIN_ROOM.front_y + 0.2)
        x, y, z = look_at(eye, target).apply(joints_m).T
        off = np.abs(np.stack([x, y], axis=1)) * camera.fx / np.maximum(z, 0.1)[:, None]
        if (off < half).all():
            break
    return eye, target
