"""Counts of labels, joints, facings and phantoms against judged people, by the laws of score.py."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64, UInt8, UInt16
from annotate.parts import N_CLASSES, PART_ID, TWIN_PARTS
from eval.scores.joints import JOINT
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import JOINT_ID
from synth.images.standing_statistics import facing_deg
from tools.figures.worst_frames import Tile, of_real, worst
from tools.measure.real_people import NEAR_DEG

SURE = 0.7  # least visibility of a judged joint
AROUND_PX, FAR_PX = 2, 5  # half windows: of a joint's labels, and of labels of its own side
LABELLED = 3  # least pixels with a part about a labelled joint
LOST = 0.6  # a person with a larger share of unlabelled joints is lost
NEAR, WIDE = 0.1, 0.2  # trunks
MEETING = {
    0: ("head", ("head",)),
    **{
        first + right: (f"{side}_{joint}", tuple(part.replace("SIDE", side) for part in parts))
        for first, joint, parts in (
            (11, "shoulder", ("torso", "SIDE_upper_arm")),
            (13, "elbow", ("SIDE_upper_arm", "SIDE_forearm")),
            (15, "wrist", ("SIDE_forearm",)),
            (23, "hip", ("torso", "hip", "SIDE_upper_leg")),
            (25, "knee", ("SIDE_upper_leg", "SIDE_lower_leg")),
            (27, "ankle", ("SIDE_lower_leg",)),
        )
        for right, side in enumerate(("left", "right"))
    },
}
"""Joint of ``predict`` and the parts that meet there, by landmark."""
JUDGED = np.array(list(MEETING))
AS_JOINTS = np.array([JOINT[joint] for joint, _ in MEETING.values()])
PARTS_AT = [np.array([PART_ID[part] for part in parts], np.uint8) for _, parts in MEETING.values()]
TRUNK = np.array([11, 12, 23, 24])  # landmarks: shoulders, hips


class Found(NamedTuple):
    """Person that was found. at: float64 (15, 3), column, row, depth in millimetres; NaN for no joint."""

    at: Float64
    facing_deg: float = float("nan")
    posture: str = ""


class Seen(NamedTuple):
    """Frame with its labels. depth_mm, parts: (h, w); parts: None for a network without labels."""

    depth_mm: UInt16
    parts: UInt8 | None
    found: list[Found]


@dataclass(eq=False)
class Tally:
    """Counts by frame, and distances of joints in millimetres.

    across_mm: distance across the line of sight. behind_mm: depth behind the surface at the judge's pixel.
    tiles: pictures of the frames with the smallest shares of right joints, and of those with phantoms alone.
    """

    camera: Intrinsics
    counts: list[Counter[str]] = field(default_factory=list)
    across_mm: list[float] = field(default_factory=list)
    behind_mm: list[float] = field(default_factory=list)
    tiles: list[Tile] = field(default_factory=list)

    def add(self, persons: Sequence[Float64], seen: Seen) -> None:
        """Count a frame. persons: landmarks (33, 3) of each person by the judge."""
        labels = Counter() if seen.parts is None else count_labels(persons, seen.parts)
        self.counts.append(n := labels + self._of_people(persons, seen))
        if seen.parts is not None and (n["joints"] or (not persons and n["phantoms"])):
            marked = [person[JUDGED][person[JUDGED, 2] >= SURE, :2] for person in persons]
            at_px, right = (
                np.concatenate([np.zeros((0, 2)), *marked]),
                f"{n['right']} of {n['joints']} joints",
            )
            text = f"{right} right, {n['phantoms']} phantoms"
            lost = 1 - n["right"] / max(n["joints"], 1)
            self.tiles = worst([*self.tiles, of_real((seen.depth_mm, seen.parts), at_px, lost, text)])

    def _of_people(self, persons: Sequence[Float64], seen: Seen) -> Counter[str]:
        """Count near joints, facings, postures and phantoms of a frame, and add its distances.

        The nearest found person is the judged one if the median joint is within a trunk.
        """
        n: Counter[str] = Counter(frames=1)
        used = set()
        for person in persons:
            sure, at = person[JUDGED, 2] >= SURE, person[JUDGED, :2]
            trunk = float(np.linalg.norm(person[TRUNK[:2], :2].mean(0) - person[TRUNK[2:], :2].mean(0)))
            facing = judged_facing_deg(person, seen.depth_mm, self.camera)
            n["seen"] += int(sure.sum())
            n["faced"] += not np.isnan(facing)
            off = [np.linalg.norm(at - one.at[AS_JOINTS, :2], axis=1)[sure] for one in seen.found]
            far = [float(np.median(px[np.isfinite(px)])) if np.isfinite(px).any() else np.inf for px in off]
            if min(far, default=np.inf) >= trunk:
                continue
            best = int(np.argmin(far))
            used.add(best)
            one = seen.found[best]
            n["near"] += int((off[best] / trunk < NEAR).sum())
            n["wide"] += int((off[best] / trunk < WIDE).sum())
            n["facing"] += bool(abs((one.facing_deg - facing + 180) % 360 - 180) <= NEAR_DEG)
            n["matched"] += 1
            n[one.posture or "unclear"] += 1
            self._add_distances(at[sure], one.at[AS_JOINTS][sure], seen.depth_mm)
        n["phantoms"] += len(seen.found) - len(used)
        return n

    def _add_distances(self, at_px: Float64, found: Float64, depth_mm: UInt16) -> None:
        """Add the distances of found joints (n, 3) from judged pixels (n, 2)."""
        z = looked_up_mm(depth_mm, at_px)
        across = np.linalg.norm((found[:, :2] - at_px) / (self.camera.fx, self.camera.fy), axis=1) * z
        for kept, mm in ((self.across_mm, across), (self.behind_mm, found[:, 2] - z)):
            kept += mm[np.isfinite(mm)].tolist()


def count_labels(persons: Sequence[Float64], parts: UInt8) -> Counter[str]:
    """Count right, missing and exchanged labels (h, w) at the visible joints of judged people (33, 3)."""
    n: Counter[str] = Counter(people=len(persons))
    height, width = parts.shape
    for person in persons:
        seen, empty = 0, 0
        for own, (x, y, sure) in zip(PARTS_AT, person[JUDGED], strict=True):
            u, v = round(x), round(y)
            if sure < SURE or not (2 <= u < width - 2 and 2 <= v < height - 2):
                continue
            seen += 1
            counted = np.bincount(window(parts, u, v, AROUND_PX).ravel(), minlength=256)[1:N_CLASSES]
            if counted.sum() < LABELLED:
                empty += 1
                continue
            part = int(counted.argmax()) + 1
            swapped = part not in own and TWIN_PARTS[part] in own
            n["right"] += part in own
            n["other_side"] += swapped
            n["other_side_far"] += swapped and not np.isin(window(parts, u, v, FAR_PX), own).any()
        n["joints"] += seen
        n["unlabelled"] += empty
        n["lost"] += seen > 0 and empty > LOST * seen
    return n


def window(image: UInt8 | UInt16, u: int, v: int, half: int) -> UInt8 | UInt16:
    """Return the pixels within half pixels of a pixel, each way."""
    return image[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]


def looked_up_mm(depth_mm: UInt16, at_px: Float64) -> Float64:
    """Return the depth (n,) of the surface about pixels (n, 2), millimetres; NaN without a reading."""
    found = np.full(len(at_px), np.nan)
    for k, (u, v) in enumerate(np.rint(at_px).astype(int)):
        if 0 <= v < depth_mm.shape[0] and 0 <= u < depth_mm.shape[1]:
            near = window(depth_mm, u, v, AROUND_PX)
            found[k] = np.median(near[near > 0]) if near.any() else np.nan
    return found


def judged_facing_deg(person: Float64, depth_mm: UInt16, camera: Intrinsics) -> float:
    """Return the facing by a judged person's (33, 3) shoulders and hips on the surface; NaN if not seen."""
    (u, v), z = person[TRUNK, :2].T, looked_up_mm(depth_mm, person[TRUNK, :2])
    if (person[TRUNK, 2] < SURE).any() or np.isnan(z).any():
        return float("nan")
    mm = np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    placed = np.full((len(JOINT_ID), 3), np.nan)
    names = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    placed[[JOINT_ID[name] for name in (*names, "neck", "pelvis")]] = *mm, mm[:2].mean(0), mm[2:].mean(0)
    return facing_deg(placed)
