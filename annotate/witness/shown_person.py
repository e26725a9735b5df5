"""Note of a frame on what a witness showed of a person: its joints and mask in the depth image."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np

from annotate.array_types import Bool, Float64
from annotate.witness.skeleton import JOINT, JOINTS, Skeleton

NOTE = "witness"  # field of a person's note ``bearing``
SIMPLER_PX = 1.0  # largest distance of an outline's polygon from the mask's border; untuned
MOST = 20_000  # numbers of a note that are read: outlines of a person in the largest images


@dataclass(frozen=True, eq=False)
class ShownPerson:
    """Person as a witness shows it.

    joints_mm: float64 (19, 3) by ``JOINTS``, depth camera, millimetres, NaN where the witness is not sure.
    outlines: polygons (n, 2) around the witness's mask, column and row in the depth image; none without a
    mask.
    """

    joints_mm: Float64
    outlines: tuple[Float64, ...] = ()

    @classmethod
    def of(cls, skeleton: Skeleton, mask: Bool | None) -> Self:
        """Return the person of a witness's skeleton and mask (h, w) in the depth image."""
        if mask is None:
            return cls(1000 * skeleton.joints_m)
        found = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
        simple = (cv2.approxPolyDP(one, SIMPLER_PX, closed=True)[:, 0] for one in found)
        return cls(1000 * skeleton.joints_m, tuple(one.astype(np.float64) for one in simple if len(one) > 2))

    def note(self) -> dict[str, Any]:
        """Return the person as JSON values: joints by name, and outlines."""
        known = {name: self.joints_mm[i] for name, i in JOINT.items() if np.isfinite(self.joints_mm[i]).all()}
        return {
            "joints_mm": {name: np.round(at, 1).tolist() for name, at in known.items()},
            "outlines": [one.astype(int).tolist() for one in self.outlines],
        }

    @classmethod
    def from_note(cls, note: object) -> Self | None:
        """Return the person in a note; None for a malformed note."""
        try:
            joints = np.full((len(JOINTS), 3), np.nan)
            for name, at in note["joints_mm"].items():  # type: ignore[index]
                joints[JOINT[name]] = at
            outlines = [np.array(one, np.float64).reshape(-1, 2) for one in note["outlines"]]  # type: ignore[index]
        except (TypeError, KeyError, ValueError, IndexError, AttributeError, OverflowError):
            return None
        numbers = [joints[~np.isnan(joints)], *(one.ravel() for one in outlines)]
        if sum(map(len, numbers)) > MOST or not all((np.abs(one) <= 1e6).all() for one in numbers):
            return None
        return cls(joints, tuple(outlines))


def shown_people(notes: Mapping[str, Any]) -> list[ShownPerson]:
    """Return the people that a witness showed, from a frame's notes; the subject first."""
    own = notes.get("bearing")
    others = own.get("others") if isinstance(own, dict) else None
    every = [own, *(others.values() if isinstance(others, dict) else ())]
    found = (ShownPerson.from_note(one.get(NOTE)) for one in every if isinstance(one, dict))
    return [one for one in found if one is not None]
