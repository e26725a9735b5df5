"""The verb ``live``: a rig or a played session, labelled live, in a window or as JSON lines."""

import json as json_text
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import typer

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_cloud
from annotate.live.live_frame import BodyPose, Labelling, LiveFrame, Rig
from annotate.live.pipeline import LivePipeline
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import Segmentation
from annotate.suit.palette import Suit
from cli.console import finish, say
from cli.extras import needing
from eval.network.body_state import BodyState, joint_quality, joint_row
from eval.network.joints.joint_filter import filter_joints
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.posture_model import with_posture
from eval.network.predict_source import NetworkLabeller
from eval.network.side_smoothing import sided_by_parts
from eval.scores.joints import BONES, JOINT, JOINT_NAMES
from sensors.interrupt import Ending, ended_by_signals, interrupted_by_signals
from sensors.rig.camera import Intrinsics

# s after which a computing thread yields the interpreter, because each thermal image passes three threads,
# and its camera keeps 0.125 s of images; untuned.
SWITCH_S = 0.001
BONE_ENDS = tuple((JOINT[a], JOINT[b]) for a, b in BONES)
Show = Callable[[LiveFrame], None] | None  # shows a labelled frame; None = no output
# Streams a pipeline's frames during the context.
Stream = Callable[[LivePipeline], AbstractContextManager[object]]


@dataclass(frozen=True)
class LiveOptions:
    """Options of ``live``. suit: None = parts by the network. record: session to record from the start.

    subject: name of the person, "" if unknown. seconds: None = until the user ends it. json: print one object
    at the end. port: of the server for Foxglove, None = no server. weights: network (.onnx), None = shipped.
    """

    suit: Suit | None = None
    record: Path | None = None
    subject: str = ""
    seconds: float | None = None
    overwrite: bool = False
    json: bool = False
    window: bool = True
    port: int | None = None
    weights: Path | None = None


def watch(open_source: Callable[[], Rig], options: LiveOptions) -> None:
    """Label the frames of a rig and show them in the window or as lines."""
    with (
        interrupted_by_signals(),
        serving(options.port) as stream,
        closing(open_source()) as running,
        ended_by_signals() as ending,
    ):
        (show_window if options.window else _print_lines)(running, options, ending, stream)


def _print_lines(running: Rig, options: LiveOptions, ending: Ending, stream: Stream) -> None:
    show = None if options.json else print_joints
    if options.record is not None:
        running.record(options.record, options.subject, options.overwrite)
    with run_pipeline(running, labelling_by(options.suit, options.weights), stream) as pipeline:
        shown = show_lines(pipeline, time.monotonic() + (options.seconds or math.inf), show, ending)
    # The frame that was being labelled at the end.
    show_latest(pipeline, shown, show)
    _finish(running, pipeline, options.json)


@contextmanager
def serving(port: int | None) -> Iterator[Stream]:
    """Run a server for Foxglove, which takes its port before a rig is opened; port None = no server."""
    if port is None:
        yield nullcontext
        return
    with needing("foxglove"):
        from annotate.foxglove.server import FoxgloveServer
        from annotate.live.stream import streamed
    with FoxgloveServer(port) as server:
        say(f"for Foxglove: {server.address}")
        yield partial(streamed, server=server)


def show_window(running: Rig, options: LiveOptions, ending: Ending, stream: Stream = nullcontext) -> None:
    """Show a rig in the window until the window is closed."""
    with needing("gui"):
        from annotate.gui.app import run_live
        from annotate.gui.live.live_window import takes
    names = takes(options.record)
    if options.record is not None:
        running.record(next(names), options.subject, options.overwrite)
    with run_pipeline(running, labelling_by(options.suit, options.weights), stream) as pipeline:
        run_live(pipeline, names, options.subject, options.seconds or math.inf, ending)
    _finish(running, pipeline, options.json)


@contextmanager
def run_pipeline(running: Rig, labelling: Labelling, stream: Stream = nullcontext) -> Iterator[LivePipeline]:
    """Run a rig and its labelling; end both, and the recording, at the end of the context."""
    with closing(running), ExitStack() as stack, closing(LivePipeline(running, labelling)) as pipeline:
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_S)
        running.start()
        pipeline.start()
        with stream(pipeline):
            yield pipeline
    for error in (running.error, pipeline.error):
        if error is not None:
            raise error


