"""Depth, cameras and temperatures are judged by physics: read right, or refused with the remedy."""

import json

import cv2
import numpy as np
import pytest

from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.checks.camera_check import check_camera, check_rig
from sensors.checks.celsius_check import SESSION, judge_celsius
from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import CalibrationError, FormatError
from sensors.importers.open_source import open_source
from sensors.importers.options import ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration


def room_mm(seed: int = 0, near: float = 900, far: float = 4200) -> np.ndarray:
    """A floor that rises to a wall, a person in front, a noise of 3 mm, pixels without a reading; int64."""
    rng = np.random.default_rng(seed)
    depth = np.linspace(far, near, 96)[:, None] + np.linspace(0, 300, 128)[None]
    depth[20:80, 50:75] = (near + far) / 2.5
    depth = np.rint(depth + rng.normal(0, 3, depth.shape)).astype(np.int64)
    depth[rng.random(depth.shape) < 0.05] = 0
    return depth


MIDDLE = np.array([[0, 0, 63.5], [0, 0, 47.5], [0, 0, 0]])
"""Centre of a camera with a room's 128 x 96 pixels."""
ROOMS = [room_mm(seed) for seed in range(3)]


@pytest.mark.parametrize("unit", [0.1, 0.125, 0.2, 0.25, 1.0, 10.0])
def test_a_declared_unit_is_obeyed(unit):
    """A naive multiplication gives the same numbers."""
    samples = [np.clip(room / unit, 0, 65000).astype(np.uint16) for room in ROOMS]
    reading = judge_depth(samples, unit, "x")
    assert reading.unit_mm == unit and not any("doubt" in note for note in reading.notes)
    for sample in samples:
        np.testing.assert_array_equal(reading.to_mm(sample), np.rint(sample * unit).astype(np.uint16))


@pytest.mark.parametrize("unit", [0.1, 0.125, 0.2, 0.25])
def test_an_undeclared_unit_is_refused_and_named(unit):
    """Nothing is near: the message names the right unit, and first if millimetres were written."""
    exact = [np.rint(room / unit).astype(np.uint16) for room in ROOMS]
    noisy = [
        np.where(e > 0, e + np.random.default_rng(1).integers(0, 3, e.shape), 0).astype(np.uint16)
        for e in exact
    ]
    for samples in (exact, noisy):
        with pytest.raises(
            FormatError, match=rf"nothing is nearer .*give the millimetres of a step.* {unit:g} \("
        ):
            judge_depth(samples, None, "x")
    if unit == 0.125:
        players = [
            np.where(room > 0, room * 8 + (np.arange(128) > 60), 0).astype(np.uint16) for room in ROOMS
        ]
        with pytest.raises(FormatError, match=r"0\.125 .*player index"):
            judge_depth(players, None, "x")
    if unit < 0.25:
        with pytest.raises(FormatError, match=rf"intrinsics.json: {unit:g} \("):
            judge_depth(exact, None, "x")


def test_a_kind_of_file_has_a_likely_unit():
    """TUM's lists without a header: 1/5000 m where millimetres are impossible, else millimetres."""
    tum = [(room * 5).astype(np.uint16) for room in ROOMS]
    reading = judge_depth(tum, None, "x", likely_mm=0.2)
    np.testing.assert_array_equal(reading.to_mm(tum[0]), ROOMS[0])
    assert any("0.2 mm a step taken" in note for note in reading.notes)
    assert judge_depth([r.astype(np.uint16) for r in ROOMS], None, "x", likely_mm=0.2).unit_mm == 1


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, ">f4"])
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_floats_are_metres_or_millimetres(dtype, unit):
    rooms = [np.where(room > 0, room / unit, np.nan).astype(dtype) for room in ROOMS]
    rooms[0][0, :4] = np.inf, -1, 0, np.nan
    reading = judge_depth(rooms, None, "x")
    assert reading.unit_mm == unit
    error = reading.to_mm(rooms[1]).astype(int) - ROOMS[1]
    assert np.abs(error).max() <= (2 if dtype is np.float16 else 0)
    assert not reading.to_mm(rooms[0])[0, :4].any()


