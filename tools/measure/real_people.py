"""Scores of a network on real people with tracked joints, from ../shared/data/real_people.

A tracker's joints are not true joints: they are a few centimetres off, and most trackers assume a person who
faces the camera.
"""

import json
import runpy
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.labelset.label_set import LabelSet
from eval.network.body_state import BodyState
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import predict_source
from eval.scores.confusion import present_mean, ratio
from eval.scores.joints import IN_SKELETON, JOINT_NAMES, N_JOINTS
from sensors.files.natural_order import in_order
from sensors.importers.open_source import open_source
from sensors.importers.options import ImportOptions
from synth.body.skeleton import JOINT_ID
from synth.images.standing_statistics import facing_deg
from tools.figures.worst_frames import COUNT, Tile, of_real

PEOPLE = Path(__file__).resolve().parents[3] / "shared" / "data" / "real_people"
TRACKED = {"head": 0, "neck": 1, "pelvis": 3} | {
    f"{side}_{kind}": first + number
    for first, side, kinds in (
        (4, "left", ("shoulder", "elbow", "wrist")),
        (8, "right", ("shoulder", "elbow", "wrist")),
        (12, "left", ("hip", "knee", "ankle")),
        (16, "right", ("hip", "knee", "ankle")),
    )
    for number, kind in enumerate(kinds)
}
"""Index in ``joints.json`` of the tracker's joint nearest to each of the network's: its hip is our pelvis."""
NEAR_DEG = 30.0
NEAR_PX = 3.0  # a tracker's joint on the other side is tolerated so near to its own side


def tracked_joints_mm(joints: dict[str, list], camera: dict[str, float]) -> Float64:
    """Return a tracker's joints (15, 3) of one frame, depth camera, millimetres.

    joints: pixels ``uv`` and depths ``z_mm``.
    """
    (u, v), z = np.array(joints["uv"], float).T, np.array(joints["z_mm"], float)
    mm = np.column_stack([(u - camera["cx"]) / camera["fx"] * z, (v - camera["cy"]) / camera["fy"] * z, z])
    return np.asarray(mm[[TRACKED[name] for name in JOINT_NAMES]])


def tracked_facing_deg(joints_mm: Float64) -> float:
    """Return the facing by a tracker's joints (15, 3)."""
    placed = np.full((len(JOINT_ID), 3), np.nan)
    placed[IN_SKELETON] = joints_mm
    return facing_deg(placed)


@dataclass(frozen=True)
class People:
    """Scores of a network on F frames of real people.

    subjects: of each frame. joints: int64 (F, 20, 4), counts by joint: where the depth shows the joint, hits,
    joints on the other side, and joints more than ``NEAR_PX`` on the other side. off_deg: error of
    the facing by frame; 180 without a facing.
    apart_mm: vectors (F, 15, 3) from the tracker's joints to the network's, depth camera; infinite without.
    tiles: pictures of the worst frames.
    """

    subjects: tuple[str, ...]
    joints: Int64
    off_deg: Float64
    apart_mm: Float64
    tiles: tuple[Tile, ...] = ()

    def __add__(self, other: "People") -> "People":
        return People(
            self.subjects + other.subjects,
            np.concatenate([self.joints, other.joints]),
            np.concatenate([self.off_deg, other.off_deg]),
            np.concatenate([self.apart_mm, other.apart_mm]),
            (*self.tiles, *other.tiles),
        )

    def without_offsets(self) -> "People":
        """Return the same without one constant offset of each joint, by which a tracker's joints differ.

        The offset of a person's joint is the median of the other people's vectors.
        """
        who, own_mm = np.array(self.subjects), self.apart_mm.copy()
        for person in set(self.subjects):
            others = self.apart_mm[who != person]
            own_mm[who == person] -= np.nanmedian(np.where(np.isfinite(others), others, np.nan), axis=0)
        return replace(self, apart_mm=own_mm)


def mean_hit_rate(counts: Int64) -> Float64:
    """Return the mean over joints of the share of hits. counts: (..., 20, 4), as in ``People``."""
    return present_mean(ratio(counts[..., 1], counts[..., 0]), axis=-1)


