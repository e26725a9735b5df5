"""Foxglove's messages equal the labels and the recording, in the file and over the network."""

from functools import partial

import numpy as np
import pytest
from conftest import assert_refused
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from annotate.cloud.fuse import Fuser
from annotate.foxglove import topics
from annotate.foxglove.file import FoxgloveSource, export_foxglove
from annotate.foxglove.points import HEAT_POINT, PART_POINT
from annotate.foxglove.skeleton import BONES, skeleton_message
from annotate.foxglove.topics import SCHEMAS, Shown, shown_messages
from annotate.labelset.label_set import LabelSet
from annotate.parts import PAPER, PART_ID, PARTS, palette_rgb
from eval.network.joints.joint_files import noted_joints
from eval.scores.joint_errors import true_joints_mm
from eval.scores.joints import JOINT_NAMES
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration, rotation_of
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
    source = FoxgloveSource(truth, rig_session, partial(noted_joints, truth))
    assert export_foxglove(source, out, lambda n: None) == []
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
    source = FoxgloveSource(truth, None, lambda frame: None)
    assert export_foxglove(source, tmp_path / "a.mcap", lambda n: None) == []
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
    (entity,) = skeleton_message(joints, 3, PAPER).entities
    assert len(entity.spheres) == 15 and len(entity.lines[0].points) == 2 * len(BONES) == 28
    joints["left_knee"] = (np.nan, 0.0, 0.0)
    (entity,) = skeleton_message(joints, 3, PAPER).entities
    assert len(entity.spheres) == 14 and len(entity.lines[0].points) == 24
    assert [m.key for m in entity.metadata] == [n for n in JOINT_NAMES if n != "left_knee"]
    gone = skeleton_message(None, 3, PAPER)
    assert not gone.entities and len(gone.deletions) == 1