@pytest.mark.parametrize("declared", [None, 1.0])
def test_swapped_bytes_are_read_the_other_way_round(declared):
    swapped = [room.astype(np.uint16).byteswap() for room in ROOMS]
    reading = judge_depth(swapped, declared, "x")
    np.testing.assert_array_equal(reading.to_mm(swapped[0]), ROOMS[0])
    assert any("swapped" in note for note in reading.notes)


CODES = [
    *((code, np.uint16, 1500) for code in (2047, 4095, 8191, 16383, 32767, 65535, 10000)),
    *((code, np.int32, 1500) for code in (65535, 65536, -1)),
    (-1, np.int64, 1500),
    *((code, np.uint16, 4200) for code in (10000, 8000, 65534)),
    (8191, np.uint16, 7400),
    *((code, np.float32, 4200) for code in (10.0, 100.0, 1000.0, 65.535)),
]
"""Largest words, round values, and in floats far planes and 65535 / 1000; the scene's farthest millimetre."""


@pytest.mark.parametrize(("code", "dtype", "far"), CODES)
def test_codes_that_stand_apart_mean_no_reading(code, dtype, far):
    near = 500 if far < 2000 else 900
    rooms = [room_mm(seed, near, far) for seed in range(3)]
    step = 1000 if dtype is np.float32 else 1
    coded = [np.where(room == 0, code, room / step).astype(dtype) for room in rooms]
    reading = judge_depth(coded, None, "x")
    assert not any("doubtful" in note for note in reading.notes)
    if code in reading.invalid and code < 65534:
        assert any(f"depth of {code:g} means no reading" in note for note in reading.notes)
    for sample, room in zip(coded, rooms, strict=True):
        np.testing.assert_allclose(reading.to_mm(sample), room, atol=int(step > 1))


def test_a_wall_at_a_code_s_or_a_round_distance_is_a_wall():
    """Noise spreads a wall's readings, and a clipped image's end in one value without a gap."""
    rng = np.random.default_rng(0)
    flat = np.full((96, 128), 4095, np.uint16)
    walls = [np.where(room > 3000, rng.normal(5000, 4, room.shape), room).astype(np.uint16) for room in ROOMS]
    clipped = [np.minimum(room_mm(seed, far=6000), 5000).astype(np.uint16) for seed in range(3)]
    noisy = np.rint(rng.normal(4095, 4, (96, 128))).astype(np.uint16)
    for samples in ([noisy], [flat], walls, clipped):
        np.testing.assert_array_equal(judge_depth(samples, None, "x").to_mm(samples[0]), samples[0])


def test_honest_scenes_pass():
    """A street of 20 m with a declared unit, a close-up of 0.1 mm, a person cut out, an empty image."""
    street = [room_mm(seed, 6000, 40000).astype(np.uint16) for seed in range(2)]
    reading = judge_depth(street, 1.0, "x")
    assert any("doubtful" in note for note in reading.notes)
    np.testing.assert_array_equal(reading.to_mm(street[0]), street[0])
    with pytest.raises(FormatError, match="nothing is nearer"):
        judge_depth(street, None, "x")
    close = [(room_mm(1, 80, 300) * 10).astype(np.uint16)]
    np.testing.assert_array_equal(judge_depth(close, 0.1, "x").to_mm(close[0]), room_mm(1, 80, 300))
    cut_out = np.where(np.arange(128) % 64 < 20, room_mm(0, 4000, 4400), 0).astype(np.uint16)
    assert judge_depth([cut_out], None, "x").unit_mm == 1
    assert judge_depth([np.zeros((96, 128), np.uint16)], None, "x").range_m is None
    assert judge_depth([], None, "x").unit_mm == 1


