"""Bearing of a person, as a network sees it: facing, posture and joints."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt16
from annotate.crop import RANGE_MM, Crop
from annotate.posture import POSTURES
from eval.scores.joints import IN_SKELETON, JOINT_NAMES, N_JOINTS, TWIN
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import N_JOINTS as N_SKELETON


@dataclass(frozen=True, eq=False)
class Bearing:
    """Facing, posture and joints of the person in one depth image.

    facing_deg: azimuth of the camera about the trunk, 0 before the chest, 90 on the person's left.
    facing_sure: [0, 1], 0 where every azimuth is as likely. posture: probabilities (P,) by ``POSTURES``.
    joints_px: float64 (15, 3) by ``JOINT_NAMES``: column and row in the depth image, depth in millimetres.
    support: "floor", "furniture" or "" where the frame does not show it (``support.py``).
    """

    facing_deg: float
    facing_sure: float
    posture: Float32
    joints_px: Float64
    support: str = ""

    @classmethod
    def of(
        cls, crop: Crop, depth_mm: UInt16, mask: Bool, facing: Float32, posture: Float32, joints: Float32
    ) -> "Bearing":
        """From a network's answer (2,), (P,), (15, 3) for the square around a person's pixels (h, w)."""
        c, s = facing.tolist()
        placed = joints.astype(np.float64)
        placed[:, :2] = placed[:, :2] * crop.side - 0.5 + (crop.left, crop.top)
        placed[:, 2] = (placed[:, 2] - 0.5) * RANGE_MM + float(np.median(depth_mm[mask]))
        return cls(float(np.degrees(np.arctan2(s, c))), min(1.0, float(np.hypot(c, s))), posture, placed)

    @property
    def name(self) -> str:
        """The likeliest posture."""
        return POSTURES[int(self.posture.argmax())]

    @property
    def facing(self) -> Float64:
        """Cosine and sine of the azimuth (2,), as long as it is sure."""
        azimuth = np.radians(self.facing_deg)
        return self.facing_sure * np.array([np.cos(azimuth), np.sin(azimuth)])

    def seen_by(self, camera: Intrinsics) -> "Bearing":
        """The person with the facing that the joints tell, which is right more often than the network's own;
        how sure it is, is still said by that.

        camera: the undistorted depth camera; a crop alone does not show from which side it is looked at.
        """
        from synth.images.standing_statistics import facing_deg

        placed = np.full((N_SKELETON, 3), np.nan)
        placed[IN_SKELETON] = self.joints_mm(camera)
        azimuth_deg = facing_deg(placed)
        return replace(self, facing_deg=azimuth_deg) if np.isfinite(azimuth_deg) else self

    def exchanged(self) -> "Bearing":
        """The person with left and right exchanged, and front and back with them."""
        return replace(
            self,
            facing_deg=float(self.facing_deg % 360 - 180),
            joints_px=self.joints_px[TWIN],
        )

    def joints_mm(self, camera: Intrinsics) -> Float64:
        """Joints (15, 3), frame of the undistorted depth camera, millimetres."""
        u, v, z = self.joints_px.T
        return np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])

    def note(self) -> dict[str, Any]:
        """As a frame's note ``bearing``; see ``from_note``."""
        return {
            "facing_deg": round(self.facing_deg, 1),
            "facing_sure": round(self.facing_sure, 3),
            "posture": self.name,
            "support": self.support,
            "postures": [round(share, 3) for share in self.posture.tolist()],
            "joints_px": [[round(value, 1) for value in joint] for joint in self.joints_px.tolist()],
        }

    @classmethod
    def from_note(cls, note: object) -> "Bearing | None":
        """Inverse of ``note``; None of what is none, or another joints' or postures'."""
        try:
            posture = np.array(note["postures"], np.float32)  # type: ignore[index]
            joints = np.array(note["joints_px"], np.float64)  # type: ignore[index]
            facing = float(note["facing_deg"]), float(note["facing_sure"])  # type: ignore[index]
            support = str(note.get("support", ""))  # type: ignore[attr-defined]
        except (TypeError, KeyError, ValueError, IndexError, AttributeError, OverflowError):
            return None
        if posture.shape != (len(POSTURES),) or joints.shape != (N_JOINTS, 3):
            return None
        if not (np.isfinite(facing).all() and np.isfinite(posture).all() and np.isfinite(joints).all()):
            return None
        return cls(*facing, posture, joints, support)


def bearing_notes(notes: dict[str, Any]) -> dict[int, Any]:
    """What a frame's notes say of each of its persons, by number: the subject is 1.

    The note ``bearing`` is the subject's; its entry ``others`` holds everybody else's.
    """
    note = notes.get("bearing")
    others = note.get("others") if isinstance(note, dict) else None
    numbered = others.items() if isinstance(others, dict) else ()
    return {1: note} | {int(number): other for number, other in numbered if _is_person(number)}


def _is_person(number: str) -> bool:
    """Whether it is a number that an image of persons can hold."""
    return len(number) <= 3 and number.isdecimal()


def joint_row(joints_mm: Float64) -> dict[str, list[float]]:
    """Joints (15, 3) by their names, millimetres to a tenth."""
    rounded = np.round(joints_mm, 1).tolist()
    return dict(zip(JOINT_NAMES, rounded, strict=True))
