"""Readers of bytes from outside: a small valid sample of each, and the call that reads it."""

import json
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer

from annotate.exchange.companion import Companion
from annotate.exchange.formats import FORMATS, import_labels
from annotate.faces import read_faces
from annotate.frame_labels import FrameLabels
from annotate.labelset import dataset, label_set
from annotate.labelset.dataset import MANIFEST, SCHEMA, Dataset, encode_shard, sha256
from annotate.labelset.label_set import LabelSet
from annotate.scheme.scheme_file import load_scheme, read_scheme, scheme_to_toml
from annotate.suit.palette import DEFAULT_SUIT, load_suit, suit_to_toml
from eval.architecture.compact import CompactConfig
from eval.architecture.networks import build
from eval.compare.compare import compare_sets
from eval.compare.results import Result, load_result, save_result
from eval.network.onnx_export import export_network
from eval.network.onnx_network import OnnxNetwork
from eval.network.weights_file import load_weights, save_weights
from sensors.calibration_files.calibration_yaml import read_yaml, write_yaml
from sensors.importers.open_source import open_source
from sensors.recording.rig_file import load_rig
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration, load_calibration, save_calibration
from sensors.session.mcap_records import record_offsets, records_at
from sensors.session.messages import PYROMETER, spot_message
from sensors.session.repair import Copier, repair
from sensors.session.writer import SessionWriter
from synth.body.skeleton import N_JOINTS
from synth.markers.motion_file import MarkerReport, Motion, load_motion, save_motion
from synth.markers.person_fit import bones_of_leg
from synth.motion_files.bvh import read_bvh
from synth.motion_files.joint_file import read_joint_file
from synth.motion_files.marker_files import read_markers
from synth.motion_files.marker_set import load_marker_set
from tests.helpers.bags import STORAGES, realsense, write_bag
from tests.helpers.bags import write_old_bag as write_ros1_bag
from tests.helpers.cloud_files import pcd
from tests.helpers.depth_files import png, write
from tests.helpers.flir_files import Written, flir_jpeg
from tests.helpers.marker_samples import positions, write_c3d, write_trc
from tests.helpers.orbbec_files import jpeg_of, write_orbbec_bag
from tests.helpers.realsense_files import write_old_bag
from tests.helpers.samples import azure_mkv, las
from tests.helpers.walker import bvh_of
from tools.fuzz.reader import Reader

CAMERA = Intrinsics(16, 12, 20.0, 21.0, 7.5, 5.5)
NUMBERS = {"fx": 20, "fy": 21, "cx": 7.5, "cy": 5.5, "width": 16, "height": 12}
RIG = RigCalibration(CAMERA, CAMERA, Pose.identity(), CAMERA, Pose.identity())
SMALL = CompactConfig((4, 4, 4, 4, 4))


def depth_image(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 5000, CAMERA.shape).astype(np.uint16)


def labelled(seed: int) -> FrameLabels:
    rng = np.random.default_rng(seed)
    parts = rng.choice([0, 1, 2, 11, 255], CAMERA.shape).astype(np.uint8)
    persons = rng.integers(0, 3, CAMERA.shape).astype(np.uint8)
    confidence = rng.random(CAMERA.shape).astype(np.float32)
    return FrameLabels(f"{seed:06d}", depth_image(seed), parts, confidence, "auto", "P1", {"a": 1}, persons)


def exhaust(frames: Iterable[object]) -> None:
    for frame in frames:
        if isinstance(frame, RigFrame):
            frame.decode_color()


def _session(path: Path) -> None:
    color = bytes(cv2.imencode(".jpg", np.zeros((*CAMERA.shape, 3), np.uint8))[1])
    with SessionWriter(path, RIG, "x") as writer:
        for i in range(3):
            warm = np.full(CAMERA.shape, 20.5, np.float32)
            writer.write(RigFrame(i, i * 10**8, depth_image(i), color, warm, depth_image(i)))
            writer.add(PYROMETER, spot_message(30.0, 20.0, 21.0, i * 10**8), i * 10**8)
            writer.event(i * 10**8, "flag closed")


def _bare_session(path: Path) -> None:
    """Write chunks without compression and checksums, so that damage reaches the messages."""
    whole = path.with_name("x.mcap")
    _session(whole)
    with whole.open("rb") as source, path.open("wb") as sink:
        writer = Writer(sink, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="", library="")
        copier = Copier(writer)
        for offset in record_offsets(source):
            for record in records_at(source, offset):
                copier.add(record)
        writer.finish()
    whole.unlink()


