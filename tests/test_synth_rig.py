"""The virtual rig is deterministic, its truth is true, and its cameras agree on what they see."""

import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.labelset.label_set import LabelSet, validate
from annotate.parts import UNDEFINED
from annotate.scheme.regions import N_REGIONS
from annotate.suit.palette import DEFAULT_SUIT, chromaticity
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import CloudError
from sensors.recording.rig_templates import REFERENCE, TEMPLATES
from sensors.rig.camera import project
from sensors.rig.frame import RigFrame
from sensors.session.reader import Session
from synth.cameras.sensor import Reading
from synth.cameras.time_of_flight import TimeOfFlight
from synth.rig.difficulty import DIFFICULTIES
from synth.rig.simulate import simulate, suit_path, truth_path
from synth.rig.truth import FLYING_MM, Truth, truth_labels, whose_readings
from synth.rig.virtual_rig import FLAG_CLOSED, RigOptions, VirtualRig
from synth.surface.furniture import Surface
from synth.surface.rasterize import ZBuffer

RIG_CALIBRATION = TEMPLATES[REFERENCE].calibration
FLAG_SEED = 21
"""The flag of this normal rig closes over its second frame."""


def rig_of(difficulty: str) -> VirtualRig:
    """Return a rig of two subjects; only tests of the clean rig read colour, so the other rigs are drafts."""
    return VirtualRig(2, 2, difficulty, 11, RigOptions(draft=difficulty != "clean"))


@pytest.fixture(scope="module")
def shot() -> dict[str, list[tuple[RigFrame, Truth]]]:
    """One frame of each of two subjects, at every difficulty."""
    return {name: list(rig_of(name).with_truth()) for name in DIFFICULTIES}


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(shot, rig_session):
    for (a, known_a), (b, known_b) in zip(rig_of("normal").with_truth(), shot["normal"], strict=True):
        assert (a.index, a.stamp_ns, a.color_encoded) == (b.index, b.stamp_ns, b.color_encoded)
        np.testing.assert_array_equal(a.depth_mm, b.depth_mm)
        np.testing.assert_array_equal(a.thermal_c, b.thermal_c)
        np.testing.assert_array_equal(known_a.regions, known_b.regions)
        np.testing.assert_array_equal(known_a.joints_m, known_b.joints_m)
    assert not np.array_equal(Session(rig_session).frame(0).depth_mm, shot["clean"][0][0].depth_mm)


def test_truth_has_parts_only_where_there_is_depth_and_is_undefined_only_with_noise(shot):
    assert not any((known.regions == UNDEFINED).any() for _, known in shot["clean"])
    for frames in shot.values():
        for frame, known in frames:
            assert known.regions.shape == frame.depth_mm.shape == KINECT2_DEPTH.shape
            assert not known.regions[frame.depth_mm == 0].any()
            assert ((known.regions <= N_REGIONS) | (known.regions == UNDEFINED)).all()
            labelled = truth_labels(frame, known)
            assert not labelled.parts[labelled.depth_mm == 0].any()


def test_people_are_whole_and_of_human_size(shot):
    camera = RIG_CALIBRATION.depth
    for frames in shot.values():
        for frame, known in frames:
            person = (known.regions > 0) & (known.regions < UNDEFINED)
            assert len(np.unique(known.regions[person])) >= 9
            meters = frame.depth_mm[person] / 1000
            assert 0.2 < (meters**2).sum() / (camera.fx * camera.fy) < 2
            assert 1 < np.median(meters) < 4


def test_the_person_is_within_the_temperature_window_and_little_else_is(shot):
    """Nishi & Miura 2017, section 4.2.1: 25 to 35 degrees Celsius. Away from silhouettes, which mix."""
    for name in ("clean", "normal"):
        fuser = Fuser(rig_of(name).calibration)
        for frame, known in shot[name]:
            labelled = truth_labels(frame, known)
            cloud = fuser.fuse_frame(frame)
            np.testing.assert_array_equal(cloud.depth_mm, labelled.depth_mm)
            person = (labelled.parts > 0) & (labelled.parts < UNDEFINED)
            measured = np.isfinite(cloud.temperature_c)
            warm = (cloud.temperature_c >= 25) & (cloud.temperature_c <= 35)
            assert warm[person & measured].mean() > 0.9
            assert warm[(labelled.parts == 0) & measured].mean() < 0.1


