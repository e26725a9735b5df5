"""What ``live`` does: a rig or a session that plays, labelled as it runs, and shown."""

import json as json_text
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import typer

from annotate.cloud.coarse import CoarseCloud
from annotate.frame_labels import FrameLabels
from annotate.label_source import SuitSurvey, suit_labeller
from annotate.live.live_frame import Labelling, LiveFrame, Rig, Stance
from annotate.live.pipeline import LivePipeline
from annotate.reader.network import shipped_reader
from annotate.suit.palette import Suit
from cli.console import finish, say
from cli.extras import needing
from cli.rig_devices import open_rig
from eval.network.bearing import Bearing, joint_row
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import NetworkSurvey
from eval.network.sides import sided
from eval.scores.joints import JOINT, JOINT_NAMES
from eval.scores.skeleton_fit import BONES
from sensors.importers.open_source import open_source
from sensors.interrupt import Ending, ended_by_signals, interrupted_by_signals
from sensors.recording.playback import Playback
from sensors.rig.camera import Intrinsics

SWITCH_S = 0.001
"""Seconds after which a thread that computes hands on the interpreter, a fifth of Python's own: each thermal
image passes through three threads, and its camera keeps an eighth of a second of them. Chosen by eye."""
BONE_ENDS = tuple((JOINT[a], JOINT[b]) for a, b, _ in BONES)


def watch(
    session: Path | None,
    rig: Path | None,
    device: list[str] | None,
    palette: Suit | None,
    record: Path | None,
    subject: str,
    no_window: bool,
    serve: bool,
    port: int,
    seconds: float | None,
    overwrite: bool,
    json: bool,
) -> None:
    """What ``live`` does, with its arguments."""
    show = None if json else print_joints
    with interrupted_by_signals(), serving(port if serve else None) as stream:
        opened: Rig = Playback(open_source(session)) if session else open_rig(rig, device)
        with closing(opened) as running, ended_by_signals() as ending:
            if not no_window:
                look_at(running, palette, record, overwrite, seconds, json, ending, subject, stream)
                return
            with run_pipeline(running, labelling_by(palette), stream) as pipeline:
                if record is not None:
                    running.record(record, subject, overwrite)
                shown = show_lines(pipeline, _end_s(seconds), show, ending)
            # The frame that was being labelled at the end.
            show_newest(pipeline, shown, show)
    _finish(running, pipeline, json)


Stream = Callable[[LivePipeline], AbstractContextManager[None]]
"""What hands a pipeline's frames on while its context lasts."""


def unstreamed(_: LivePipeline) -> AbstractContextManager[None]:
    """Hands nothing on."""
    return nullcontext()


@contextmanager
def serving(port: int | None) -> Iterator[Stream]:
    """A server for Foxglove that has its port before a rig is opened; without a port, none."""
    if port is None:
        yield unstreamed
        return
    with needing("foxglove"):
        from annotate.foxglove.server import FoxgloveServer
        from annotate.live.stream import streamed
    with FoxgloveServer(port) as server:
        say(f"for Foxglove: {server.address}")
        yield partial(streamed, server=server)


def look_at(
    running: Rig,
    suit: Suit | None,
    out: Path | None,
    overwrite: bool,
    seconds: float | None,
    json: bool,
    ending: Ending,
    subject: str = "",
    stream: Stream = unstreamed,
) -> None:
    """Show a rig in the window, recorded from the start where ``out`` names a session, until it is closed."""
    with needing("gui"):
        from annotate.gui.app import run_live
        from annotate.gui.live_commands import takes
    names = takes(out)
    with run_pipeline(running, labelling_by(suit), stream) as pipeline:
        if out is not None:
            running.record(next(names), subject, overwrite)
        run_live(pipeline, names, subject, seconds or math.inf, ending)
    _finish(running, pipeline, json)


def _end_s(seconds: float | None) -> float:
    """The end on ``time.monotonic``."""
    return time.monotonic() + (seconds or math.inf)


@contextmanager
def run_pipeline(running: Rig, labelling: Labelling, stream: Stream = unstreamed) -> Iterator[LivePipeline]:
    """A rig and its labelling at work, both ended in the end, the recording too."""
    with closing(running), _switching(SWITCH_S), closing(LivePipeline(running, labelling)) as pipeline:
        running.start()
        pipeline.start()
        with stream(pipeline):
            yield pipeline
    for error in (running.error, pipeline.error):
        if error is not None:
            raise error


