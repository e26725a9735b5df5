"""Correction of a person's joints by a small network, from all of them at once.

The depth network places each joint alone, at a peak of its heat map (docs/adr/0029). The correction takes
all joints as inputs, with deviations, visibilities, the regions' places, facing and posture (docs/adr/0036).
``python -m tools.fit.joint_correction`` trains it.
"""

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np

from annotate.array_types import Float32, Float64
from annotate.onnx_session import Network, onnx_session
from annotate.posture import POSTURES
from annotate.scheme.regions import N_REGIONS, Region
from eval.network.body_state import BodyState
from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS, TWIN
from sensors.rig.camera import Intrinsics

LEAST_SD_MM = 1.0  # bounds a joint's weight in the middle
SCALES_MM = 300.0, 50.0, 2000.0  # of joints about their middle, of deviations, of the distance
LEAST_MM2 = 400.0  # visible surface of a region whose place is used
TWIN_REGION = np.array([region.twin - 1 for region in Region])
FEATURES = N_JOINTS * (3 + 2 + len(VISIBILITIES)) + 2 + len(POSTURES) + 3 + 4 * N_REGIONS
"""Number of the network's inputs."""


@dataclass(frozen=True, eq=False)
class LocalJoints:
    """Joints of one person about their middle, seen along the ray through it, in millimetres.

    joints_mm, deviations_mm: (15, 3), right, down, and away. seen: (15, 3), probabilities of
    ``VISIBILITIES``. facing: (2,), cosine and sine of the azimuth, times its certainty. posture: (P,)
    probabilities. ray: (2,), of the middle, at distance 1. middle_mm: distance of the middle. regions: (24,
    4) by ``Region``, visible surface in square millimetres and mean point; 0 for small regions.
    """

    joints_mm: Float64
    deviations_mm: Float64
    seen: Float64
    facing: Float64
    posture: Float64
    ray: Float64
    middle_mm: float
    regions: Float64

    @classmethod
    def of(cls, state: BodyState, camera: Intrinsics, places: Float64) -> "LocalJoints":
        """Return the joints of a state that has deviations. camera: the undistorted depth camera. places:
        (24, 4), see ``region_places``.
        """
        assert state.joints_sd is not None and state.joints_seen is not None
        z = state.joints_px[:, 2]
        sideways, away = state.joints_sd.T
        weights = 1 / (np.square(sideways * z / camera.fx) + np.square(away) + LEAST_SD_MM**2)
        middle = (weights @ state.joints_px) / weights.sum()
        ray = (middle[:2] - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        mm_per_px = middle[2] / np.array([camera.fx, camera.fy])
        about = (state.joints_px - middle) * (*mm_per_px, 1)
        surface = places[:, :1] * mm_per_px.prod()
        regions = np.hstack([surface, (places[:, 1:] - middle) * (*mm_per_px, 1)])
        regions = np.where(surface > LEAST_MM2, regions, 0)
        deviations = np.column_stack([sideways * mm_per_px[0], sideways * mm_per_px[0], away])
        facing, posture = state.facing, state.posture.astype(np.float64)
        return cls(about, deviations, state.joints_seen, facing, posture, ray, float(middle[2]), regions)

    def features(self) -> Float32:
        """Return the network's inputs (``FEATURES``,)."""
        about, spread, distance = SCALES_MM
        columns = (
            self.joints_mm / about,
            np.log(np.maximum(self.deviations_mm[:, 1:], LEAST_SD_MM) / spread),
            self.seen,
            self.facing,
            self.posture,
            self.ray,
            [self.middle_mm / distance - 1],
            self.regions[:, 1:] / about,
            np.log(self.regions[:, 0] / LEAST_MM2 + 1),
        )
        return np.concatenate([np.ravel(column) for column in columns]).astype(np.float32)

    def mirrored(self) -> "LocalJoints":
        """Return the joints of the person's mirror image."""
        twins = {name: getattr(self, name)[TWIN] for name in ("joints_mm", "deviations_mm", "seen")}
        twins["joints_mm"] = twins["joints_mm"] * (-1, 1, 1)
        twins["regions"] = self.regions[TWIN_REGION] * (1, -1, 1, 1)
        return replace(self, **twins, facing=self.facing * (1, -1), ray=self.ray * (-1, 1))


@cache
def shipped_joint_correction() -> Network:
    """Load the network that the package contains, once."""
    return onnx_session(files("eval").joinpath("weights", "joints.onnx").read_bytes())


def corrected_joints(state: BodyState, camera: Intrinsics, places: Float64) -> BodyState:
    """Return a depth network's state with corrected joints and deviations; unchanged without deviations.

    Arguments as in ``LocalJoints.of``. Results for an image and its mirror image are averaged.
    """
    if state.joints_sd is None or state.joints_seen is None or not (state.joints_px[:, 2] > 0).all():
        return state
    local = LocalJoints.of(state, camera, places)
    both = np.stack([local.features(), local.mirrored().features()])
    own, other = (one.astype(np.float64) for one in shipped_joint_correction().run(None, {"joints": both})[0])
    mean = (own + other[TWIN] * (-1, 1, 1, 1, 1)) / 2
    px_per_mm = camera.fx / local.middle_mm, camera.fy / local.middle_mm, 1
    joints_px = state.joints_px + mean[:, :3] * local.deviations_mm * px_per_mm
    joints_px[:, 2] = np.maximum(joints_px[:, 2], 1.0)
    return replace(state, joints_px=joints_px, joints_sd=state.joints_sd * np.exp(mean[:, 3:]))
