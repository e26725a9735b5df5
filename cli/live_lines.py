"""Labelled frames of a running rig as JSON lines, and warnings on stderr: ``live`` without a window."""

import json as json_text
import time
from collections.abc import Callable
from typing import Any

from annotate.live.live_frame import LiveFrame
from annotate.live.pipeline import LivePipeline
from cli.console import say
from eval.network.body_state import joint_row
from sensors.interrupt import Ending

Show = Callable[[LiveFrame], None] | None
"""Function that shows a labelled frame; None = no output."""


def show_lines(pipeline: LivePipeline, end_s: float, show: Show, ending: Ending) -> int:
    """Show every newest frame until the time is over, the rig ends or a signal comes.

    Returns the number of the last frame. Warnings go to stderr.
    """
    seen, said = 0, set[str]()
    while not ending.asked and time.monotonic() < end_s and not pipeline.frames.ended:
        seen = show_latest(pipeline, seen, show, 0.2)
        # Warnings of the rig, because a silent camera gives no frame.
        active = pipeline.warnings
        for warning in active:
            if warning.kind not in said:
                say(warning.text)
        said = {warning.kind for warning in active}
    return seen


def show_latest(pipeline: LivePipeline, seen: int, show: Show, timeout_s: float = 0.0) -> int:
    """Show the newest frames after number ``seen``, if any come in time; return the last number, or ``seen``.

    Both threads that label may finish at once.
    """
    latest = pipeline.frames.since(seen, timeout_s)
    if show is not None:
        for _, frame in latest:
            show(frame)
    return latest[-1][0] if latest else seen


def print_joints(frame: LiveFrame) -> None:
    """Print one JSON line: frame, time, and the person's joints, facing and posture where one is found."""
    row: dict[str, Any] = {"frame": frame.labels.frame_id, "time_ns": frame.synced.host_ns}
    if (body_pose := frame.body_pose) is not None:
        row |= {
            "facing_deg": round(body_pose.facing_deg, 1),
            "facing_sure": round(body_pose.facing_sure, 3),
            "posture": body_pose.posture,
            "posture_sure": round(body_pose.posture_sure, 3),
            "joints_mm": joint_row(body_pose.joints_m * 1000),
        }
    row["complaints"] = {warning.kind: warning.text for warning in frame.warnings}
    print(json_text.dumps(row), flush=True)