def test_the_colour_camera_sees_the_suit_where_depth_sees_the_part(shot):
    fuser = Fuser(RIG_CALIBRATION)
    for frame, known in shot["clean"]:
        labelled, cloud = truth_labels(frame, known), fuser.fuse_frame(frame)
        for part in range(2, 12):
            seen = (labelled.parts == part) & cloud.color_valid
            if seen.sum() >= 200:
                expected = chromaticity(DEFAULT_SUIT.colors_rgb[DEFAULT_SUIT.parts == part][0])
                actual = np.median(chromaticity(cloud.color_rgb[seen]), axis=0)
                assert np.linalg.norm(actual - expected) < 0.03


def test_joints_lie_in_the_image_near_their_person(shot):
    for frame, known in shot["clean"]:
        v, u = np.nonzero(known.regions)
        pixels = project(KINECT2_DEPTH, known.joints_m)
        low, high = np.array([u.min(), v.min()]) - 60, np.array([u.max(), v.max()]) + 60
        assert ((pixels > low) & (pixels < high)).all()
        assert abs(np.median(known.joints_m[:, 2]) - np.median(frame.depth_mm[v, u]) / 1000) < 0.5


def test_harder_is_noisier(shot):
    roughness_mm = {
        name: np.mean([roughness(f.depth_mm, k.regions) for f, k in frames]) for name, frames in shot.items()
    }
    assert roughness_mm["clean"] < roughness_mm["normal"] < roughness_mm["hard"]


def roughness(depth_mm: np.ndarray, parts: np.ndarray) -> float:
    """Mean second difference along rows within one part, where no edge is: noise, not shape."""
    d = depth_mm.astype(float)
    bend = np.abs(d[:, :-2] - 2 * d[:, 1:-1] + d[:, 2:])
    same = (parts[:, :-2] == parts[:, 1:-1]) & (parts[:, 1:-1] == parts[:, 2:]) & (parts[:, 2:] > 0)
    return float(bend[same & (parts[:, 2:] < UNDEFINED) & (bend < 30)].mean())


@pytest.mark.parametrize(
    ("counts", "difficulty", "options", "says"),
    [
        ((0, 1), "clean", {}, "give a frame or more"),
        ((1, 2), "clean", {}, "give a frame or more"),
        ((1, 1), "easy", {}, "'easy' is unknown; use clean, normal, hard"),
        ((1, 1), "clean", {"scene": "pool"}, "'pool' is unknown; use sofa, chair, bed, floor"),
        ((1, 1), "clean", {"frames_per_second": 0.0}, "give 0.1 to 30"),
    ],
)
def test_impossible_rigs_are_refused(counts, difficulty, options, says):
    with pytest.raises(CloudError, match=says):
        VirtualRig(*counts, difficulty, 0, RigOptions(**options))


def test_what_is_recorded_is_what_was_shot(rig_session):
    rig = VirtualRig(3, 2, "clean", 5)
    session, truth = Session(rig_session), LabelSet.open(truth_path(rig_session))
    assert not session.truncated
    assert (session.name, len(session), truth.frame_ids) == (rig.name, 3, ["000000", "000001", "000002"])
    assert suit_path(rig_session).is_file()
    assert validate(truth) == []
    assert truth.intrinsics == RIG_CALIBRATION.depth.undistorted()
    frame, known = next(rig.with_truth())
    np.testing.assert_array_equal(session.frame(0).depth_mm, frame.depth_mm)
    assert session.frame(0).color_encoded == frame.color_encoded
    np.testing.assert_allclose(session.frame(0).thermal_c, frame.thermal_c, atol=0.01)
    np.testing.assert_array_equal(truth.read("000000").parts, truth_labels(frame, known).parts)
    assert {truth.read(i).status for i in truth.frame_ids} == {"truth"}
    # Of three frames the first of two subjects has two.
    assert [one.subject for one in truth] == ["subject-0", "subject-0", "subject-1"]
    stamps = [one.stamp_ns for one in session]
    assert stamps == sorted(set(stamps)) and [one.index for one in session] == [0, 1, 2]


@pytest.mark.parametrize("scene", ["chair", "bed", "floor"])
def test_every_scene_shows_a_person(scene):
    frame, known = next(VirtualRig(1, 1, "clean", 3, RigOptions(scene, draft=True)).with_truth())
    assert ((known.regions > 0) & (known.regions <= N_REGIONS)).sum() > 3000
    assert set(known.hard) <= {"motion blur", "out of view"}
    assert (frame.depth_mm > 0).mean() > 0.7


