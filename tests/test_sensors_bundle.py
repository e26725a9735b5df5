"""Calibration: the hole plate is found to a fraction of a pixel, and one adjustment gives the rig back."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sensors.calibrate import bundle
from sensors.calibrate.bundle import LEAST_VIEWS, Adjusted, adjust
from sensors.calibrate.hole_plate import HolePlate, find_holes
from sensors.calibrate.plate_view import PlateView
from sensors.calibrate.verdict import judge
from sensors.calibration_files.calibration_yaml import FILES, open_calibration, read_yaml, write_yaml
from sensors.errors import CalibrationError
from sensors.recording.rig_templates import REFERENCE, TEMPLATES
from sensors.rig.camera import Intrinsics, project
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.writer import SessionWriter
from synth.rig.plate_views import PlateViews
from tests.conftest import assert_refused

PLATE = HolePlate()
RIG = RigCalibration(
    Intrinsics(512, 424, 365.2, 365.2, 254.0, 211.1, 0.092, -0.267, 0.0, 0.0, 0.09),
    Intrinsics(960, 540, 540.7, 540.7, 479.5, 269.5, 0.056, -0.074, 0.0014, -0.0017, 0.024),
    Pose(Rotation.from_rotvec([0.002, 0.011, 0.017]).as_matrix(), np.array([-0.052, 0.0, 0.001])),
    Intrinsics(160, 120, 110.1, 110.1, 80.3, 59.2, -0.19, 0.04),
    Pose(Rotation.from_rotvec([-0.035, 0.0, 0.0]).as_matrix(), np.array([0.012, 0.06, -0.01])),
)


def exact_views(count: int, seed: int, noise_px: float = 0.0) -> list[PlateView]:
    """Views as perfect images would give them, from the cameras' projection alone (holes are points)."""
    rng = np.random.default_rng(seed)
    board = np.c_[PLATE.centers_m, np.zeros(len(PLATE.centers_m))]
    views = []
    for index in range(count):
        turn = Rotation.from_euler("xyz", rng.uniform(-30, 30, 3), degrees=True).as_matrix()
        z = rng.uniform(0.75, 1.15)
        middle = np.array([*PLATE.size_m.mean(axis=0), 0.0])
        pose = Pose(
            turn, np.array([rng.uniform(-0.2, 0.2) * z, rng.uniform(-0.15, 0.15) * z, z]) - turn @ middle
        )
        points = pose.apply(board)
        centers = {
            "depth": project(RIG.depth, points),
            "color": project(RIG.color, RIG.color_from_depth.apply(points)),
            "thermal": project(RIG.thermal, RIG.thermal_from_depth.apply(points)),
        }
        centers = {name: px + rng.normal(0, noise_px, px.shape) for name, px in centers.items()}
        mm = 1000 * points[:, 2] + 5.0
        views.append(PlateView(index, centers, project(RIG.depth, points), mm))
    return views


POINTLIKE = replace(PLATE, hole_m=1e-6)


def test_exact_views_give_the_rig_back():
    found = adjust(exact_views(12, 1), POINTLIKE, RIG)
    for name in ("color", "thermal"):
        said, true = (getattr(c, f"{name}_from_depth") for c in (found.calibration, RIG))
        np.testing.assert_allclose(said.rotation, true.rotation, atol=2e-4)
        np.testing.assert_allclose(said.translation_m, true.translation_m, atol=3e-4)
    assert found.calibration.depth_shift_mm == pytest.approx(-5.0, abs=0.3)
    assert found.left_out == ()
    assert max(seen.rms_px for seen in found.residuals.values()) < 0.01


def test_a_slipped_plate_is_left_out():
    views = exact_views(14, 2, noise_px=0.03)
    for bad in (3, 8):
        views[bad].centers_px["thermal"] += (1.5, -0.8)
    assert adjust(views, POINTLIKE, RIG).left_out == (3, 8)


def test_too_few_views_are_refused():
    with pytest.raises(CalibrationError, match=f"at least {LEAST_VIEWS}"):
        adjust(exact_views(LEAST_VIEWS - 1, 3), POINTLIKE, RIG)
    views = exact_views(LEAST_VIEWS + 2, 3)
    for view in views[:5]:
        del view.centers_px["thermal"]
    with pytest.raises(CalibrationError, match="infrared and thermal"):
        adjust(views, POINTLIKE, RIG)


@pytest.fixture(scope="module")
def shot() -> list[RigFrame]:
    """Twelve rendered frames of the plate."""
    return list(PlateViews(replace(TEMPLATES[REFERENCE], calibration=RIG), 12, 5, bad_share=0.0))


def test_brightness_scale_does_not_matter(shot):
    image = shot[0].infrared.astype(np.float64)
    first = find_holes(image, PLATE)
    second = find_holes(0.01 * image - 40, PLATE)
    np.testing.assert_allclose(first, second, atol=1e-6)
    np.testing.assert_allclose(first, find_holes(image.max() - image, PLATE), atol=0.02)


def test_no_plate_no_holes():
    noise = np.random.default_rng(0).normal(size=(120, 160))
    assert all(find_holes(image, PLATE) is None for image in (0 * noise, np.nan * noise, noise))


@pytest.mark.parametrize(
    "fields",
    [{"rows": 10}, {"columns": 1}, {"hole_m": 0.06}, {"pitch_m": 0.0}, {"pitch_m": np.inf}, {"hole_m": -1.0}],
)
def test_a_plate_that_cannot_be_is_refused(fields):
    with pytest.raises(CalibrationError):
        HolePlate(**fields)


# YAML


