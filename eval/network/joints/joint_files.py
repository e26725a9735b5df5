"""Joints, facing and posture of a label set's people as a table: JSON lines or CSV."""

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, pinhole_of
from eval.network.body_state import QUALITIES, BodyState, body_state_notes, joint_quality, joint_row
from eval.scores.joint_errors import TRUE_JOINTS, true_joints_mm
from eval.scores.joints import JOINT_NAMES
from sensors.files.atomic import check_suffix, write_bytes

KINDS = (".jsonl", ".csv")


def write_joints(labels: LabelledFrames, path: Path) -> int:
    """Write one row for each person with a body state; return the number of rows.

    Columns: frame; person, 1 = subject; facing_deg, facing_sure, posture, posture_sure, support as in
    ``BodyState``; joints in millimetres, coordinates of the undistorted depth camera (x right, y down, z
    forward); ``QUALITIES`` from networks that give them. Raises CloudError for a suffix not in ``KINDS``.
    """
    check_suffix(path, *KINDS)
    rows = list(_rows(labels))
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".csv":
        write_bytes(path, _csv(rows).encode())
    else:
        write_bytes(path, "".join(json.dumps(row) + "\n" for row in rows).encode())
    return len(rows)


def noted_joints(labels: LabelledFrames, frame: FrameLabels) -> dict[str, list[float]] | None:
    """Return a frame's joints by name, millimetres in depth-camera coordinates: the network's if any, else
    the true ones.

    None without either. Raises FormatError if the true joints in the frame's notes are malformed.
    """
    state = BodyState.from_note(frame.notes.get("bearing"))
    if state is not None:
        return joint_row(state.joints_mm(pinhole_of(frame, camera_of(labels, frame))))
    return joint_row(true_joints_mm(frame)) if TRUE_JOINTS in frame.notes else None


def _rows(labels: LabelledFrames) -> Iterator[dict[str, Any]]:
    for frame in labels:
        camera = pinhole_of(frame, camera_of(labels, frame))
        for number, given in sorted(body_state_notes(frame.notes).items()):
            state = BodyState.from_note(given)
            if state is not None:
                note, sd_mm = state.note(), state.joints_sd_mm(camera)
                row = {
                    "frame": frame.frame_id,
                    "person": number,
                    **{name: note[name] for name in ("facing_deg", "facing_sure", "posture")},
                    "posture_sure": max(note["postures"]),
                    "support": state.support,
                    "joints_mm": joint_row(state.joints_mm(camera)),
                }
                yield row | joint_quality(sd_mm, state.joint_visibility)


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    places = [f"{name}_{axis}_mm" for name in JOINT_NAMES for axis in "xyz"]
    names = ["frame", "person", "facing_deg", "facing_sure", "posture", "posture_sure", "support"]
    writer = csv.writer(text, lineterminator="\n")
    own = [(kind, joint) for kind in QUALITIES if any(kind in row for row in rows) for joint in JOINT_NAMES]
    writer.writerow(names + places + [f"{joint}_{kind.removeprefix('joint_')}" for kind, joint in own])
    for row in rows:
        joints = [x for joint in row["joints_mm"].values() for x in joint]
        quality = [row[kind][joint] if kind in row else "" for kind, joint in own]
        writer.writerow([row[name] for name in names] + joints + quality)
    return text.getvalue()
