"""Bounds of readers that no other test states: an honest file just inside is read, one just beyond is not."""

import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_synth_garments import write_garment
from test_synth_motion_driven import joint_file, squatting

from annotate.gui import memory
from annotate.gui.keys import MAX_TOML_BYTES, load_settings
from annotate.gui.memory import Memory, recall
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.npz import array_sizes
from sensors.files.png import decode_grey
from sensors.importers.ebml import MAX_ELEMENT_BYTES, EbmlFile, Element
from synth.clothes import makehuman_garments
from synth.clothes.makehuman_garments import read_garment
from synth.markers import joint_file as joint_files
from synth.markers.joint_file import read_joint_file
from synth.markers.marker_files import MAX_HEAD_LINES, read_markers
from tests.helpers.marker_samples import positions, write_trc


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


def test_the_windows_settings_and_its_memory(tmp_path):
    settings = tmp_path / "window.toml"
    assert load_settings(filled(settings, "theme = 'dark'\n", MAX_TOML_BYTES)).theme == "dark"
    with pytest.raises(CloudError, match="larger than"):
        load_settings(filled(settings, "theme = 'dark'\n", MAX_TOML_BYTES + 1))
    kept = json.dumps(asdict(Memory()) | {"tool": "brush"})
    assert recall(filled(tmp_path / "window.json", kept, memory.MAX_BYTES)).tool == "brush"
    assert recall(filled(tmp_path / "window.json", kept, memory.MAX_BYTES + 1)) == Memory()