def _read_session(path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        repair(path, Path(folder) / "r.mcap")
    exhaust(open_source(path))


def _bag(storage: str, folder: Path) -> Path:
    plugin = next(plugin for plugin in STORAGES if plugin.name == storage)
    bag = write_bag(folder / "bag", plugin, realsense(2))
    return next(file for file in bag.iterdir() if file.suffix in (".db3", ".mcap"))


def _realsense(path: Path) -> None:
    yuyv = np.zeros((*CAMERA.shape, 2), np.uint8)
    frames = [(n, 30.0 * n, depth_image(n), yuyv[..., 0].copy(), yuyv) for n in (1, 2)]
    lens = (CAMERA, "Inverse Brown Conrady")
    write_old_bag(path, frames, (lens, lens))


def _orbbec(path: Path) -> None:
    frames = [(n, 1_000_000 + 30_000 * n, *2 * [depth_image(n)], jpeg_of(CAMERA, 60)) for n in (1, 2)]
    write_orbbec_bag(path, CAMERA, CAMERA, frames)


def _npy(path: Path) -> None:
    path.with_suffix(".json").write_text(json.dumps(NUMBERS))
    np.save(path, np.stack([depth_image(0), depth_image(1)]))


def _cloud(path: Path) -> None:
    FORMATS[path.suffix[1:]].write(iter([labelled(0)]), Companion(CAMERA), path.parent)


def _packed_cloud() -> bytes:
    """Return a compressed PCD of PCL's layout: LZF of one literal run after another."""
    data = np.random.default_rng(0).uniform(1, 2, (3, 60)).astype("<f4").tobytes()
    pieces = (data[at : at + 32] for at in range(0, len(data), 32))
    runs = b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)
    body = np.array([len(runs), len(data)], "<u4").tobytes() + runs
    return pcd(np.zeros((60, 3)), 60, 1, body, DATA="binary_compressed")


def _flir() -> bytes:
    photo = np.full((6, 8, 3), 90, np.uint8)
    return flir_jpeg(np.full((6, 8), 30.0), photo, Written(raw="png", photo="png"))


def _las(compressed: bool) -> bytes:
    return las(np.random.default_rng(0).uniform(-1, 1, (200, 3)), 0, compressed)


def _images(folder: Path) -> None:
    for i in range(2):
        color = np.zeros((4, 4, 3), np.uint8)
        for name, image in (("depth", depth_image(i)), ("rgb", color), ("thermal", depth_image(i))):
            write(folder / name / f"{i}.png", png(image))
    (folder / "associations.txt").write_text("0.1 depth/0.png 0.1 rgb/0.png\n0.2 depth/1.png 0.2 rgb/1.png\n")
    (folder / "intrinsics.json").write_text(json.dumps({**NUMBERS, "k1": 0.1, "depth_unit_mm": 2}))


def _depths(suffix: str, count: int, folder: Path) -> Path:
    for i in range(count):
        write(folder / "depth" / f"{i}{suffix}", bytes(cv2.imencode(suffix, depth_image(i))[1]))
    (folder / "intrinsics.json").write_text(json.dumps(NUMBERS))
    return folder


def _labels(path: Path) -> None:
    labels = LabelSet.create(path, CAMERA, {"source": "x"})
    for i in range(2):
        labels.write(labelled(i))


def _read_labels(path: Path) -> None:
    labels = LabelSet.open(path)
    label_set.validate(labels)
    exhaust(labels)


def _dataset(folder: Path) -> None:
    (folder / "s.tar").write_bytes(encode_shard([labelled(0), labelled(1)]))
    shards = [{"file": "s.tar", "sha256": sha256(folder / "s.tar")}]
    (folder / MANIFEST).write_text(json.dumps({"schema": SCHEMA, "shards": shards, "images": 2}))


def _read_dataset(path: Path) -> None:
    opened = Dataset.open(path)
    dataset.validate(opened)
    exhaust(opened)


def _rig(path: Path) -> None:
    save_calibration(path.with_name("c.json"), RIG)
    text = 'name = "a"\ncalibration = "c.json"\ndevices = ["virtual:kinect2"]\n[latency_ms]\n'
    path.write_text(text + '"virtual:kinect2" = 25\n')


def _result(path: Path) -> None:
    folder = path.with_name("labels")
    _labels(folder)
    labels = LabelSet.open(folder)
    result = Result("x", compare_sets(labels, labels, workers=1))
    shutil.rmtree(folder)
    save_result(path, result)


def _exported(name: str, folder: Path) -> None:
    companion, frames = Companion(CAMERA), [labelled(0), labelled(1)]
    for frame in frames:
        companion.add(frame)
    FORMATS[name].write(iter(frames), companion, folder)
    companion.save(folder)