def swap_rate(counts: Int64) -> Float64:
    """Return the share of joints on the other side. counts: (..., 20, 4), as in ``People``."""
    return ratio(counts[..., 2].sum(-1), counts[..., 0].sum(-1))


def far_swap_rate(counts: Int64) -> Float64:
    """Return the share of joints more than ``NEAR_PX`` on the other side. counts: as in ``swap_rate``."""
    return ratio(counts[..., 3].sum(-1), counts[..., 0].sum(-1))


def measure_people(folder: Path, network: OnnxNetwork) -> People:
    """Measure a network on a folder of real people, whose frames are named ACTION_SUBJECT_..."""
    joints = json.loads((folder / "joints.json").read_text())
    camera = json.loads((folder / "intrinsics.json").read_text())
    names = in_order(joints)  # as the folder is imported
    # A second lies between single frames, so that joints are not filtered over them.
    apart = ImportOptions(rate_hz=None if folder.parent.name == "takes" else 1.0)
    with tempfile.TemporaryDirectory() as out:
        labels = predict_source(open_source(folder, apart), network, Path(out) / "p", lambda n: None).labels
        counts = joint_counts(labels, [joints[name] for name in names])
        tiles = worst_tiles(labels, [joints[name] for name in names], counts)
        notes = [labels.notes(frame_id).get("bearing") for frame_id in labels.frame_ids]
    states = [BodyState.from_note(note) for note in notes]
    off, apart_mm = [], np.full((len(names), N_JOINTS, 3), np.inf)
    for i, (name, state) in enumerate(zip(names, states, strict=True)):
        tracked_mm = tracked_joints_mm(joints[name], camera)
        turned = 180.0 if state is None else state.facing_deg - tracked_facing_deg(tracked_mm)
        off.append(abs((turned + 180) % 360 - 180))
        if state is not None:
            apart_mm[i] = state.joints_mm(labels.whole_image) - tracked_mm
    of_take = folder.name if folder.parent.name == "takes" else ""
    return People(
        tuple((of_take or name).split("_")[1] for name in names),
        counts,
        np.array(off),
        apart_mm,
        tiles,
    )


def worst_tiles(labels: LabelSet, tracked: list[dict[str, list]], counts: Int64) -> tuple[Tile, ...]:
    """Return pictures of the frames with the smallest shares of right joints."""
    shown, right = counts[..., :2].sum(axis=1).T
    lost, tiles = 1 - right / np.maximum(shown, 1), []
    for i in np.argsort(-lost, kind="stable")[:COUNT].tolist():
        frame = labels.read(labels.frame_ids[i], persons=False)
        text = f"{right[i]} of {shown[i]} joints right"
        at_px = np.array(tracked[i]["uv"], np.float64)
        tiles.append(of_real((frame.depth_mm, frame.parts), at_px, float(lost[i]), text))
    return tuple(tiles)


def joint_counts(labels: LabelSet, tracked: list[dict[str, list]]) -> Int64:
    """Return the counts (F, 20, 4) of ``People.joints`` by the rules of the recordings' own score.py."""
    score = runpy.run_path(str(PEOPLE / "score.py"))
    right, twin = score["RIGHT"], np.array(score["TWIN"])
    counts = np.zeros((len(tracked), len(right), 4), np.int64)
    for frame, seen, row in zip(labels, tracked, counts, strict=True):
        height, width = frame.parts.shape
        for k, ((u, v), z) in enumerate(zip(np.rint(seen["uv"]).astype(int), seen["z_mm"], strict=True)):
            if not (1 <= u < width - 1 and 1 <= v < height - 1):
                continue
            if frame.depth_mm[v, u] == 0 or not -60 < z - int(frame.depth_mm[v, u]) < 220:
                continue
            own, part = right[k], int(np.bincount(frame.parts[v - 1 : v + 2, u - 1 : u + 2].ravel()).argmax())
            row[k, :2] += (1, part in own)
            if part < len(twin) and part not in own and twin[part] in own:
                rows, columns = np.nonzero(np.isin(frame.parts, list(own)))
                row[k, 2:] += (1, not (np.hypot(rows - v, columns - u) <= NEAR_PX).any())
    return counts


def folders() -> list[Path]:
    """Return the folders of the takes and of the single frames."""
    return [*sorted((PEOPLE / "takes").iterdir()), PEOPLE / "frames"]
