"""What ``live`` does: a rig or a session that plays, labelled as it runs, and shown."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import typer

from annotate.cloud.coarse import CoarseCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_cloud
from annotate.live.live_frame import BodyPose, Labelling, Rig
from annotate.live.pipeline import LivePipeline
from annotate.segmentation.suit_network import shipped_suit_network
from annotate.suit.palette import Suit
from cli.console import finish, say
from cli.extras import needing
from cli.live_lines import print_joints, show_latest, show_lines
from eval.network.body_state import Bearing
from eval.network.joint_sides import sided
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import NetworkSurvey
from eval.scores.joints import JOINT, JOINT_NAMES
from eval.scores.skeleton_fit import BONES
from sensors.interrupt import Ending, ended_by_signals, interrupted_by_signals
from sensors.rig.camera import Intrinsics

SWITCH_S = 0.001
"""Seconds after which a thread that computes hands on the interpreter, a fifth of Python's own: each thermal
image passes through three threads, and its camera keeps an eighth of a second of them. Untuned."""
BONE_ENDS = tuple((JOINT[a], JOINT[b]) for a, b, _ in BONES)


@dataclass(frozen=True)
class LiveOptions:
    """Options of a live rig. suit: None = parts by the network. record: session to record from the start.

    subject: name of the person, "" if unknown. seconds: duration, None = until the user ends it.
    json: print one object at the end.
    """

    suit: Suit | None = None
    record: Path | None = None
    subject: str = ""
    seconds: float | None = None
    overwrite: bool = False
    json: bool = False


def watch(open_source: Callable[[], Rig], options: LiveOptions, window: bool, port: int | None) -> None:
    """Label a rig and show it in the window or as lines. port: of the server for Foxglove, if any."""
    with (
        interrupted_by_signals(),
        serving(port) as stream,
        closing(open_source()) as running,
        ended_by_signals() as ending,
    ):
        (look_at if window else _print)(running, options, ending, stream)


def _print(running: Rig, options: LiveOptions, ending: Ending, stream: "Stream") -> None:
    """Print a line for every labelled frame."""
    show = None if options.json else print_joints
    if options.record is not None:
        running.record(options.record, options.subject, options.overwrite)
    with run_pipeline(running, labelling_by(options.suit), stream) as pipeline:
        shown = show_lines(pipeline, time.monotonic() + (options.seconds or math.inf), show, ending)
    # The frame that was being labelled at the end.
    show_latest(pipeline, shown, show)
    _finish(running, pipeline, options.json)


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


def look_at(running: Rig, options: LiveOptions, ending: Ending, stream: Stream = unstreamed) -> None:
    """Show a rig in the window until it is closed."""
    with needing("gui"):
        from annotate.gui.app import run_live
        from annotate.gui.live.live_commands import takes
    names = takes(options.record)
    if options.record is not None:
        running.record(next(names), options.subject, options.overwrite)
    with run_pipeline(running, labelling_by(options.suit), stream) as pipeline:
        run_live(pipeline, names, options.subject, options.seconds or math.inf, ending)
    _finish(running, pipeline, options.json)


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
        detect = partial(NetworkSurvey, network=network, single_pass=True)
        return Labelling(lambda cloud, before: detect(CoarseCloud.of(cloud)).labels(before), _body_pose)
    labeller = SuitLabeller(suit, shipped_suit_network(), single_pass=True)
    return Labelling(partial(label_cloud, labeller), partial(_body_pose_beside, network))


def _body_pose_beside(network: OnnxNetwork, labels: FrameLabels, camera: Intrinsics) -> BodyPose | None:
    """Stance by a network of a person whose parts, and so whose sides, are known."""
    assert labels.persons is not None
    note = network.segment(labels.depth_mm, labels.persons == 1).bearing
    bearing = Bearing.from_note(note)
    return None if bearing is None else _as_body_pose(sided(bearing, labels.parts).seen_by(camera), camera)


def _body_pose(labels: FrameLabels, camera: Intrinsics) -> BodyPose | None:
    bearing = Bearing.from_note(labels.notes.get("bearing"))
    return None if bearing is None else _as_body_pose(bearing, camera)


def _as_body_pose(bearing: Bearing, camera: Intrinsics) -> BodyPose:
    return BodyPose(
        JOINT_NAMES,
        bearing.joints_mm(camera) / 1000,
        BONE_ENDS,
        bearing.facing_deg,
        bearing.facing_sure,
        bearing.name,
        float(bearing.posture.max()),
    )


def _finish(running: Rig, pipeline: LivePipeline, json: bool) -> None:
    health, p95 = running.health(), pipeline.latency_ms(0.95)
    frames, labelled = running.frames.count, pipeline.frames.count
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