def test_persons_are_the_subject_where_parts_are_named_and_others_elsewhere(shot):
    others = 0
    for frame, known in [*shot["hard"], *VirtualRig(1, 1, "hard", 2, RigOptions(draft=True)).with_truth()]:
        labels = truth_labels(frame, known)
        named = (labels.parts > 0) & (labels.parts < UNDEFINED)
        np.testing.assert_array_equal(labels.persons == 1, named)
        assert not labels.persons[labels.depth_mm == 0].any()
        assert labels.notes["hard"] == list(known.hard) != []
        seen = int((labels.persons == 2).sum())
        others += seen
        assert seen == 0 if "second person" not in known.hard else seen > 50
    assert others > 0


def test_time_goes_as_fast_as_asked():
    slow, fast = (
        VirtualRig(2, 1, "clean", 5, RigOptions(frames_per_second=rate, draft=True)) for rate in (2.0, 10.0)
    )
    (_, a), (late, b) = slow.with_truth()
    (first, c), (soon, d) = fast.with_truth()
    assert (first.stamp_ns, late.stamp_ns, soon.stamp_ns) == (0, 500_000_000, 100_000_000)
    np.testing.assert_array_equal(a.joints_m, c.joints_m)
    assert np.abs(d.joints_m - c.joints_m).max() < np.abs(b.joints_m - a.joints_m).max()


def test_a_closed_flag_leaves_no_temperatures_and_an_event(tmp_path):
    path = tmp_path / "flag.mcap"
    simulate(VirtualRig(2, 1, "normal", FLAG_SEED, RigOptions(draft=True)), path, lambda n: None)
    session, truth = Session(path), LabelSet.open(truth_path(path))
    assert [session.frame(i).thermal_c is None for i in range(2)] == [False, True]
    assert session.events == ((500_000_000, FLAG_CLOSED),)
    assert [FLAG_CLOSED in truth.notes(i)["hard"] for i in truth.frame_ids] == [False, True]


def test_a_reading_is_whose_surface_it_lies_on():
    """Against a loop over pixels: a wall, before it a torso whose left half an arm hides, and a visitor."""
    tags = np.array([Surface.WALL, 2, 3, Surface.OTHER_PERSON], np.int32)
    face = np.zeros((8, 12), np.int32)
    face[2:7, 3:6], face[2:7, 6:9], face[:, 11] = 2, 1, 3
    face[0, 0] = -1
    depth_m = np.choose(face + 1, (np.nan, 3.0, 2.0, 1.9, 1.2)).astype(np.float32)
    noise = TimeOfFlight(offset_mm=10.0, scale=1.002)
    rng = np.random.default_rng(0)
    exact = np.nan_to_num(depth_m) * 1002 + 10
    depth_mm = np.maximum(exact + rng.choice((0, 20, -900, 300, -500), face.shape), 0).astype(np.uint16)
    depth_mm[rng.random(face.shape) < 0.1] = 0
    parts, persons, surfaces = whose_readings(ZBuffer(depth_m, face), tags, Reading(depth_mm, face), noise)
    for v, u in np.ndindex(face.shape):
        tag = naive_tag(tags, face, exact, depth_mm, (v, u))
        person = 1 if 0 < tag <= N_REGIONS else 2 * (tag == Surface.OTHER_PERSON)
        part = tag if tag == UNDEFINED or tag <= N_REGIONS else 0
        assert (parts[v, u], persons[v, u]) == (part, person), (v, u)
        assert surfaces[v, u] == (tag if N_REGIONS < tag != UNDEFINED else 0)


def naive_tag(tags, face, exact, depth_mm, pixel):
    """The tag of the surface a reading lies on: 255 for none near it, 0 for no reading."""
    v, u = pixel
    if depth_mm[v, u] == 0:
        return 0
    rows, columns = range(max(v - 1, 0), min(v + 2, 8)), range(max(u - 1, 0), min(u + 2, 12))
    tag = {(y, x): tags[face[y, x]] if face[y, x] >= 0 else 0 for y in rows for x in columns}
    gap = {at: abs(float(depth_mm[v, u]) - exact[at]) for at in tag}
    if gap[v, u] <= FLYING_MM:
        return tag[v, u]
    nearest = min(gap, key=gap.__getitem__)
    return tag[nearest] if gap[nearest] < FLYING_MM else UNDEFINED
