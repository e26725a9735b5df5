"""Bounds of readers: a file at the bound is read, a file beyond it is refused in one line."""

import json
import os

import cv2
import numpy as np
import pytest
from test_synth_garments import write_garment
from test_synth_motion_driven import joint_file, squatting

from annotate.gui.state.keys import MAX_TOML_BYTES, load_settings
from sensors.calibration_files.calibration_yaml import FILES, read_yaml, write_yaml
from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import CloudError, DeviceError, FormatError
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


def test_an_image_file(tmp_path):
    path, depth = tmp_path / "depth.png", np.arange(12, dtype=np.uint16).reshape(3, 4)
    path.write_bytes(bytes(cv2.imencode(".png", depth)[1]))
    os.truncate(path, MAX_IMAGE_BYTES)
    np.testing.assert_array_equal(decode_grey(read_bounded(path), np.uint16, "depth"), depth)
    os.truncate(path, MAX_IMAGE_BYTES + 1)
    with pytest.raises(FormatError, match="larger than"):
        read_bounded(path)


def test_calibration_files_and_settings(tmp_path):
    """Files of text are padded by spaces."""
    rig, lens, folder, theme = (tmp_path / name for name in ("rig.json", "lens.json", "yaml", "window.toml"))
    save_calibration(rig, RIG)
    lens.write_text(json.dumps({"fx": 300, "fy": 300, "cx": 10, "cy": 10, "width": 32, "height": 24}))
    theme.write_text("theme = 'dark'\n")
    folder.mkdir()
    write_yaml(folder, RIG)
    for path, read, bound in (
        (rig, load_calibration, MAX_CALIBRATION_BYTES),
        (lens, read_intrinsics, MAX_CALIBRATION_BYTES),
        (folder / FILES["depth"], lambda path: read_yaml(path.parent), MAX_CALIBRATION_BYTES),
        (theme, load_settings, MAX_TOML_BYTES),
    ):
        text, expected = path.read_text(), read(path)
        path.write_text(text.ljust(bound))
        assert repr(read(path)) == repr(expected)
        path.write_text(text.ljust(bound + 1))
        with pytest.raises(CloudError, match="larger than"):
            read(path)


def test_a_camera_s_latency():
    """A rig file's latency is at most a second; a longer one stated by a recording is ignored."""
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


def test_a_library_of_joint_positions_and_a_garment(tmp_path, monkeypatch):
    library, folder = joint_file(tmp_path / "lib.npz", squatting(30)), tmp_path / "garment"
    folder.mkdir()
    garment = write_garment(folder)
    largest = max(one.stat().st_size for one in folder.iterdir())
    for module, name, bound, read, path in (
        (joint_files, "MAX_BYTES", sum(array_sizes(library, "").values()), read_joint_file, library),
        (makehuman_garments, "MAX_FILE_BYTES", largest, read_garment, garment),
    ):
        monkeypatch.setattr(module, name, bound)
        assert read(path)
        monkeypatch.setattr(module, name, bound - 1)
        with pytest.raises(CloudError, match=r"unpacks to|larger than"):
            read(path)
