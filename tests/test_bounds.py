"""Bounds of readers: each admits what is honest; those that no other test states are tried at their ends."""

import json
import re
from importlib import import_module
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_synth_garments import write_garment
from test_synth_motion_driven import joint_file, squatting

from annotate.gui.state.keys import MAX_TOML_BYTES, load_settings
from eval.scores.counts import WIDTH
from eval.scores.joints import N_JOINTS
from sensors.calibration_files.calibration_yaml import FILES, read_yaml, write_yaml
from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import CalibrationError, CloudError, DeviceError, FormatError
from sensors.files.bounded import MAX_IMAGE_BYTES, MAX_IMAGE_SIDE, read_bounded
from sensors.files.images import decode_grey
from sensors.files.npz import array_sizes
from sensors.importers.ebml import MAX_ELEMENT_BYTES, EbmlFile, Element
from sensors.recording.rig_file import RecordingRig
from sensors.rig.pairing import MAX_LATENCY_MS
from sensors.rig.rig_calibration import (
    MAX_CALIBRATION_BYTES,
    RigCalibration,
    load_calibration,
    save_calibration,
)
from sensors.session.host_times import host_times
from sensors.session.index import PLACE
from synth.clothes import makehuman_garments
from synth.clothes.makehuman_garments import read_garment
from synth.motion_files import joint_file as joint_files
from synth.motion_files.joint_file import read_joint_file
from synth.motion_files.marker_files import MAX_HEAD_LINES, read_markers
from tests.helpers.marker_samples import positions, write_trc

PACKAGES = ("sensors", "annotate", "synth", "eval", "cli")
RIG = RigCalibration(KINECT2_DEPTH)
HOUR_S = 3600
HONEST: dict[str, float] = {
    "annotate.exchange.companion.MAX_TEXT_BYTES": 50_000 * 10_000,  # frames of CVAT
    "annotate.exchange.unpacked.MAX_FILES": 2 * 1_000_000,  # frames
    "annotate.exchange.parquet.MAX_GROUP_BYTES": 1000 * 1024 * 1024 * 2,  # images of 16 bits
    "annotate.gui.state.keys.MAX_TOML_BYTES": 300 * 100,  # lines
    "annotate.labelset.dataset.MAX_MANIFEST_BYTES": 1_000_000 * 120,  # shards
    "annotate.labelset.dataset.MAX_MEMBER_BYTES": 4096 * 4096 * 3,  # pixels of a colour image
    "annotate.labelset.dataset.MAX_SHARD_BYTES": 1_000_000_000,  # what WebDataset recommends
    "annotate.labelset.journal.MAX_BYTES": 1_000_000 * 2000,  # strokes
    "annotate.exchange.annotated_images.MAX_IMAGES": 1_000_000,  # a large export
    "annotate.labelset.label_set.MAX_JSON_BYTES": 10_000_000,  # a step's list of 100,000 frames
    "annotate.segmentation.suit_network.MAX_BYTES": 10 * 2_088_498,  # ten times the shipped reader
    "annotate.suit.palette.MAX_SWATCHES": 11 * 12,  # colours of every part
    "annotate.suit.palette.MAX_TOML_BYTES": 11 * 12 * 400,
    "eval.compare.results.MAX_BYTES": 326_984 * (4 * WIDTH + 8 * (N_JOINTS + 3) + 300),  # the paper's images
    "eval.network.onnx_network.MAX_WEIGHT_BYTES": 540_000_000,  # the paper's network
    "eval.report.training_history.MAX_BYTES": 10_000 * 5000,  # epochs
    "sensors.files.bounded.MAX_IMAGE_BYTES": 8192 * 8192 * 2,  # 16 bits a pixel, not compressed
    "sensors.files.bounded.MAX_IMAGE_SIDE": 7680,  # 8K
    "sensors.files.flir_jpeg.MAX_RECORDS": 30,  # of an image: raw data, photograph, camera, palette, GPS
    "sensors.importers.arrays.MAX_UNPACKED_BYTES": 30
    * 30
    * 640
    * 576
    * 2,  # half a minute of an Azure Kinect
    "sensors.importers.bags.ros1_file.MAX_HEADER_BYTES": 1000,  # names of topics
    "sensors.importers.clouds.records.MAX_POINTS": 40_000_000,  # of a scanner on a tripod
    "sensors.importers.clouds.records.MAX_HEADER_BYTES": 10_000,  # comments
    "sensors.importers.clouds.pcd_file.MAX_POINT_BYTES": 5000 * 4,  # a histogram
    "sensors.importers.clouds.ply_file.MAX_LIST": 10_000,  # corners of a polygon
    "sensors.importers.ebml.MAX_ELEMENT_BYTES": 4096 * 3072 * 2,  # an Azure Kinect's largest image
    "sensors.importers.tum_lists.MAX_BYTES": 8 * HOUR_S * 30 * 60,  # lines of a night
    "sensors.recording.rig_file.MAX_BYTES": 100 * 300,  # devices
    "sensors.rig.clock.MAX_EPOCHS": 8 * HOUR_S // 10,  # a loose plug in a night
    "sensors.rig.pairing.MAX_LATENCY_MS": 500,  # a camera behind a network's encoder
    "sensors.rig.rig_calibration.MAX_CALIBRATION_BYTES": 100_000,  # an Azure Kinect's own has 12 kB
    "sensors.session.index.MAX_MESSAGES": 24 * HOUR_S * 30 * 6,  # a day of six streams
    "sensors.session.mcap_records.MAX_CHUNK_RECORDS": 4_000_000 // 31,  # empty messages of 31 bytes
    "sensors.session.mcap_records.MAX_RECORD_BYTES": 8192 * 8192 * 2,
    "sensors.session.stored_index.MAX_COLUMN_BYTES": 6 * HOUR_S * 30 * 4 * 40,  # six hours of four streams
    "sensors.session.stored_index.MAX_HEADER_BYTES": 20_000 * 100,  # events
    "synth.body.body.MAX_BYTES": 30 * 800_000,  # a body of thirty times the shipped ones' vertices
    "synth.clothes.makehuman_garments.MAX_FILE_BYTES": 500_000 * 100,  # vertices
    "synth.motion_files.bvh.MAX_CENTRES": HOUR_S // 4 * 120 * 100,  # of 100 joints
    "synth.motion_files.bvh.MAX_FILE_BYTES": HOUR_S // 4 * 120 * 300 * 9,
    "synth.motion_files.joint_file.MAX_BYTES": 12 * HOUR_S * 30 * 40 * 3 * 4,  # 40 joints, float32
    "synth.motion_files.marker_files.MAX_FILE_BYTES": HOUR_S * 120 * 100 * 16,  # 100 markers of a C3D
    "synth.motion_files.marker_files.MAX_POSITIONS": HOUR_S * 120 * 100,
    "synth.motion_files.marker_set.MAX_FILE_BYTES": 1000 * 200,  # markers
    "synth.markers.motion_file.MAX_BYTES": 3 * HOUR_S * 60 * 40 * 12,  # 40 markers
    "synth.motion_files.marker_files.MAX_HEAD_LINES": 30,  # five, and comments
}
"""By bound: the largest honest value known."""