def _read_exported(path: Path) -> None:
    """Import labels. Raises AssertionError for a file outside the label set."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        try:
            import_labels(path, root / "out", lambda n: None)
        finally:
            assert {entry.name for entry in root.iterdir()} <= {"out"}, "a file outside the output folder"


def _read_frames(path: Path) -> None:
    exhaust(open_source(path))


def _motion(path: Path) -> None:
    report = MarkerReport(("LASI", "RASI"), np.zeros((3, 2), np.float32), np.zeros((3, 2), np.uint8), ("x",))
    save_motion(path, Motion(np.zeros((3, N_JOINTS, 3)), np.zeros((3, 3)), 100.0, bones_of_leg(0.8), report))


def _joints(path: Path) -> None:
    """Write rotations as AMASS stores them."""
    np.savez(path, poses=np.full((2, 66), 0.1), trans=np.zeros((2, 3)), mocap_framerate=60.0)


PLACE = '{ joint = "left_knee", at_m = [0.05, 0, 0], spread_mm = 30, weight = 1 }'
MARKER_SET = f'name = "mine"\n[markers]\nLKNE = {PLACE}\nRKNE = {PLACE}\n'

POSES = json.dumps({"0.png": [[[9.5, 8.25, 0.9]] * 33]}).encode()

# A reader's name: name of the sample in its folder ("" = the folder itself), its writer or bytes, its reader.
TABLE = {
    "session": ("x.mcap", _session, _read_session),
    "session-bare": ("bare.mcap", _bare_session, _read_session),
    "bag-ros1": ("x.bag", lambda path: write_ros1_bag(path, realsense(2), ""), _read_frames),
    "bag-ros1-lz4": ("x.bag", lambda path: write_ros1_bag(path, realsense(2), "LZ4"), _read_frames),
    "realsense": ("x.bag", _realsense, _read_frames),
    "orbbec": ("x.bag", _orbbec, _read_frames),
    "mkv": ("x.mkv", lambda path: write(path, azure_mkv(1)), _read_frames),
    "npy": ("x.npy", _npy, _read_frames),
    "npz": ("x.npz", lambda p: np.savez_compressed(p, depth=depth_image(), K=CAMERA.matrix), _read_frames),
    "pcd": ("000000.pcd", _cloud, _read_frames),
    "ply": ("000000.ply", _cloud, _read_frames),
    "pcd-compressed": ("x.pcd", lambda path: write(path, _packed_cloud()), _read_frames),
    "flir": ("x.jpg", lambda path: write(path, _flir()), _read_frames),
    "las": ("x.las", lambda path: write(path, _las(False)), _read_frames),
    "laz": ("x.laz", lambda path: write(path, _las(True)), _read_frames),
    "images": ("", _images, _read_frames),
    "tiffs": ("", partial(_depths, ".tiff", 2), _read_frames),
    "pgms": ("", partial(_depths, ".pgm", 1), _read_frames),
    "labels": ("labels", _labels, _read_labels),
    "dataset": ("", _dataset, _read_dataset),
    "c3d": ("x.c3d", lambda path: write_c3d(path, positions()), read_markers),
    "trc": ("x.trc", lambda path: write_trc(path, positions()), read_markers),
    "bvh": ("x.bvh", lambda path: write(path, bvh_of().encode()), read_bvh),
    "joints": ("j.npz", _joints, read_joint_file),
    "motion": ("m.npz", _motion, load_motion),
    "marker-set": ("m.toml", lambda path: path.write_text(MARKER_SET), load_marker_set),
    "scheme": ("s.toml", lambda path: path.write_text(scheme_to_toml(load_scheme("paper"))), read_scheme),
    "poses": ("people.json", lambda path: write(path, POSES), read_faces),
    "suit": ("suit.toml", lambda path: path.write_text(suit_to_toml(DEFAULT_SUIT)), load_suit),
    "rig": ("rig.toml", _rig, load_rig),
    "calibration": ("c.json", lambda path: save_calibration(path, RIG), load_calibration),
    "yaml": ("", lambda path: write_yaml(path, replace(RIG, depth_shift_mm=5.0)), read_yaml),
    "result": ("r.npz", _result, load_result),
    "onnx": ("w.onnx", lambda path: export_network(build(SMALL), path), OnnxNetwork),
    "safetensors": ("w.safetensors", lambda path: save_weights(path, build(SMALL), SMALL), load_weights),
    **{f"export-{name}": ("", partial(_exported, name), _read_exported) for name in FORMATS},
}


def _made(name: str, writer: object, folder: Path) -> Path:
    writer(folder / name)
    return folder / name


READERS = {
    "bag-sqlite": Reader(partial(_bag, "SQLITE3"), _read_frames),
    "bag-mcap": Reader(partial(_bag, "MCAP"), _read_frames),
    **{key: Reader(partial(_made, name, writer), read) for key, (name, writer, read) in TABLE.items()},
}
