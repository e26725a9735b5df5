"""What Foxglove is shown equals the labels and the recording: from the file and over the network."""

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
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from annotate.cloud.fuse import Fuser
from annotate.foxglove import topics
from annotate.foxglove.file import export_foxglove
from annotate.foxglove.origin_gate import is_admitted
from annotate.foxglove.points import HEAT_POINT, PART_POINT
from annotate.foxglove.skeleton import BONES, skeleton_message
from annotate.foxglove.topics import SCHEMAS, Shown, shown_messages
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.live.live_frame import BodyPose, LiveFrame
from annotate.live.warning import LiveWarning
from annotate.parts import PART_ID, PARTS, palette_rgb
from eval.network.joint_files import noted_joints
from eval.scores.joint_errors import true_joints_mm
from eval.scores.joints import JOINT_NAMES
from sensors.errors import CloudError
from sensors.recording.device_readers import Event
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration, rotation_of
from sensors.session.messages import CALIBRATIONS, COLOR, DEPTH, EVENTS, TF, THERMAL, thermal_from_uint16
from sensors.session.reader import Session
from synth.rig.simulate import truth_path

CAMERA = Intrinsics(5, 4, 6.0, 6.0, 2.0, 1.5)
BARE = RigCalibration(CAMERA)
NUMPY = {PackedElementField.FLOAT32: "<f4", PackedElementField.UINT8: "u1"}


def read(path):
    """Messages by topic, in the order of the file, by the public reader alone."""
    found = {}
    with path.open("rb") as file:
        for _, channel, record, message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((record.log_time, message))
    return found


def image(message):
    """Pixels of a RawImage as its encoding says."""
    kind, channels = {"16UC1": ("<u2", 1), "8UC1": ("u1", 1), "rgb8": ("u1", 3)}[message.encoding]
    assert message.step == message.width * np.dtype(kind).itemsize * channels
    return np.frombuffer(message.data, kind).reshape(message.height, message.width, channels).squeeze()


def points(message):
    """Points of a PointCloud as its fields say."""
    names, offsets = [f.name for f in message.fields], [f.offset for f in message.fields]
    formats = [NUMPY[f.type] for f in message.fields]
    layout = {"names": names, "offsets": offsets, "formats": formats, "itemsize": message.point_stride}
    return np.frombuffer(message.data, np.dtype(layout))


@pytest.fixture(scope="module")
def exported(rig_session, tmp_path_factory):
    out = tmp_path_factory.mktemp("foxglove") / "people.mcap"
    truth = LabelSet.open(truth_path(rig_session))
    assert export_foxglove(truth, rig_session, partial(noted_joints, truth), out, lambda n: None) == []
    return out


def test_the_file_holds_the_numbers_of_labels_and_recording(exported, rig_session):
    truth, session, found = LabelSet.open(truth_path(rig_session)), Session(rig_session), read(exported)
    fuser = Fuser(session.calibration)
    for number, (labels, frame) in enumerate(zip(truth, session, strict=True)):
        cloud = fuser.fuse_frame(frame)
        at = {topic: messages[number][1] for topic, messages in found.items() if topic != EVENTS}
        assert {log_time for topic in at for log_time, _ in found[topic][number : number + 1]} == {
            frame.stamp_ns
        }
        np.testing.assert_array_equal(image(at[DEPTH]), labels.depth_mm)
        np.testing.assert_array_equal(image(at[topics.IDS]), labels.parts)
        np.testing.assert_array_equal(image(at[topics.PARTS]), palette_rgb()[labels.parts])
        assert at[COLOR].data == frame.color_encoded
        np.testing.assert_allclose(thermal_from_uint16(image(at[THERMAL])), frame.thermal_c, atol=0.0051)
        valid = cloud.valid
        for topic, kind in ((topics.HEAT_CLOUD, HEAT_POINT), (topics.PART_CLOUD, PART_POINT)):
            got = points(at[topic])
            assert got.dtype == kind and at[topic].frame_id == "depth"
            places = np.stack([got[axis] for axis in "xyz"], axis=1)
            np.testing.assert_array_equal(places, cloud.points_m[valid])
        np.testing.assert_array_equal(
            points(at[topics.HEAT_CLOUD])["temperature"], cloud.temperature_c[valid]
        )
        colored = points(at[topics.PART_CLOUD])
        np.testing.assert_array_equal(colored["part"], labels.parts[valid])
        head = colored[colored["part"] == PART_ID["head"]][0]
        assert (head["red"], head["green"], head["blue"], head["alpha"]) == (*PARTS[1].rgb, 255)
        balls = at[topics.SKELETON].entities[0].spheres
        joints = [[b.pose.position.x, b.pose.position.y, b.pose.position.z] for b in balls]
        np.testing.assert_allclose(1000 * np.array(joints), true_joints_mm(labels), atol=0.06)


def test_the_file_has_public_schemas_and_is_a_session_of_undistorted_images(exported, rig_session):
    with exported.open("rb") as file:
        summary = make_reader(file).get_summary()
        kinds = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    truth, again = LabelSet.open(truth_path(rig_session)), Session(exported)
    expected = {topic: schema.DESCRIPTOR.full_name for topic, schema in SCHEMAS.items()}
    assert kinds == {t: name for t, name in expected.items() if t != EVENTS or again.events}
    assert again.events == Session(rig_session).events
    for labels, frame in zip(truth, again, strict=True):
        np.testing.assert_array_equal(Fuser(again.calibration).fuse_frame(frame).depth_mm, labels.depth_mm)


