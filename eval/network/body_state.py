"""Body state of a person as a network gives it: facing, posture and joints."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt16
from annotate.crop import RANGE_MM, Crop
from annotate.posture import POSTURES
from eval.scores.joint_visibility import OUTSIDE, VISIBILITIES
from eval.scores.joints import IN_SKELETON, JOINT_NAMES, N_JOINTS, TWIN
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import N_JOINTS as N_SKELETON

QUALITIES = ("joint_sd_mm", "joint_visibility")
"""Columns of each joint beside its place: standard deviation in millimetres, one of ``VISIBILITIES``."""
MOST = 1e6  # pixels or millimetres; a note with larger joints is malformed
LEAST_SURE = 0.6  # least probability of a posture that is named; below it the posture is ""


@dataclass(frozen=True, eq=False)
class BodyState:
    """Facing, posture and joints of the person in one depth image.

    facing_deg: azimuth of the camera about the trunk, 0 in front of the chest, 90 on the person's left.
    facing_sure: [0, 1], 0 where all azimuths are equally likely. posture: probabilities (P,) by ``POSTURES``.
    joints_px: float64 (15, 3) by ``JOINT_NAMES``: column and row in the depth image, depth in millimetres.
    support: "floor", "furniture", or "" where the frame does not show the support (``support.py``). None from
    networks without them: joints_sd, float64 (15, 2), root mean square error of each joint in the image,
    pixels, and in depth, millimetres; joints_seen, probabilities (15, 3) by ``VISIBILITIES``.
    """

    facing_deg: float
    facing_sure: float
    posture: Float32
    joints_px: Float64
    support: str = ""
    joints_sd: Float64 | None = None
    joints_seen: Float64 | None = None

    @classmethod
    def of(cls, crop: Crop, image: tuple[UInt16, Bool], outputs: tuple[Float32, ...]) -> "BodyState":
        """Return the state from a network's outputs for a crop: facing (2,), posture (P,) and joints (15, 3).

        Deviations (15, 2) and visibility (15, 3) follow if the network gives them; a joint beyond the image
        is outside. image: depth in millimetres and the person's pixels, both (h, w).
        """
        (depth_mm, mask), (facing, posture, joints, *further) = image, outputs
        c, s = facing.tolist()
        placed = joints.astype(np.float64)
        placed[:, :2] = placed[:, :2] * crop.side - 0.5 + (crop.left, crop.top)
        placed[:, 2] = (placed[:, 2] - 0.5) * RANGE_MM + float(np.median(depth_mm[mask]))
        own = cls(float(np.degrees(np.arctan2(s, c))), min(1.0, float(np.hypot(c, s))), posture, placed)
        if not further:
            return own
        deviations, visibility = further
        inside = ((placed[:, :2] >= -0.5) & (placed[:, :2] < np.array(mask.shape[::-1]) - 0.5)).all(axis=1)
        outside = np.eye(len(VISIBILITIES))[OUTSIDE]
        seen = np.where(inside.reshape(-1, 1), visibility.astype(np.float64), outside)
        return replace(own, joints_sd=deviations * np.array([crop.side, RANGE_MM]), joints_seen=seen)

    @property
    def likeliest(self) -> str:
        """Return the likeliest posture."""
        return POSTURES[int(self.posture.argmax())]

    @property
    def name(self) -> str:
        """Return the likeliest posture, "" where its probability is below ``LEAST_SURE``."""
        return self.likeliest if self.posture.max() >= LEAST_SURE else ""

    @property
    def facing(self) -> Float64:
        """Return cosine and sine of the azimuth (2,), times ``facing_sure``."""
        azimuth = np.radians(self.facing_deg)
        return self.facing_sure * np.array([np.cos(azimuth), np.sin(azimuth)])

    def faced_by_joints(self, camera: Intrinsics) -> "BodyState":
        """Return the state with the facing computed from its joints, which is more accurate than the
        network's facing.

        camera: the undistorted depth camera, because a crop alone lacks the direction of view.
        """
        from synth.images.standing_statistics import facing_deg

        placed = np.full((N_SKELETON, 3), np.nan)
        placed[IN_SKELETON] = self.joints_mm(camera)
        azimuth_deg = facing_deg(placed)
        return replace(self, facing_deg=azimuth_deg) if np.isfinite(azimuth_deg) else self

    def exchanged(self) -> "BodyState":
        """Return the state with left and right exchanged, and therefore front and back."""
        return replace(
            self,
            facing_deg=float(self.facing_deg % 360 - 180),
            joints_px=self.joints_px[TWIN],
            joints_sd=None if self.joints_sd is None else self.joints_sd[TWIN],
            joints_seen=None if self.joints_seen is None else self.joints_seen[TWIN],
        )

    def joints_mm(self, camera: Intrinsics) -> Float64:
        """Return joints (15, 3), millimetres in coordinates of the undistorted depth camera."""
        u, v, z = self.joints_px.T
        return np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])

    def joints_sd_mm(self, camera: Intrinsics) -> Float64 | None:
        """Return each joint's standard deviation (15,), millimetres: root mean square distance from the true
        joint; None without it.
        """
        if self.joints_sd is None:
            return None
        sideways_mm = self.joints_sd[:, 0] * np.abs(self.joints_px[:, 2]) / camera.fx
        return np.hypot(sideways_mm, self.joints_sd[:, 1])

    @property
    def joint_visibility(self) -> tuple[str, ...]:
        """Return the likeliest of ``VISIBILITIES`` of each joint; empty without them."""
        return () if self.joints_seen is None else tuple(VISIBILITIES[i] for i in self.joints_seen.argmax(1))

    def placed(self, joints_mm: Float64, camera: Intrinsics) -> "BodyState":
        """Return the state with joints (15, 3) from millimetres; inverse of ``joints_mm``."""
        x, y, z = joints_mm.T
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        return replace(self, joints_px=np.column_stack([u, v, z]))

    def note(self) -> dict[str, Any]:
        """Return the state as JSON values, a frame's note ``bearing``."""
        optional = {"joints_sd": (self.joints_sd, 1), "joints_seen": (self.joints_seen, 2)}
        rounded = {name: np.round(one, n).tolist() for name, (one, n) in optional.items() if one is not None}
        return rounded | {
            "facing_deg": round(self.facing_deg, 1),
            "facing_sure": round(self.facing_sure, 3),
            "posture": self.name,
            "support": self.support,
            "postures": [round(share, 3) for share in self.posture.tolist()],
            "joints_px": np.round(self.joints_px, 1).tolist(),
        }

    @classmethod
    def from_note(cls, note: object) -> "BodyState | None":
        """Return the state in a note; None for a malformed note or another number of joints or postures."""
        try:
            posture = np.array(note["postures"], np.float32)  # type: ignore[index]
            joints = np.array(note["joints_px"], np.float64)  # type: ignore[index]
            facing = float(note["facing_deg"]), float(note["facing_sure"])  # type: ignore[index]
            support = str(note.get("support", ""))  # type: ignore[attr-defined]
            deviations = _joint_values(note.get("joints_sd"), 2)  # type: ignore[attr-defined]
            seen = _joint_values(note.get("joints_seen"), len(VISIBILITIES))  # type: ignore[attr-defined]
        except (TypeError, KeyError, ValueError, IndexError, AttributeError, OverflowError):
            return None
        if posture.shape != (len(POSTURES),) or joints.shape != (N_JOINTS, 3):
            return None
        if not (np.isfinite(facing).all() and np.isfinite(posture).all() and (abs(joints) <= MOST).all()):
            return None
        return cls(*facing, posture, joints, support, deviations, seen)