def test_every_bound_of_the_product_admits_what_is_honest():
    root, bounds = Path(__file__).parent.parent, {}
    for path in chain.from_iterable((root / package).rglob("*.py") for package in PACKAGES):
        for name in re.findall(r"^MAX_\w+", path.read_text(), re.MULTILINE):
            module = ".".join(path.relative_to(root).with_suffix("").parts)
            bounds[f"{module}.{name}"] = getattr(import_module(module), name)
    assert bounds.keys() == HONEST.keys()
    assert [name for name, bound in bounds.items() if bound < HONEST[name]] == []


def sparse(path: Path, size: int) -> Path:
    """A file made longer by zeros, which take no place on the disk."""
    with path.open("r+b") as file:
        file.truncate(size)
    return path


def test_an_image_file(tmp_path):
    path, depth = tmp_path / "depth.png", np.arange(12, dtype=np.uint16).reshape(3, 4)
    path.write_bytes(bytes(cv2.imencode(".png", depth)[1]))
    read = decode_grey(read_bounded(sparse(path, MAX_IMAGE_BYTES)), np.uint16, "depth")
    np.testing.assert_array_equal(read, depth)
    with pytest.raises(FormatError, match="larger than"):
        read_bounded(sparse(path, MAX_IMAGE_BYTES + 1))


def test_calibration_files(tmp_path):
    rig, lens, folder = tmp_path / "rig.json", tmp_path / "intrinsics.json", tmp_path / "yaml"
    save_calibration(rig, RIG)
    lens.write_text(json.dumps({"fx": 300, "fy": 300, "cx": 10, "cy": 10, "width": 32, "height": 24}))
    folder.mkdir()
    write_yaml(folder, RIG)
    for path, read in (
        (rig, load_calibration),
        (lens, read_intrinsics),
        (folder / FILES["depth"], lambda path: read_yaml(path.parent)),
    ):
        text, expected = path.read_text(), read(path)
        filled(path, text, MAX_CALIBRATION_BYTES)
        assert repr(read(path)) == repr(expected)
        filled(path, text, MAX_CALIBRATION_BYTES + 1)
        with pytest.raises(CalibrationError, match="larger than"):
            read(path)


