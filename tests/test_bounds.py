"""Bounds of readers: a file at the bound is read, a file beyond it is refused in one line."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_synth_garments import write_garment
from test_synth_motion_driven import joint_file, squatting

from annotate.gui.state.keys import MAX_TOML_BYTES, load_settings
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

RIG = RigCalibration(KINECT2_DEPTH)


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