def _joint_values(noted: object, columns: int) -> Float64 | None:
    """Return numbers (15, columns) of a note; None without them. Raises ValueError for other numbers."""
    if noted is None:
        return None
    values = np.array(noted, np.float64)
    if values.shape != (N_JOINTS, columns) or not np.isfinite(values).all():
        raise ValueError(f"a note has values of shape {values.shape}")
    return values


def body_state_notes(notes: dict[str, Any]) -> dict[int, Any]:
    """Return the notes ``bearing`` of a frame's persons by person number: 1 is the subject.

    The entry ``others`` of the subject's note holds all others.
    """
    note = notes.get("bearing")
    others = note.get("others") if isinstance(note, dict) else None
    numbered = others.items() if isinstance(others, dict) else ()
    return {1: note} | {int(n): other for n, other in numbered if len(n) <= 3 and n.isdecimal()}


def joint_row(joints_mm: Float64) -> dict[str, list[float]]:
    """Return joints (15, 3) by their names, millimetres rounded to a tenth."""
    rounded = np.round(joints_mm, 1).tolist()
    return dict(zip(JOINT_NAMES, rounded, strict=True))


def joint_quality(sd_mm: Float64 | None, visibility: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Return ``QUALITIES`` by joint: standard deviations (15,), rounded to a tenth, and visibility; empty
    without them.
    """
    if sd_mm is None:
        return {}
    columns = zip(QUALITIES, (np.round(sd_mm, 1).tolist(), visibility), strict=True)
    return {kind: dict(zip(JOINT_NAMES, values, strict=True)) for kind, values in columns}
