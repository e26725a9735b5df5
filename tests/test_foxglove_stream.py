"""Foxglove's stream over the network: every topic, events, warnings, and admitted origins."""

import json
import re
import struct
from base64 import b64decode
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import assert_refused
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from annotate.foxglove import topics
from annotate.foxglove.origin_gate import is_admitted
from annotate.foxglove.topics import SCHEMAS, shown_messages
from annotate.frame_labels import FrameLabels
from annotate.live.live_frame import BodyPose, LiveFrame
from annotate.live.warning import LiveWarning
from eval.scores.joints import JOINT_NAMES
from sensors.errors import CloudError
from sensors.recording.device_readers import Event
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.messages import EVENTS
from tests.test_foxglove import labelled

CAMERA = Intrinsics(5, 4, 6.0, 6.0, 2.0, 1.5)
BARE = RigCalibration(CAMERA)

PROTOCOL = "foxglove.sdk.v1"


def subscribed(client) -> dict[int, str]:
    """Topics by subscription of a client that has asked for all that the server advertises."""
    channels = []
    while len(channels) < len(SCHEMAS):
        said = json.loads(client.recv(timeout=60))
        channels += said["channels"] if said["op"] == "advertise" else []
    for channel in channels:
        schema = SCHEMAS[channel["topic"]]
        files = FileDescriptorSet.FromString(b64decode(channel["schema"]))
        assert (
            channel["schemaName"]
            == schema.DESCRIPTOR.full_name
            in {f"{file.package}.{kind.name}" for file in files.file for kind in file.message_type}
        )
        assert channel["encoding"] == channel["schemaEncoding"] == "protobuf"
    asked = [{"id": 100 + channel["id"], "channelId": channel["id"]} for channel in channels]
    client.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
    return {100 + channel["id"]: channel["topic"] for channel in channels}


def test_a_client_of_the_public_protocol_receives_every_topic():
    pytest.importorskip("foxglove")
    from websockets.sync.client import connect

    from annotate.foxglove.server import FoxgloveServer

    thermal = np.full((2, 3), 30, np.float32)
    whole = RigCalibration(CAMERA, CAMERA, Pose.identity(), Intrinsics(3, 2, 4, 4, 1, 0.5), Pose.identity())
    joints = {name: (0.0, 1.0 * i, 900.0) for i, name in enumerate(JOINT_NAMES)}
    shown = labelled(
        color_encoded=b"\xff\xd8\xff", thermal_c=thermal, joints_mm=joints, events=((5, "flag"),)
    )
    shown = replace(shown, calibration=whole)
    sent = {topic: (stamp, m.SerializeToString()) for topic, stamp, m in shown_messages(shown)}
    assert sent.keys() == SCHEMAS.keys()
    with FoxgloveServer(0) as server, connect(server.address, subprotocols=[PROTOCOL]) as client:
        assert json.loads(client.recv(timeout=60))["op"] == "serverInfo"
        topic_of, got = subscribed(client), {}
        while got.keys() != sent.keys():
            server.show(shown)  # until every subscription has arrived
            with suppress(TimeoutError):
                while isinstance(data := client.recv(timeout=0.2), bytes) and data[0] == 1:
                    number, stamp = struct.unpack("<IQ", data[1:13])
                    got[topic_of[number]] = stamp, data[13:]
    assert got == sent


def test_a_taken_port_is_refused_with_the_remedy():
    pytest.importorskip("foxglove")
    from annotate.foxglove.server import FoxgloveServer

    with FoxgloveServer(0) as server, pytest.raises(CloudError, match=r"in use.* another port"):
        FoxgloveServer(server.port)
    with pytest.raises(CloudError, match="port 70000 cannot be served"):
        FoxgloveServer(70000)


def request(origin: str | None, *fields: str) -> bytes:
    """The handshake that a browser sends from a page of this origin; a program sends none."""
    own = () if origin is None else (f"Origin: {origin}",)
    lines = ("GET / HTTP/1.1", "Host: 127.0.0.1:8765", "Upgrade: WebSocket", *own, *fields, "", "")
    return "\r\n".join(lines).encode("latin-1")


ADMITTED = (None, "https://app.foxglove.dev", "file://", "http://localhost:8080", "http://[::1]:80")
REFUSED = (
    "https://evil.example", "null", "", "https://app.foxglove.dev.evil.example", "http://localhost.evil",
    "https://evil.example/localhost", "http://127.0.0.1@evil.example", "http://[", "http://127.0.0.2",
)  # fmt: skip