def test_yaml_survives(tmp_path):
    write_yaml(tmp_path / "yaml", replace(RIG, depth_shift_mm=-13.4))
    read = open_calibration(tmp_path / "yaml")
    assert (read.depth, read.color, read.thermal) == (RIG.depth, RIG.color, RIG.thermal)
    for name in ("color_from_depth", "thermal_from_depth"):
        np.testing.assert_array_equal(getattr(read, name).rotation, getattr(RIG, name).rotation)
        np.testing.assert_array_equal(getattr(read, name).translation_m, getattr(RIG, name).translation_m)


def test_a_real_device_s_files_are_read(shared_data, tmp_path):
    both = shared_data / "kinect2_calibration"
    rigs = {}
    for unit in ("196605135147", "299150235147"):
        (tmp_path / unit).mkdir()
        for file in both.glob(f"iai_{unit}_*.yaml"):
            (tmp_path / unit / file.name).write_bytes(file.read_bytes())
        rigs[unit] = read_yaml(tmp_path / unit)
    assert [rig.depth_shift_mm for rig in rigs.values()] == pytest.approx([-13.354, 0.0], abs=1e-3)
    rig = rigs["196605135147"]
    assert rig.depth.fx == pytest.approx(366.9475727)
    assert rig.color.shape == (1080, 1920)
    assert rig.color_from_depth.translation_m[0] == pytest.approx(-0.05205, abs=1e-5)
    with pytest.raises(CalibrationError, match="one device"):
        read_yaml(both)


@given(garbage=st.binary(max_size=400), cut=st.integers(0, 600))
@settings(deadline=None, max_examples=60)
def test_a_corrupt_yaml_is_a_calibration_error(tmp_path_factory, garbage, cut):
    folder = tmp_path_factory.getbasetemp() / "yaml"
    write_yaml(folder, RIG)
    file = folder / FILES["depth"]
    whole = file.read_bytes()
    file.write_bytes(whole[:cut] + garbage + whole[cut + len(garbage) :])
    try:
        assert read_yaml(folder).depth.width > 0
    except CalibrationError as error:
        assert "\n" not in str(error)[:-1] or len(str(error)) < 600


def test_a_yaml_of_long_lines_and_other_entries_is_read(tmp_path):
    write_yaml(tmp_path, RIG)
    file = tmp_path / FILES["depth"]
    text = file.read_text().replace("\n       ", " " * 1000).replace("[ ", "[" + " " * 1000)
    others = 'calibration_time: "Thu 01 [ {"\nday: 2024-01-05\nflags: 6\nboard: [ [ 1, 2 ], { a: 3 } ]\n' * 99
    file.write_bytes((text + others).replace("\n", "\r\n").encode())
    assert max(map(len, file.read_text().splitlines())) > 1000
    assert read_yaml(tmp_path).depth == RIG.depth


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a": ' + "[" * 9999, "0 numbers"),
        ("%YAML:1.0\n---\ncameraMatrix: !!opencv-matrix\n rows: 3\n data: [ 1, 2 ]", "no camera"),
        ("%YAML:1.0\n---\ncameraMatrix: !!opencv-matrix\n rows: 3\n data: [ 1, .Nan ]", "cannot be read"),
        ("%YAML:1.0\n---\nimage_width: 1e999", "not finite"),
        ("#" * 1_000_001, "larger than"),
    ],
)
def test_others_are_refused(tmp_path, text, says):
    (tmp_path / FILES["depth"]).write_text(text)
    with pytest.raises(CalibrationError, match=says):
        read_yaml(tmp_path)


# The command


def test_a_recording_gives_holes_to_a_fraction_of_a_pixel_and_the_rig_back(
    annotate_cloud, shot, tmp_path, monkeypatch
):
    """The library and the written file give the verb's solution."""
    solved: list[Adjusted] = []
    monkeypatch.setattr(bundle, "adjust", lambda *given: solved.append(adjust(*given)) or solved[-1])
    with SessionWriter(tmp_path / "board.mcap", RIG, "board") as writer:
        for frame in shot:
            writer.write(frame)
    arguments = ("calibrate", tmp_path / "board.mcap", "--out", tmp_path / "rig.json")
    done = annotate_cloud(*arguments, "--yaml", tmp_path / "yaml", "--json")
    assert done.code == 0, done.err
    (found,) = solved
    assert len(shot) - len(set(found.residuals["thermal"].view)) <= 3
    assert found.residuals["depth"].rms_px < 0.06
    assert found.residuals["color"].rms_px < 0.06
    assert found.residuals["thermal"].rms_px < 0.08
    for name in ("color", "thermal"):
        said, true = (getattr(c, f"{name}_from_depth") for c in (found.calibration, RIG))
        turn = Rotation.from_matrix(said.rotation @ true.rotation.T).magnitude()
        assert np.degrees(turn) < 0.2
        assert 1000 * np.abs(said.translation_m - true.translation_m).max() < 3
    good, findings = judge(found)
    assert all("%" in f.text for f in findings if f.remedy) or not good
    assert done.result["good"] == good
    assert {"reprojection_px", "rotation_deg_sd", "translation_mm_sd"} <= set(done.result)
    written = open_calibration(tmp_path / "rig.json")
    off_m = written.thermal_from_depth.translation_m - RIG.thermal_from_depth.translation_m
    assert 1000 * np.abs(off_m).max() < 4
    assert read_yaml(tmp_path / "yaml").depth == written.depth
    assert cv2.imread(str(tmp_path / "rig.png")) is not None
    assert json.loads((tmp_path / "rig.json").read_text())
    assert_refused(annotate_cloud(*arguments), "already exists")