def test_cameras_stand_where_the_calibration_says(exported, rig_session):
    calibration, found = Session(rig_session).calibration, read(exported)
    for topic, name in CALIBRATIONS.items():
        camera = getattr(calibration, name)
        camera = camera.undistorted() if name == "depth" else camera
        message = found[topic][0][1]
        np.testing.assert_allclose(np.array(message.K).reshape(3, 3), camera.matrix)
        np.testing.assert_allclose(message.D, camera.distortion)
        assert (message.width, message.height, message.frame_id) == (camera.width, camera.height, name)
    up, *links = found[TF][0][1].transforms
    assert (up.parent_frame_id, up.child_frame_id) == (topics.UPRIGHT, "depth")
    q = up.rotation
    upwards = rotation_of(np.array([q.x, q.y, q.z, q.w])) @ (0, -1, 0)  # from y down to z up
    np.testing.assert_allclose(upwards, (0, 0, 1), atol=1e-9)
    assert {link.child_frame_id for link in links} == {"color", "thermal"}
    for link in links:
        q, t = link.rotation, link.translation
        back = getattr(calibration, f"{link.child_frame_id}_from_depth").inverse()
        np.testing.assert_allclose(rotation_of(np.array([q.x, q.y, q.z, q.w])), back.rotation, atol=1e-9)
        np.testing.assert_allclose([t.x, t.y, t.z], back.translation_m)
        assert link.parent_frame_id == "depth"


def test_the_command_finds_the_recording_and_replaces_nothing(annotate_cloud, rig_session, tmp_path):
    truth = truth_path(rig_session)
    done = annotate_cloud("export", truth, tmp_path / "a.mcap", "--format", "foxglove", "--json")
    assert done.result == {
        "frames": 3,
        "format": "foxglove",
        "path": str(tmp_path / "a.mcap"),
        "remarks": [],
    }
    assert COLOR in read(tmp_path / "a.mcap")
    session = rig_session.read_bytes()
    args = ("export", truth, rig_session, "--format", "foxglove", "--overwrite")
    assert_refused(annotate_cloud(*args), "is the recording; name another file")
    assert_refused(annotate_cloud(*args[:2], tmp_path, *args[3:]), "is a folder; give the name of a file")
    assert_refused(annotate_cloud(*args[:2], tmp_path / "a.mcap", *args[3:-1]), "already exists")
    assert rig_session.read_bytes() == session and len(list(tmp_path.iterdir())) == 1


def test_without_the_recording_depth_parts_and_skeleton_are_shown(rig_session, tmp_path):
    truth = LabelSet.open(truth_path(rig_session))
    assert export_foxglove(truth, None, lambda frame: None, tmp_path / "a.mcap", lambda n: None) == []
    found = read(tmp_path / "a.mcap")
    without = {COLOR, THERMAL, topics.HEAT, EVENTS, "/color/calibration", "/thermal/calibration"}
    assert found.keys() == SCHEMAS.keys() - without
    np.testing.assert_array_equal(image(found[DEPTH][0][1]), truth.read(truth.frame_ids[0]).depth_mm)
    assert np.isnan(points(found[topics.HEAT_CLOUD][0][1])["temperature"]).all()


def labelled(shape=(4, 5), **fields) -> Shown:
    depth = np.full(shape, 1500, np.uint16)
    depth[0, 0] = 0
    calibration = RigCalibration(CAMERA)
    parts = np.arange(20, dtype=np.uint8).reshape(shape) % 12
    return Shown(7, Fuser(calibration).fuse(depth), parts, calibration, **fields)


def test_only_wanted_topics_are_made(monkeypatch):
    monkeypatch.setattr(topics, "heat_points", lambda *_: pytest.fail("no client has subscribed"))
    made = [topic for topic, *_ in shown_messages(labelled(), lambda topic: topic == DEPTH)]
    assert made == [DEPTH] and not list(shown_messages(labelled(), lambda topic: False))


def test_a_skeleton_has_the_bones_whose_ends_are_known_and_goes_with_the_person():
    joints = {name: (10.0 * i, 0.0, 1000.0) for i, name in enumerate(JOINT_NAMES)}
    assert {end for bone in BONES for end in bone[:2]} == set(JOINT_NAMES)
    (entity,) = skeleton_message(joints, 3).entities
    assert len(entity.spheres) == 15 and len(entity.lines[0].points) == 2 * len(BONES) == 28
    joints["left_knee"] = (np.nan, 0.0, 0.0)
    (entity,) = skeleton_message(joints, 3).entities
    assert len(entity.spheres) == 14 and len(entity.lines[0].points) == 24
    assert [m.key for m in entity.metadata] == [n for n in JOINT_NAMES if n != "left_knee"]
    gone = skeleton_message(None, 3)
    assert not gone.entities and len(gone.deletions) == 1


# The stream

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

    with FoxgloveServer(0) as server, pytest.raises(CloudError, match=r"in use.* --port"):
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
