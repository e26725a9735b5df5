"""Every reader of bytes from outside: how a small valid sample is made, and how it is read."""

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
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import MANIFEST, SCHEMA, Dataset, encode_shard, sha256
from annotate.labelset.dataset import validate as validate_dataset
from annotate.labelset.label_set import LabelSet
from annotate.labelset.label_set import validate as validate_labels
from annotate.suit.palette import DEFAULT_SUIT, load_suit, suit_to_toml
from eval.compare.compare import compare_sets
from eval.compare.results import Result, load_result, save_result
from eval.network.compact import CompactConfig
from eval.network.networks import build
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
from tests.helpers.flir_files import Written, flir_jpeg
from tests.helpers.marker_samples import positions, write_c3d, write_trc
from tests.helpers.orbbec_files import jpeg_of, write_orbbec_bag
from tests.helpers.realsense_files import write_old_bag
from tests.helpers.samples import azure_mkv, las
from tests.helpers.walker import bvh_of
from tools.fuzz.reader import Reader

CAMERA = Intrinsics(16, 12, 20.0, 21.0, 7.5, 5.5)
RIG = RigCalibration(CAMERA, CAMERA, Pose.identity(), CAMERA, Pose.identity())


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


def png(image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", image)[1])


def _session(folder: Path) -> Path:
    color = bytes(cv2.imencode(".jpg", np.zeros((*CAMERA.shape, 3), np.uint8))[1])
    with SessionWriter(folder / "x.mcap", RIG, "x") as writer:
        for i in range(3):
            warm = np.full(CAMERA.shape, 20.5, np.float32)
            writer.write(RigFrame(i, i * 10**8, depth_image(i), color, warm, depth_image(i)))
            writer.add(PYROMETER, spot_message(30.0, 20.0, 21.0, i * 10**8), i * 10**8)
            writer.event(i * 10**8, "flag closed")
    return folder / "x.mcap"


def _bare_session(folder: Path) -> Path:
    """A session whose chunks are neither compressed nor summed: damage in it reaches the messages."""
    whole = _session(folder)
    bare = folder / "bare.mcap"
    with whole.open("rb") as source, bare.open("wb") as sink:
        writer = Writer(sink, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="", library="")
        copier = Copier(writer)
        for offset in record_offsets(source):
            for record in records_at(source, offset):
                copier.add(record)
        writer.finish()
    whole.unlink()
    return bare


def _read_session(path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        repair(path, Path(folder) / "r.mcap")
    exhaust(open_source(path))


def _bag(storage: str, folder: Path) -> Path:
    plugin = next(plugin for plugin in STORAGES if plugin.name == storage)
    bag = write_bag(folder / "bag", plugin, realsense(2))
    return next(file for file in bag.iterdir() if file.suffix in (".db3", ".mcap"))


def _ros1(compression: str, folder: Path) -> Path:
    return write_ros1_bag(folder / "x.bag", realsense(2), compression)


def _realsense(folder: Path) -> Path:
    height, width = CAMERA.shape
    yuyv = np.zeros((height, width, 2), np.uint8)
    frames = [(n, 30.0 * n, depth_image(n), yuyv[..., 0].copy(), yuyv) for n in (1, 2)]
    lens = CAMERA, "Inverse Brown Conrady"
    return write_old_bag(folder / "x.bag", frames, lens, lens)


def _orbbec(folder: Path) -> Path:
    frames = [(n, 1_000_000 + 30_000 * n, *2 * [depth_image(n)], jpeg_of(CAMERA, 60)) for n in (1, 2)]
    return write_orbbec_bag(folder / "x.bag", CAMERA, CAMERA, frames)


def _written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def _mkv(folder: Path) -> Path:
    return _written(folder / "x.mkv", azure_mkv(1))


def _npy(folder: Path) -> Path:
    (folder / "x.json").write_text(json.dumps({**_numbers()}))
    np.save(folder / "x.npy", np.stack([depth_image(0), depth_image(1)]))
    return folder / "x.npy"


def _npz(folder: Path) -> Path:
    np.savez_compressed(folder / "x.npz", depth=depth_image(), K=CAMERA.matrix)
    return folder / "x.npz"


def _numbers() -> dict[str, float]:
    return {"fx": 20, "fy": 21, "cx": 7.5, "cy": 5.5, "width": 16, "height": 12}


def _cloud(suffix: str, folder: Path) -> Path:
    FORMATS[suffix].write(iter([labelled(0)]), CAMERA, folder)
    return folder / f"000000.{suffix}"


def _packed_cloud(folder: Path) -> Path:
    """A compressed PCD of PCL's layout: LZF of one literal run after another."""
    data = np.random.default_rng(0).uniform(1, 2, (3, 60)).astype("<f4").tobytes()
    runs = b"".join(
        bytes([len(run) - 1]) + run for run in (data[at : at + 32] for at in range(0, len(data), 32))
    )
    body = np.array([len(runs), len(data)], "<u4").tobytes() + runs
    return _written(folder / "x.pcd", pcd(np.zeros((60, 3)), 60, 1, body, DATA="binary_compressed"))


def _flir(folder: Path) -> Path:
    photo = np.full((6, 8, 3), 90, np.uint8)
    return _written(
        folder / "x.jpg", flir_jpeg(np.full((6, 8), 30.0), photo, Written(raw="png", photo="png"))
    )


def _las(suffix: str, folder: Path) -> Path:
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    return _written(folder / f"x.{suffix}", las(points, 0, suffix == "laz"))


def _images(folder: Path) -> Path:
    for i in range(2):
        for name, content in (
            ("depth", depth_image(i)),
            ("rgb", np.zeros((4, 4, 3), np.uint8)),
            ("thermal", depth_image(i)),
        ):
            (folder / name).mkdir(exist_ok=True)
            (folder / name / f"{i}.png").write_bytes(png(content))
    (folder / "associations.txt").write_text("0.1 depth/0.png 0.1 rgb/0.png\n0.2 depth/1.png 0.2 rgb/1.png\n")
    (folder / "intrinsics.json").write_text(json.dumps({**_numbers(), "k1": 0.1, "depth_unit_mm": 2}))
    return folder


def _tiffs(folder: Path) -> Path:
    (folder / "depth").mkdir()
    for i in range(2):
        (folder / "depth" / f"{i}.tiff").write_bytes(bytes(cv2.imencode(".tiff", depth_image(i))[1]))
    (folder / "intrinsics.json").write_text(json.dumps(_numbers()))
    return folder


def _pgms(folder: Path) -> Path:
    (folder / "depth").mkdir()
    (folder / "depth" / "0.pgm").write_bytes(bytes(cv2.imencode(".pgm", depth_image(0))[1]))
    (folder / "intrinsics.json").write_text(json.dumps(_numbers()))
    return folder


def _labels(folder: Path) -> Path:
    labels = LabelSet.create(folder / "labels", CAMERA, {"source": "x"})
    for i in range(2):
        labels.write(labelled(i))
    return labels.path


def _read_labels(path: Path) -> None:
    labels = LabelSet.open(path)
    validate_labels(labels)
    exhaust(labels)


def _dataset(folder: Path) -> Path:
    (folder / "s.tar").write_bytes(encode_shard([labelled(0), labelled(1)]))
    shards = [{"file": "s.tar", "sha256": sha256(folder / "s.tar")}]
    (folder / MANIFEST).write_text(json.dumps({"schema": SCHEMA, "shards": shards, "images": 2}))
    return folder


def _read_dataset(path: Path) -> None:
    dataset = Dataset.open(path)
    validate_dataset(dataset)
    exhaust(dataset)


def _markers(suffix: str, folder: Path) -> Path:
    path = folder / f"x.{suffix}"
    {"c3d": write_c3d, "trc": write_trc}[suffix](path, positions())
    return path


def _bvh(folder: Path) -> Path:
    return _written(folder / "x.bvh", bvh_of().encode())


def _suit(folder: Path) -> Path:
    return _written(folder / "suit.toml", suit_to_toml(DEFAULT_SUIT).encode())


def _rig(folder: Path) -> Path:
    save_calibration(folder / "c.json", RIG)
    text = 'name = "a"\ncalibration = "c.json"\ndevices = ["virtual:kinect2"]\n[latency_ms]\n'
    (folder / "rig.toml").write_text(text + '"virtual:kinect2" = 25\n')
    return folder / "rig.toml"


def _calibration(folder: Path) -> Path:
    save_calibration(folder / "c.json", RIG)
    return folder / "c.json"


def _yaml(folder: Path) -> Path:
    write_yaml(folder, replace(RIG, depth_shift_mm=5.0))
    return folder


def _result(folder: Path) -> Path:
    labels = LabelSet.open(_labels(folder))
    result = Result("x", compare_sets(labels, labels, workers=1))
    shutil.rmtree(labels.path)
    save_result(folder / "r.npz", result)
    return folder / "r.npz"


def _onnx(folder: Path) -> Path:
    export_network(build(CompactConfig((4, 4, 4, 4, 4))), folder / "w.onnx")
    return folder / "w.onnx"


def _weights(folder: Path) -> Path:
    config = CompactConfig((4, 4, 4, 4, 4))
    save_weights(folder / "w.safetensors", build(config), config)
    return folder / "w.safetensors"


def _exported(name: str, folder: Path) -> Path:
    companion, frames = Companion(CAMERA), [labelled(0), labelled(1)]
    for frame in frames:
        companion.add(frame)
    FORMATS[name].write(iter(frames), CAMERA, folder)
    companion.save(folder)
    return folder


def _read_exported(path: Path) -> None:
    """Import, and nothing may appear but the label set."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        try:
            import_labels(path, root / "out", lambda n: None)
        finally:
            assert {entry.name for entry in root.iterdir()} <= {"out"}, "a file outside the output folder"


def _read_frames(path: Path) -> None:
    exhaust(open_source(path))


def _motion(folder: Path) -> Path:
    report = MarkerReport(("LASI", "RASI"), np.zeros((3, 2), np.float32), np.zeros((3, 2), np.uint8), ("x",))
    motion = Motion(np.zeros((3, N_JOINTS, 3)), np.zeros((3, 3)), 100.0, bones_of_leg(0.8), report)
    save_motion(folder / "m.npz", motion)
    return folder / "m.npz"


def _joints(folder: Path) -> Path:
    """Rotations as AMASS holds them."""
    np.savez(folder / "j.npz", poses=np.full((2, 66), 0.1), trans=np.zeros((2, 3)), mocap_framerate=60.0)
    return folder / "j.npz"


def _marker_set(folder: Path) -> Path:
    place = '{ joint = "left_knee", at_m = [0.05, 0, 0], spread_mm = 30, weight = 1 }'
    (folder / "m.toml").write_text(f'name = "mine"\n[markers]\nLKNE = {place}\nRKNE = {place}\n')
    return folder / "m.toml"


READERS = {
    "session": Reader(_session, _read_session),
    "session-bare": Reader(_bare_session, _read_session),
    "bag-sqlite": Reader(partial(_bag, "SQLITE3"), _read_frames),
    "bag-mcap": Reader(partial(_bag, "MCAP"), _read_frames),
    "bag-ros1": Reader(partial(_ros1, ""), _read_frames),
    "bag-ros1-lz4": Reader(partial(_ros1, "LZ4"), _read_frames),
    "realsense": Reader(_realsense, _read_frames),
    "orbbec": Reader(_orbbec, _read_frames),
    "mkv": Reader(_mkv, _read_frames),
    "npy": Reader(_npy, _read_frames),
    "npz": Reader(_npz, _read_frames),
    "pcd": Reader(partial(_cloud, "pcd"), _read_frames),
    "ply": Reader(partial(_cloud, "ply"), _read_frames),
    "pcd-compressed": Reader(_packed_cloud, _read_frames),
    "flir": Reader(_flir, _read_frames),
    "las": Reader(partial(_las, "las"), _read_frames),
    "laz": Reader(partial(_las, "laz"), _read_frames),
    "images": Reader(_images, _read_frames),
    "tiffs": Reader(_tiffs, _read_frames),
    "pgms": Reader(_pgms, _read_frames),
    "labels": Reader(_labels, _read_labels),
    "dataset": Reader(_dataset, _read_dataset),
    "c3d": Reader(partial(_markers, "c3d"), read_markers),
    "trc": Reader(partial(_markers, "trc"), read_markers),
    "bvh": Reader(_bvh, read_bvh),
    "joints": Reader(_joints, read_joint_file),
    "motion": Reader(_motion, load_motion),
    "marker-set": Reader(_marker_set, load_marker_set),
    "suit": Reader(_suit, load_suit),
    "rig": Reader(_rig, load_rig),
    "calibration": Reader(_calibration, load_calibration),
    "yaml": Reader(_yaml, read_yaml),
    "result": Reader(_result, load_result),
    "onnx": Reader(_onnx, OnnxNetwork),
    "safetensors": Reader(_weights, load_weights),
    **{f"export-{name}": Reader(partial(_exported, name), _read_exported) for name in FORMATS},
}
"""By name."""
