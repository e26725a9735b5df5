"""A user's own depth camera in synthetic images and on the virtual rig."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from annotate.labelset.dataset import Dataset
from cli.main import app
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from sensors.session.reader import Session
from synth.own_camera import OwnCamera, read_own_camera

PINHOLE = Intrinsics(200, 150, 190.0, 191.0, 98.0, 77.0)
NUMBERS = {"width": 200, "height": 150, "fx": 190.0, "fy": 191.0, "cx": 98.0, "cy": 77.0}


@pytest.fixture
def camera(tmp_path):
    """Write a file of the camera with further fields and return its path."""

    def write(**more):
        path = tmp_path / "camera.json"
        path.write_text(json.dumps({**NUMBERS, **more}))
        return path

    return write


def run(*words):
    done = CliRunner().invoke(app, list(map(str, words)))
    if done.exception:
        raise done.exception
    return done


@pytest.mark.parametrize("sensor", [None, "recorded_stereo", "kinect-v1-640", "azure-kinect-wide"])
def test_a_file_gives_pinhole_and_sensor(camera, sensor):
    own = read_own_camera(camera(**({"sensor": sensor} if sensor else {})))
    assert own == OwnCamera(PINHOLE, sensor)
    drawn = [own(np.random.default_rng(seed)) for seed in range(30)]
    assert {one.camera for one in drawn} == {PINHOLE}
    kinds = {one.kind for one in drawn}
    assert len(kinds) > 3 if sensor is None else len(kinds) == 1
    if sensor == "kinect-v1-640":
        assert {one.model for one in drawn} == {sensor}


def test_all_images_are_of_the_camera(camera, tmp_path):
    file = camera(sensor="recorded_stereo", k1=0.1)
    words = ("synth", "generate", "--preset", "people", "--count", 3, "--workers", 1)
    done = run(*words, "--camera", file, "--out", tmp_path / "set")
    assert "camera: 200x150" in done.stderr and "recorded_stereo" in done.stderr
    data = Dataset.open(tmp_path / "set")
    assert data.info["camera"]["sensor"] == "recorded_stereo"
    for notes in (frame.notes for frame in data):
        assert notes["intrinsics"] == list(NUMBERS.values())
        assert notes["sensor"]["kind"] == "recorded stereo"


def test_the_rig_has_the_camera(camera, tmp_path):
    file = camera(sensor="recorded_stereo", k1=0.1)
    run("simulate", tmp_path / "a.mcap", "--frames", 1, "--camera", file, "--difficulty", "clean")
    session = Session(tmp_path / "a.mcap")
    assert session.calibration.depth == Intrinsics(*NUMBERS.values(), 0.1)
    depth_mm = session.frame(0).depth_mm
    assert depth_mm.shape == PINHOLE.shape and (depth_mm > 0).mean() > 0.9


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"sensor": "webcam"}, "sensor 'webcam'; use filtered"),
        ({"sensor": ["stereo"]}, "use filtered"),
        ({"fx": -1}, "focal"),
        ({"width": 4000, "height": 3000, "cx": 2000, "cy": 1500, "fx": 3000, "fy": 3000}, "at most 4000000"),
    ],
)
def test_a_wrong_file_is_refused_in_a_line(camera, tmp_path, fields, words):
    file = camera(**fields)
    for verb in (("synth", "generate", "--preset", "people", "--out"), ("simulate",)):
        with pytest.raises(CloudError, match=words) as refusal:
            run(*verb, tmp_path / "out", "--camera", file)
        assert "\n" not in str(refusal.value)
    assert not (tmp_path / "out").exists()