def test_what_is_no_depth_is_refused():
    disparity = [(60000 / np.maximum(room, 600)).astype(np.float32) for room in ROOMS]
    kelvin = np.random.default_rng(0).normal(29600, 200, (96, 128)).astype(np.uint16)
    inches = [(room / 25.4).astype(np.uint16) for room in ROOMS]
    for samples in (disparity, [kelvin], inches, [ROOMS[0].astype(np.uint8)]):
        with pytest.raises(FormatError, match="give the millimetres of a step") as error:
            judge_depth(samples, None, "here")
        assert str(error.value).startswith("here: ") and "\n" not in str(error.value)
    with pytest.raises(FormatError, match="depth has no reading within 65 m"):
        judge_depth([r.astype(np.uint16) for r in ROOMS], 1000.0, "x")
    noise = np.random.default_rng(0).integers(500, 4000, (96, 128), np.uint16)
    assert any("neighbouring pixels" in note for note in judge_depth([noise], None, "x").notes)


def test_rooms_upside_down_and_disparity_are_doubtful():
    """The floor in front is nearer than the wall behind it; a flat wall tells nothing."""
    upright = [room.astype(np.uint16) for room in ROOMS]
    turned = [image[::-1, ::-1] for image in upright]
    disparity = [np.where(image > 0, 6e6 / np.maximum(image, 1), 0).astype(np.uint16) for image in upright]
    wall = [np.random.default_rng(n).normal(2500, 300, (96, 128)).astype(np.uint16) for n in range(2)]
    for samples, doubted in (
        *((upright, False), (turned, True), (disparity, True), (wall, False)),
        ([turned[0], upright[0]], False),
    ):
        assert any("turn them by 180" in note for note in judge_depth(samples, None, "x").notes) == doubted


def test_a_declared_turn_ends_the_doubt(tmp_path):
    np.savez(
        tmp_path / "x.npz",
        depth=np.stack(ROOMS)[:, ::-1].astype(np.uint16),
        K=np.diag([100.0, 100, 1]) + MIDDLE,
    )
    assert any("turn them by 180" in note for note in open_source(tmp_path / "x.npz").notes)
    assert not any(
        "turn them" in note for note in open_source(tmp_path / "x.npz", ImportOptions(turn_deg=180)).notes
    )


def test_somebody_cut_out_is_no_wall():
    """Masked recordings (NTU RGB+D, UTD-MHAD) hold a person alone, 20 cm deep."""
    cut = np.zeros((96, 128), np.uint16)
    cut[20:80, 50:75] = np.random.default_rng(0).normal(2200, 60, (60, 25))
    assert not any("wall" in note for note in judge_depth([cut], None, "x").notes)
    assert any("wall" in note for note in judge_depth([cut[20:80, 50:75]], None, "x").notes)


def test_frames_are_spread():
    assert spread(10_000) == [0, 2500, 5000, 7499, 9999] and spread(0) == [] and spread(2) == [0, 1]


def test_real_recordings_pass(shared_data):
    for folder in ("rgbd/sofa", "rgbd/upper_body", "rgbd/nobody", "real_people/frames"):
        files = sorted((shared_data / folder / "depth").glob("*.png"))
        samples = [cv2.imread(str(files[at]), cv2.IMREAD_UNCHANGED) for at in spread(len(files))]
        reading = judge_depth(samples, None, folder)
        assert reading.unit_mm == 1 and len(reading.notes) == 1, reading.notes
        for sample in samples:
            np.testing.assert_array_equal(reading.to_mm(sample), sample)
        assert judge_depth([sample.byteswap() for sample in samples], None, folder).swapped
        if folder != "rgbd/nobody":  # its nearest shoe is 0.3 m away
            with pytest.raises(FormatError, match=r"0\.2 \("):
                judge_depth([(sample * 5.0).astype(np.uint16) for sample in samples], None, folder)
        check_camera(Intrinsics(**json.loads((shared_data / folder / "intrinsics.json").read_text())), folder)


# Cameras

