"""The pyrometer corrects the thermal camera's drift: told from a scene that moves, or not at all."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from annotate.live.drift_watch import DriftWatch
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.rig.thermal_reference import LEAST_READINGS, ThermalReference
from sensors.session.messages import PYROMETER, spot_message
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter

CAMERA = Intrinsics(80, 60, 55.0, 55.0, 39.5, 29.5)
SPOT, RADIUS_PX = (45, 27), 55 / 22 / 2
ROWS, COLUMNS = np.indices(CAMERA.shape)
TIMES_S = np.arange(60) / 2
DRIFT_K = 2 * np.sin(2 * np.pi * TIMES_S / 45)


def scene(number: int, moving: float = 1.0) -> np.ndarray:
    """True temperatures of a cool, uneven room in which a warm blob goes to and fro through the spot."""
    rng = np.random.default_rng(0)
    room = 20 + np.kron(rng.normal(0, 0.5, (6, 8)), np.ones((10, 10)))
    middle = 40 + moving * 12 * np.sin(1.3 * number), 30 + moving * 8 * np.cos(0.7 * number)
    blob = np.hypot(COLUMNS - middle[0], ROWS - middle[1]) < 12 + moving * 3 * np.sin(number)
    return (room + (12 + 0.02 * COLUMNS) * blob).astype(np.float32)


def reading(image: np.ndarray, number: int) -> float:
    at = np.hypot(COLUMNS - SPOT[0], ROWS - SPOT[1]) <= RADIUS_PX
    return float(image[at].mean()) + np.random.default_rng((1, number)).normal(0, 0.05)


def camera_sees(image: np.ndarray, number: int) -> np.ndarray:
    noise = np.random.default_rng((2, number)).normal(0, 0.1, image.shape)
    return (image + noise + DRIFT_K[number]).astype(np.float32)


def referenced(moving: float, read=reading, count=60) -> ThermalReference:
    reference = ThermalReference(CAMERA.fx)
    for number in range(count):
        image = scene(number, moving)
        reference.add(float(TIMES_S[number]), read(image, number), camera_sees(image, number))
    return reference


def test_drift_is_found_from_a_scene_that_moves_without_knowing_the_spot():
    reference = referenced(1.0)
    spot = reference.spot()
    assert spot is not None
    assert np.hypot(*np.subtract(reference.pixel(spot), SPOT)) <= 2
    left = DRIFT_K + reference.offsets_k(spot, TIMES_S)
    assert np.median(np.abs(left)) < 0.15 < 0.5 < np.median(np.abs(DRIFT_K))
    assert np.abs(left).max() < 0.6
    # Long after the last reading: what the last one said.
    late = reference.offsets_k(spot, np.array([TIMES_S[-1] + 600]))
    assert abs(late[0] + DRIFT_K[-1]) < 0.5


@pytest.mark.parametrize(
    "reference",
    [
        lambda: referenced(0.0),
        lambda: referenced(1.0, lambda image, number: 33 + 0.5 * np.sin(number)),
        lambda: referenced(1.0, count=LEAST_READINGS - 1),
        lambda: referenced(1.0, lambda image, number: np.nan),
    ],
    ids=["nothing moves", "it looks elsewhere", "too few readings", "no readings"],
)
def test_what_cannot_be_told_corrects_nothing(reference):
    assert reference().spot() is None


def record(path, readings: bool) -> Session:
    calibration = RigCalibration(CAMERA, thermal=CAMERA, thermal_from_depth=Pose.identity())
    with SessionWriter(path, calibration, "drifting") as writer:
        for number, time_s in enumerate(TIMES_S):
            image, stamp_ns = scene(number), round(time_s * 1e9)
            depth_mm = np.full(CAMERA.shape, 2000, np.uint16)
            if readings:
                spot = spot_message(reading(image, number), np.nan, np.nan, stamp_ns)
                writer.add(PYROMETER, spot, stamp_ns)
            writer.write(RigFrame(number, stamp_ns, depth_mm, None, camera_sees(image, number)))
    return Session(path)


def test_a_session_with_a_pyrometer_gives_corrected_temperatures_and_says_so(tmp_path):
    with_, without = (record(tmp_path / f"{name}.mcap", name == "with") for name in ("with", "without"))
    off = [[float((f.thermal_c - scene(i)).mean()) for i, f in enumerate(s)] for s in (with_, without)]
    assert np.median(np.abs(off[0])) < 0.15 and np.median(np.abs(off[1])) > 0.5
    (said,) = (re.search(r"by (-[12]\.\d) to \+([12]\.\d) K", note) for note in with_.notes if "pyro" in note)
    assert said
    assert without.offsets_k is None and not any("pyrometer" in note for note in without.notes)


def test_a_live_camera_is_corrected_by_the_same_function():
    watch = DriftWatch(RigCalibration(CAMERA, thermal=CAMERA, thermal_from_depth=Pose.identity()))
    off = []
    for number, time_s in enumerate(TIMES_S):
        image = scene(number)
        frame = RigFrame(number, 0, np.ones(CAMERA.shape, np.uint16), None, camera_sees(image, number))
        moment = SimpleNamespace(arrival_ns=round(1e9 * (100 + time_s)), spot_c=reading(image, number))
        off.append(float((watch.corrected(moment, frame).thermal_c - image).mean()))
    assert np.abs(np.subtract(off[:20], DRIFT_K[:20])).max() < 0.01  # not known yet
    assert np.median(np.abs(off[25:])) < 0.3 < np.median(np.abs(DRIFT_K[25:]))


@pytest.mark.parametrize("focal_px", [60.0, 240.0, 408.0, 700.0])
def test_pixels_without_a_temperature_are_left_out_and_touch_no_others(focal_px):
    """Naive means over the known half of each disc; a Boson's disc is 19 pixels wide."""
    rng, reference = np.random.default_rng(3), ThermalReference(focal_px)
    image = rng.normal(25, 2, (160, 200)).astype(np.float32)
    image[rng.random(image.shape) < 0.002] = np.nan
    image[60:90, 80:120] = np.nan
    reference.add(0.0, 30.0, image)
    places = np.array([reference.pixel(at) for at in range(len(reference._places))])
    rows, columns = np.indices(image.shape)
    for at in rng.choice(len(places), 40):
        u, v = places[at]
        disc = image[np.hypot(columns - u, rows - v) <= reference._radius]
        known = disc[np.isfinite(disc)]
        if abs(known.size / disc.size - 0.5) < 0.02:
            continue
        if known.size < disc.size / 2:
            assert np.isnan(reference._off_k[0][at])
        else:
            assert reference._off_k[0][at] == pytest.approx(30.0 - known.mean(), abs=1e-3)
            assert reference._uneven_k[0][at] == pytest.approx(known.std(), abs=5e-2)
