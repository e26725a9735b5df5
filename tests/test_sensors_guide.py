"""Guided calibration: what it asks for can be seen, differs from what was seen, and suffices."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cli.guided
import cli.rig_devices
import sensors.calibrate.guide
from sensors.calibrate.guide import ENOUGH_VIEWS, TILTS, Placement, PlateSetup, guide, is_new, next_placement
from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import CAMERAS, PlateView, view_plate
from sensors.errors import CalibrationError
from sensors.interrupt import Ending
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.recording.rig_templates import REFERENCE, TEMPLATES
from sensors.recording.stream_health import Health
from sensors.rig.camera import project
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter

PLACEMENTS = [Placement(*fields) for fields in product((-1, 0, 1), (-1, 0, 1), TILTS, (False, True))]
RIG = TEMPLATES[REFERENCE].calibration
PLATE = replace(HolePlate(), hole_m=1e-5)
"""Its holes are points, so that their projections are what images show."""
SETUP = replace(PlateSetup.of(RIG, HolePlate()), plate=PLATE)


def view_of(pose: Pose, rig: RigCalibration, plate: HolePlate, index=0, rng=None) -> PlateView:
    """Return a perfect view of the plate, with noise of finding holes and of depth where rng is given."""
    points = pose.apply(np.c_[plate.centers_m, np.zeros(len(plate.centers_m))])
    poses = {"depth": Pose.identity(), "color": rig.color_from_depth, "thermal": rig.thermal_from_depth}
    centers = {name: project(getattr(rig, name), poses[name].apply(points)) for name in CAMERAS}
    depth_mm = 1000 * points[:, 2] - 8
    if rng is not None:
        centers = {name: px + rng.normal(0, 0.03, px.shape) for name, px in centers.items()}
        depth_mm = depth_mm + rng.normal(0, 1.5, len(depth_mm))
    return PlateView(index, centers, centers["depth"], depth_mm)


def by_hand(pose: Pose, plate: HolePlate, rng) -> Pose:
    """Held within some centimetres and degrees of a pose."""
    middle = np.array([*plate.size_m.mean(axis=0), 0.0])
    rotation = pose.rotation @ Rotation.from_rotvec(rng.normal(0, 4, 3), degrees=True).as_matrix()
    return Pose(rotation, pose.apply(middle) + rng.normal(0, 0.02, 3) - rotation @ middle)


@pytest.mark.parametrize("name", TEMPLATES)
def test_every_wish_is_recognised_and_the_reference_rig_sees_all_of_it(name):
    rig, plate = TEMPLATES[name].calibration, TEMPLATES[name].plate
    setup = PlateSetup.of(rig, plate)
    nearest, farthest = TEMPLATES[name].plate_m
    assert nearest - 0.25 < setup.near_m < setup.far_m < farthest + 0.3
    for placement in PLACEMENTS:
        view = view_of(setup.pose(placement), rig, plate)
        assert setup.placement_of(view) == placement
        for camera, px in view.centers_px.items() if name == REFERENCE else ():
            inside = (px > 0) & (px < np.array(getattr(rig, camera).shape[::-1]) - 1)
            assert inside.all(), (placement, camera)


def test_wishes_spread_over_places_tilts_and_distances():
    seen: list[Placement] = []
    for _ in range(18):
        seen.append(next_placement(seen))
    assert len(set(seen)) == 18
    assert {(w.right, w.down) for w in seen[:9]} == set(product((-1, 0, 1), (-1, 0, 1)))
    assert min(sum(w.tilt == tilt for w in seen) for tilt in TILTS) >= 3
    assert sum(w.far for w in seen) == 9
    assert next_placement(seen) == next_placement(seen[::-1])


def test_a_view_is_new_when_all_cameras_see_it_and_it_is_held_otherwise():
    poses = [SETUP.pose(Placement(1, 0, tilt, False)) for tilt in ("left", "right")]
    one, other = (view_of(pose, RIG, PLATE) for pose in poses)
    assert is_new(one, [], SETUP) and is_new(other, [one], SETUP)
    aside = view_of(Pose(poses[0].rotation, poses[0].translation_m + np.array([0.05, 0, 0])), RIG, PLATE)
    assert not is_new(one, [other, one], SETUP) and is_new(aside, [one], SETUP)
    blind = replace(one, centers_px={name: one.centers_px[name] for name in ("depth", "color")})
    assert not is_new(blind, [], SETUP)


@pytest.fixture(scope="module")
def held() -> list[PlateView]:
    """Views of a person who follows the guide before any calibration is solved."""
    rng, seen, views = np.random.default_rng(11), [], []
    for index in range(ENOUGH_VIEWS + 1):
        seen.append(next_placement(seen))
        pose = by_hand(SETUP.pose(seen[-1]), PLATE, rng)
        views.append(view_of(pose, RIG, PLATE, index, rng))
    return views


@pytest.fixture
def late(monkeypatch):
    """Nothing is solved before it could be enough: that takes seconds."""
    monkeypatch.setattr(sensors.calibrate.guide, "LEAST_VIEWS", ENOUGH_VIEWS)


def test_it_is_good_with_few_views_and_then_it_is(held, late):
    assert guide(held[: ENOUGH_VIEWS - 1], SETUP).wanted is not None
    now = guide(held, SETUP)
    assert now.good and now.wanted is None and len(now.seen) == ENOUGH_VIEWS + 1 <= 25
    for name in ("color", "thermal"):
        said, true = (getattr(c, f"{name}_from_depth") for c in (now.found.calibration, RIG))
        off_mm = 1000 * np.abs(said.translation_m - true.translation_m)
        turn = Rotation.from_matrix(said.rotation @ true.rotation.T).magnitude()
        assert np.degrees(turn) < 0.1 and off_mm[:2].max() < 1 and off_mm[2] < 2


def frame(index: int) -> RigFrame:
    depth = np.full(RIG.depth.shape, 900, np.uint16)
    return RigFrame(index, index * 10**9, depth, infrared=depth + np.uint16(index))


def test_cameras_that_no_factory_knows_are_calibrated_too(annotate_cloud, monkeypatch, tmp_path):
    encoded = cv2.imencode(".jpg", np.zeros((*RIG.color.shape, 3), np.uint8))[1].tobytes()
    warm = np.full(RIG.thermal.shape, 30, np.float32)
    with SessionWriter(tmp_path / "board.mcap", RigCalibration(RIG.depth), "board") as writer:
        writer.write(frame(0))
        writer.write(replace(frame(1), color_encoded=encoded, thermal_c=warm))
    asked = []

    def adjust(views, plate, guess):
        asked.append(guess)
        raise CalibrationError("too few")

    monkeypatch.setattr("sensors.calibrate.bundle.adjust", adjust)
    annotate_cloud("calibrate", tmp_path / "board.mcap", "--out", tmp_path / "rig.json")
    (guess,) = asked
    assert guess.depth == RIG.depth
    assert (guess.color.shape, guess.thermal.shape) == (RIG.color.shape, RIG.thermal.shape)


def test_a_frame_that_came_cut_off_is_passed_over(held, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(cli.guided, "view_plate", lambda f, *_: held[f.decode_color() is None])
    broken = replace(frame(0), color_encoded=b"\xff\xd8\xff")
    now = cli.guided.guided(iter([broken, frame(1)]), PLATE, RIG, tmp_path / "guide.png", None)
    assert len(now.seen) == 1 and "cannot be decoded" in capsys.readouterr().err


def test_a_rig_that_shows_no_plate_says_why(capsys):
    depth = np.full((2, 2), 900, np.uint16)

    class Blind(LatestValue):
        waits = 2

        def after(self, seen, timeout_s):
            self.waits -= 1
            return None if self.waits >= 0 else (seen + 1, SyncedFrame(RigFrame(seen, 1, depth), 1, 1))

    silent = Health(away=("kinect2:1",))
    rig = SimpleNamespace(
        name="ward", frames=Blind(), error=None, start=str, close=str, health=lambda: silent
    )
    with pytest.raises(CalibrationError, match="'ward' gives no infrared"):
        list(cli.guided.rig_frames(rig, Ending()))
    assert capsys.readouterr().err.count("kinect2:1 is gone") == 1


def test_only_a_plate_that_is_held_still_is_taken(held, monkeypatch, tmp_path):
    looks = [*np.repeat(np.arange(5), 2).tolist(), 5, 6]
    monkeypatch.setattr(cli.guided, "view_plate", lambda f, *_: held[f.index])
    kept = []
    picture = tmp_path / "guide.png"
    now = cli.guided.guided(map(frame, looks), PLATE, RIG, picture, lambda f: kept.append(f.index))
    assert kept == [0, 1, 2, 3, 4] and len(now.seen) == 5 and now.found is None
    drawn = cv2.imread(str(picture))
    assert drawn.shape[1] == 1024 and len(np.unique(drawn.reshape(-1, 3), axis=0)) > 20


def test_calibrate_live_stops_when_it_is_enough(annotate_cloud, held, late, monkeypatch, tmp_path):
    with SessionWriter(tmp_path / "board.mcap", RIG, "board") as writer:
        for index in range(len(held)):
            writer.write(frame(index))
    monkeypatch.setattr(cli.guided, "view_plate", lambda f, *_: held[f.index])
    args = ("calibrate", tmp_path / "board.mcap", "--out", tmp_path / "rig.json", "--hole-mm", "0.01")
    done = annotate_cloud(*args, "--live", "--json")
    assert done.result["good"] and 12 <= done.result["views"] <= 13, done.err
    assert (
        "now hold the plate" in done.err
        and "the views suffice" in done.err
        and "thermal is within 0.0" in done.err
    )
    assert (tmp_path / "rig.json").is_file() and (tmp_path / "rig.guide.png").is_file()
    few = annotate_cloud(
        "calibrate", tmp_path / "board.mcap", "--out", tmp_path / "r.json", "--rig", "r.toml"
    )
    assert few.code == 2 and "needs --live" in few.err.replace("\n", " ")


def test_virtual_cameras_see_the_plate_and_a_rig_without_views_leaves_no_file(
    annotate_cloud, held, monkeypatch, tmp_path
):
    """The command opens the drivers with their twins; the second run ends before a view is taken."""
    monkeypatch.setattr(cli.rig_devices, "VIRTUAL_VIEWS", 2)
    plate = HolePlate()
    first = cli.rig_devices.Shown(plate)
    shown = tuple(first)
    assert all(view_plate(f, plate, RIG.depth).centers_px.keys() == set(CAMERAS) for f in shown)
    assert [f.stamp_ns for f in shown] == [0, 1e9 * cli.rig_devices.HELD_S]
    for name in ("_rig", "_frames"):
        monkeypatch.setattr(cli.rig_devices.Shown, name, getattr(first, name))
    looked = iter(np.repeat(np.arange(len(held)), 2).tolist())
    monkeypatch.setattr(cli.guided, "view_plate", lambda f, *_: held[next(looked)])
    enough = SimpleNamespace(seen=[SimpleNamespace(text="near")], found=None, wanted=None)
    monkeypatch.setattr(cli.guided, "guide", lambda *_: enough)
    monkeypatch.setattr(cli.guided, "guide_picture", lambda *_: np.zeros((4, 4, 3), np.uint8))
    devices = ("--device", "virtual:kinect2", "--device", "virtual:optris-direct")
    live = ("calibrate", tmp_path / "b.mcap", "--live", *devices, "--out", tmp_path / "rig.json")
    done = annotate_cloud(*live)
    assert done.code == 1 and "1 views of the plate were taken" in done.err, done.err
    taken = Session(tmp_path / "b.mcap").frame(0)
    assert any(np.array_equal(taken.infrared, frame.infrared) for frame in shown)

    def blind(*_):
        raise CalibrationError("gives no infrared")

    monkeypatch.setattr(cli.guided, "guided", blind)
    (tmp_path / "b.mcap").unlink()
    done = annotate_cloud(*live)
    assert done.code == 1 and "gives no infrared" in done.err
    assert not list(tmp_path.glob("b.mcap*"))