HONEST = [
    Intrinsics(512, 424, 365.1, 365.1, 254.0, 211.1, 0.09, -0.27, 0.0, 0.0, 0.09),  # Kinect v2
    Intrinsics(512, 512, 252.0, 252.0, 256.0, 256.0),  # Azure Kinect, wide
    Intrinsics(382, 288, 3700.0, 3700.0, 190.0, 140.0),  # thermal, 6 degrees
    Intrinsics(640, 480, 617.2, 617.5, 317.4, 246.0),
    Intrinsics(212, 212, 365.0, 365.0, -140.0, 90.0),  # cropped from the side
    Intrinsics(640, 240, 570.0, 285.0, 320.0, 120.0),  # lines left out
    Intrinsics(1280, 720, 640.0, 640.0, 640.0, 360.0, -0.32, 0.11, 0.0, 0.0, -0.02),  # wide colour
]


@pytest.mark.parametrize("camera", HONEST)
def test_honest_cameras_pass(camera):
    assert check_camera(camera, "x") is camera
    check_rig(RigCalibration(KINECT2_DEPTH), "x")


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"fx": 0.49, "fy": 0.65}, "focal length fx 0.49 px .* degrees"),
        ({"fx": 3.67, "fy": 3.67}, "focal length"),
        ({"fx": 365_000.0, "fy": 365_000.0}, "focal length"),
        ({"fx": 80.0, "fy": 600.0}, "differ"),
        ({"cx": 5000.0}, "centre cx 5000"),
        ({"cy": -2000.0}, "centre cy"),
        ({"k1": 90.0, "k2": -270.0, "k3": 90.0}, "lens coefficients .* no inverse"),
        ({"k1": -60.0}, "lens"),
        ({"k1": 60.0}, "lens"),
        ({"p1": 40.0}, "lens"),
    ],
)
def test_cameras_that_none_is_are_refused(wrong, match):
    fields = {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 254.0, "cy": 211.0, **wrong}
    with pytest.raises(CalibrationError, match=match):
        check_camera(Intrinsics(**fields), "x")


# Temperatures


@pytest.mark.parametrize(
    ("step", "offset"),
    [
        (0.01, -100.0),
        (0.01, -273.15),
        (0.1, -273.15),
        (1.0, -273.15),
        (1 / 64, -273.15),
        (0.01, 0.0),
    ],
)
@pytest.mark.parametrize(("coldest", "warmest"), [(18, 36), (3, 34), (24, 40)])
def test_scales_of_temperatures(step, offset, coldest, warmest):
    celsius = np.random.default_rng(0).uniform(coldest, warmest, (48, 64))
    words = np.rint((celsius - offset) / step).astype(np.uint16)
    words[0, :2] = 0, 65535
    scale, notes = judge_celsius([words], "x")
    found = scale.celsius(words)
    assert np.isnan(found[0, :2]).all()
    np.testing.assert_allclose(found.ravel()[2:], celsius.ravel()[2:], atol=step / 2 + 1e-4)
    assert bool(notes) == (scale is not SESSION)


def test_floats_are_celsius_or_kelvin():
    celsius = np.random.default_rng(0).uniform(18, 36, (48, 64)).astype(np.float32)
    for image in (celsius, celsius + np.float32(273.15)):
        scale, _ = judge_celsius([image], "x")
        np.testing.assert_allclose(scale.celsius(image), celsius, atol=1e-3)


def test_counts_are_refused():
    for low, high in ((20000, 24000), (500, 900), (40000, 60000), (4000, 6000)):
        counts = np.random.default_rng(0).integers(low, high, (48, 64)).astype(np.uint16)
        with pytest.raises(FormatError, match="raw counts"):
            judge_celsius([counts], "x")
    cold = np.full((48, 64), 8200, np.uint16)
    assert any("doubtful" in note for note in judge_celsius([cold], "x")[1])
    assert judge_celsius([np.zeros((4, 4), np.uint16)], "x") == (SESSION, ())


@pytest.mark.parametrize(("near", "far"), [(1000, 13500), (100, 350)])
def test_what_is_far_or_close_is_doubtful_where_the_unit_is_assumed(near, far):
    scene = [room_mm(seed, near, far).astype(np.uint16) for seed in range(2)]
    for unit, doubted in ((None, True), (1.0, False)):
        notes = judge_depth(scene, unit, "x").notes
        assert any(note.startswith("doubtful depth: ") for note in notes) == doubted