def test_a_camera_s_latency():
    """A rig's is taken up to a second; what a recording states beyond it is not believed."""
    places = np.zeros(5, PLACE)
    places["stamp_ns"] = places["arrival_ns"] = np.arange(5) * 10**9
    for late_ms, taken_ms in ((MAX_LATENCY_MS, MAX_LATENCY_MS), (MAX_LATENCY_MS + 1, 0)):
        stated = {"clock /depth/image": "kinect2", "latency /depth/image": f"{late_ms:g}"}
        host_ns = host_times({"/depth/image": places}, stated).ns["/depth/image"]
        np.testing.assert_allclose(places["stamp_ns"] - host_ns, taken_ms * 1e6, atol=1)
    assert RecordingRig("rig", ("a:b",), None, {"a:b": MAX_LATENCY_MS}).latency_ms
    with pytest.raises(DeviceError, match="0 to 1000"):
        RecordingRig("rig", ("a:b",), None, {"a:b": MAX_LATENCY_MS + 1})


@pytest.mark.parametrize("shape", [(1, MAX_IMAGE_SIDE), (MAX_IMAGE_SIDE, 1)])
def test_sides_of_an_image(shape):
    image = np.zeros(shape, np.uint16)
    assert decode_grey(bytes(cv2.imencode(".png", image)[1]), np.uint16, "depth").shape == shape
    longer = np.concatenate([image, image], axis=int(np.argmax(shape)))
    with pytest.raises(FormatError, match=f"at most {MAX_IMAGE_SIDE}"):
        decode_grey(bytes(cv2.imencode(".png", longer)[1]), np.uint16, "depth")


def test_an_element_of_matroska(tmp_path):
    with (tmp_path / "sparse.mkv").open("w+b") as file:
        file.truncate(MAX_ELEMENT_BYTES + 1)
        assert len(EbmlFile(file).bytes(Element(1, 0, MAX_ELEMENT_BYTES))) == MAX_ELEMENT_BYTES
        with pytest.raises(FormatError, match="at most"):
            EbmlFile(file).bytes(Element(1, 0, MAX_ELEMENT_BYTES + 1))


def test_lines_before_the_labels_of_a_trc(tmp_path):
    path = tmp_path / "a.trc"
    write_trc(path, positions(2))
    lines = path.read_text().split("\n")
    at = next(i for i, line in enumerate(lines) if line.startswith("Frame#"))
    for more in (MAX_HEAD_LINES - 1 - at, MAX_HEAD_LINES - at):
        path.write_text("\n".join([lines[0], *["remark\t"] * more, *lines[1:]]))
        if more + at < MAX_HEAD_LINES:
            assert len(read_markers(path).positions) == 2
    with pytest.raises(FormatError, match="Frame#"):
        read_markers(path)


def test_a_library_of_joint_positions(tmp_path, monkeypatch):
    path = joint_file(tmp_path / "lib.npz", squatting(30))
    unpacked = sum(array_sizes(path, "").values())
    monkeypatch.setattr(joint_files, "MAX_BYTES", unpacked)
    assert len(read_joint_file(path)[0]["a"].positions) == 30
    monkeypatch.setattr(joint_files, "MAX_BYTES", unpacked - 1)
    with pytest.raises(FormatError, match="unpacks to"):
        read_joint_file(path)


def test_a_garment(tmp_path, monkeypatch):
    path = write_garment(tmp_path)
    size = max(one.stat().st_size for one in tmp_path.iterdir())
    monkeypatch.setattr(makehuman_garments, "MAX_FILE_BYTES", size)
    assert read_garment(path).hidden.any()
    monkeypatch.setattr(makehuman_garments, "MAX_FILE_BYTES", size - 1)
    with pytest.raises(CloudError, match="larger than"):
        read_garment(path)


def filled(path: Path, text: str, size: int) -> Path:
    path.write_text(text + " " * (size - len(text)))
    return path


def test_the_windows_settings(tmp_path):
    settings = tmp_path / "window.toml"
    assert load_settings(filled(settings, "theme = 'dark'\n", MAX_TOML_BYTES)).theme == "dark"
    with pytest.raises(CloudError, match="larger than"):
        load_settings(filled(settings, "theme = 'dark'\n", MAX_TOML_BYTES + 1))