def test_only_programs_foxglove_and_pages_of_this_machine_are_admitted():
    """Neither a foreign page nor a port scan receives anything."""
    assert all(is_admitted(request(origin)) for origin in ADMITTED)
    assert not any(is_admitted(request(origin)) for origin in REFUSED)
    assert not any(is_admitted(request("file://", f"origin: {origin}")) for origin in REFUSED)
    assert not is_admitted(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    pytest.importorskip("foxglove")
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    from annotate.foxglove.server import FoxgloveServer

    evil, own = (
        partial(connect, origin=site, subprotocols=[PROTOCOL]) for site in ("https://evil.example", "file://")
    )
    with FoxgloveServer(0) as server:
        with pytest.raises(InvalidStatus, match="403"):
            evil(server.address)
        with own(server.address) as client:
            assert json.loads(client.recv(timeout=60))["op"] == "serverInfo"
        with pytest.raises(OSError):
            evil(f"ws://127.0.0.1:{server.behind[1]}")


def test_the_layout_of_the_documentation_is_current_and_shows_topics_that_there_are():
    pytest.importorskip("foxglove")
    from tools.docs.foxglove_layout import FILE, layout

    assert json.loads(FILE.read_text()) == json.loads(layout().to_json())
    assert set(re.findall(r'"(/[a-z/]+)"', FILE.read_text())) <= SCHEMAS.keys()


def test_live_streams_a_session_and_a_taken_port_ends_it_before_it_begins(annotate_cloud, rig_session):
    pytest.importorskip("foxglove")
    from websockets.sync.client import connect

    from annotate.foxglove.server import FoxgloveServer
    from annotate.live.stream import streamed

    with FoxgloveServer(0) as server:
        args = ("live", rig_session, "--no-window", "--serve", "--port", server.port)
        assert_refused(annotate_cloud(*args), "cannot be served")
    running = SimpleNamespace(
        frames=LatestValue(),
        warnings=(),
        rig=SimpleNamespace(events=deque([(1, Event(5, "mark"))]), calibration=BARE),
    )
    body_pose = BodyPose(JOINT_NAMES, np.ones((15, 3)), (), 0.0, 1.0, "sitting", 1.0)
    labels = FrameLabels("000000", labelled().cloud.depth_mm, labelled().parts)
    captured = SyncedFrame(RigFrame(0, 1, labels.depth_mm, b"no image"), 7, 9)
    latest = LiveFrame(captured, labelled().cloud, labels, body_pose, None, (), 1.0)
    with FoxgloveServer(0) as server, connect(server.address, subprotocols=[PROTOCOL]) as client:
        client.recv(timeout=60)
        topic_of, got = subscribed(client), {}
        with streamed(running, server):
            while not {EVENTS, topics.SKELETON} <= got.keys():
                running.rig.events[0] = (running.rig.events[0][0] + 1, Event(5, "mark"))
                running.frames.put(latest)
                with suppress(TimeoutError):
                    while isinstance(data := client.recv(timeout=0.2), bytes):
                        got[topic_of[struct.unpack("<I", data[1:5])[0]]] = data[13:]
    assert Log.FromString(got[EVENTS]).message == "mark"
    ball = SceneUpdate.FromString(got[topics.SKELETON]).entities[0].spheres[14].pose.position
    assert (ball.x, ball.y, ball.z) == (1, 1, 1)


def test_complaints_reach_a_client_that_comes_later_though_there_are_no_frames():
    pytest.importorskip("foxglove")
    from websockets.sync.client import connect

    from annotate.foxglove.server import FoxgloveServer
    from annotate.live.stream import streamed

    silent, full = LiveWarning("silent", "depth: no image"), LiveWarning("disk", "little room")
    running = SimpleNamespace(
        frames=LatestValue(), warnings=(silent,), rig=SimpleNamespace(events=deque(), calibration=BARE)
    )
    with (
        FoxgloveServer(0) as server,
        streamed(running, server),
        connect(server.address, subprotocols=[PROTOCOL]) as client,
    ):
        client.recv(timeout=60)
        topic_of = subscribed(client)

        def told() -> str:
            while not isinstance(data := client.recv(timeout=60), bytes):
                pass
            assert topic_of[struct.unpack("<I", data[1:5])[0]] == EVENTS
            return Log.FromString(data[13:]).message

        assert told() == silent.text
        running.warnings = (silent, full)
        assert told() == full.text  # and the first only once