@contextmanager
def _switching(seconds: float) -> Iterator[None]:
    """Threads that compute hand on the interpreter after so long."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(seconds)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)


def labelling_by(suit: Suit | None) -> Labelling:
    """Parts by a suit, or else by the shipped network, which gives joints, facing and posture to both.

    It is asked once: a picture of now is worth more than the last hundredth (docs/adr/0024).
    """
    network = OnnxNetwork(mirrored=False)
    if suit is None:
        return Labelling(
            lambda cloud: NetworkSurvey(CoarseCloud.of(cloud), network, glance=True),
            NetworkSurvey.labels,
            _stance,
        )
    survey: Callable[[Any], SuitSurvey] = partial(SuitSurvey.of, suit=suit)
    return Labelling(
        survey, suit_labeller(suit, shipped_reader(), glance=True), partial(_stance_beside, network)
    )


def _stance_beside(network: OnnxNetwork, labels: FrameLabels, camera: Intrinsics) -> Stance | None:
    """Stance by a network of a person whose parts, and so whose sides, are known."""
    assert labels.persons is not None
    note = network.segment(labels.depth_mm, labels.persons == 1).bearing
    bearing = Bearing.from_note(note)
    return None if bearing is None else _as_stance(sided(bearing, labels.parts).seen_by(camera), camera)


def _stance(labels: FrameLabels, camera: Intrinsics) -> Stance | None:
    bearing = Bearing.from_note(labels.notes.get("bearing"))
    return None if bearing is None else _as_stance(bearing, camera)


def _as_stance(bearing: Bearing, camera: Intrinsics) -> Stance:
    return Stance(
        JOINT_NAMES,
        bearing.joints_mm(camera) / 1000,
        BONE_ENDS,
        bearing.facing_deg,
        bearing.facing_sure,
        bearing.name,
        float(bearing.posture.max()),
    )


Show = Callable[[LiveFrame], None] | None
"""What shows a labelled frame, if anything does."""


def show_lines(pipeline: LivePipeline, end_s: float, show: Show, ending: Ending) -> int:
    """Hand on every newest frame until the time is over, the rig ends or a signal comes.

    Returns the number of the last one. Warnings go to stderr.
    """
    seen, said = 0, set[str]()
    while not ending.asked and time.monotonic() < end_s and not pipeline.frames.ended:
        seen = show_newest(pipeline, seen, show, 0.2)
        # Not those of a frame: none comes of a camera that is silent.
        standing = pipeline.complaints
        for complaint in standing:
            if complaint.kind not in said:
                say(complaint.text)
        said = {complaint.kind for complaint in standing}
    return seen


def show_newest(pipeline: LivePipeline, seen: int, show: Show, timeout_s: float = 0.0) -> int:
    """Show the newest frame after number ``seen``, if one comes in time; its number, or ``seen``."""
    if (newest := pipeline.frames.after(seen, timeout_s)) is None:
        return seen
    number, frame = newest
    if show is not None:
        show(frame)
    return number


def print_joints(frame: LiveFrame) -> None:
    """One JSON line: the frame, its time, and of a person that was found joints, facing and posture."""
    row: dict[str, Any] = {"frame": frame.labels.frame_id, "time_ns": frame.moment.host_ns}
    if (stance := frame.stance) is not None:
        row |= {
            "facing_deg": round(stance.facing_deg, 1),
            "facing_sure": round(stance.facing_sure, 3),
            "posture": stance.posture,
            "posture_sure": round(stance.posture_sure, 3),
            "joints_mm": joint_row(stance.joints_m * 1000),
        }
    row["complaints"] = {complaint.kind: complaint.text for complaint in frame.complaints}
    print(json_text.dumps(row), flush=True)


def _finish(running: Rig, pipeline: LivePipeline, json: bool) -> None:
    health, p95 = running.health(), pipeline.latency_ms(0.95)
    frames, labelled = running.moments.count, pipeline.frames.count
    result = {
        "frames": frames,
        "labelled": labelled,
        "skipped": frames - labelled,
        "dropped": health.dropped,
        "latency_ms_p95": None if math.isnan(p95) else round(p95, 1),
        "complaints": pipeline.said,
    }
    text = f"{frames} frames: {labelled} labelled, {frames - labelled} skipped as labelling was busy; "
    text += f"{health.dropped} dropped by devices"
    text += "" if math.isnan(p95) else f"; 95 % were labelled within {p95:.0f} ms"
    if json:
        finish(result, True, text)
    else:
        say(text)
    if health.trouble:
        say(health.trouble)
        raise typer.Exit(3)