def show_lines(pipeline: LivePipeline, end_s: float, show: Show, ending: Ending) -> int:
    """Process every latest frame until the time is over, the rig ends or a signal comes; print warnings.

    Returns the number of the last frame.
    """
    seen, printed = 0, set[str]()
    while not ending.asked and time.monotonic() < end_s and not pipeline.frames.ended:
        seen = show_latest(pipeline, seen, show, 0.2)
        # Not the frame's warnings, because a silent camera gives no frame.
        active = pipeline.warnings
        for warning in active:
            if warning.kind not in printed:
                say(warning.text)
        printed = {warning.kind for warning in active}
    return seen


def show_latest(pipeline: LivePipeline, seen: int, show: Show, timeout_s: float = 0.0) -> int:
    """Process the frames after number ``seen`` that arrive within the timeout; return the last number, or
    ``seen``.
    """
    latest = pipeline.frames.since(seen, timeout_s)
    if show is not None:
        for _, frame in latest:
            show(frame)
    return latest[-1][0] if latest else seen


def print_joints(frame: LiveFrame) -> None:
    """Print one JSON line: frame, time, joints, facing and posture of a person, and warnings."""
    row: dict[str, Any] = {"frame": frame.labels.frame_id, "time_ns": frame.synced.host_ns}
    if (pose := frame.body_pose) is not None:
        row |= {
            "facing_deg": round(pose.facing_deg, 1),
            "facing_sure": round(pose.facing_sure, 3),
            "posture": pose.posture,
            "posture_sure": round(pose.posture_sure, 3),
            "joints_mm": joint_row(pose.joints_m * 1000),
            **pose.joint_quality,
        }
    row["complaints"] = {warning.kind: warning.text for warning in frame.warnings}
    print(json_text.dumps(row), flush=True)


def labelling_by(suit: Suit | None, weights: Path | None = None) -> Labelling:
    """Return the labelling by a suit, or by a network without one. weights: of it; None = shipped.

    The network always gives joints, facing and posture. It runs without test-time augmentation, because
    latency matters more (docs/adr/0024).
    """
    network = OnnxNetwork(weights or SHIPPED_WEIGHTS, flip=False)
    network = network.in_scheme(network.usual_scheme)
    if suit is None:
        coarse = NetworkLabeller(network)
        return Labelling(lambda cloud, before: label_cloud(coarse, CoarseCloud.of(cloud), before), _body_pose)
    labeller = SuitLabeller(suit, single_pass=True)
    say(*labeller.notes)
    return Labelling(partial(_suit_labels, labeller, network), _body_pose)


def _suit_labels(
    labeller: SuitLabeller, network: OnnxNetwork, cloud: ThermalCloud, before: FrameLabels | None
) -> tuple[Segmentation, PersonMask]:
    """Return labels by the suit, with the network's joints, whose sides the suit's parts correct."""
    result, person = label_cloud(labeller, cloud, before)
    state = BodyState.from_note(network.segment(cloud.depth_mm, person.mask, cloud.camera).bearing)
    if state is None:
        return result, person
    labels = FrameLabels("", cloud.depth_mm, result.parts, scheme=result.scheme)
    state = with_posture(state, (cloud.depth_mm, person.mask), cloud.camera)
    bearing = sided_by_parts(state, labels).faced_by_joints(cloud.camera).note()
    return filter_joints(replace(result, bearing=bearing), before, cloud.camera, cloud.stamp_ns), person


def _body_pose(labels: FrameLabels, camera: Intrinsics) -> BodyPose | None:
    state = BodyState.from_note(labels.notes.get("bearing"))
    if state is None:
        return None
    joints_m, posture_sure = state.joints_mm(camera) / 1000, float(state.posture.max())
    facing = state.facing_deg, state.facing_sure
    quality = joint_quality(state.joints_sd_mm(camera), state.joint_visibility)
    return BodyPose(JOINT_NAMES, joints_m, BONE_ENDS, *facing, state.name, posture_sure, quality)


def _finish(running: Rig, pipeline: LivePipeline, json: bool) -> None:
    health, p95 = running.health(), pipeline.latency_ms(0.95)
    frames, labelled = running.frames.count, pipeline.frames.count
    result = {
        "frames": frames,
        "labelled": labelled,
        "skipped": frames - labelled,
        "dropped": health.dropped,
        "latency_ms_p95": None if math.isnan(p95) else round(p95, 1),
        "complaints": pipeline.warned,
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
