"""Mirror images and several people: left stays left, and no person wears the markers of another."""

import numpy as np
import pytest

from synth.markers.solve import solve
from synth.motion_files.bvh import read_bvh
from synth.motion_files.marker_files import Markers, read_markers
from synth.motion_files.marker_set import MarkerSet, known_markers
from synth.motion_files.vertical_axis import Upward, feet_ahead, is_mirrored
from tests.helpers.c3d_bytes import C3d
from tests.helpers.marker_truth import plug_in_gait, synthesise
from tests.helpers.walker import bvh_of

MIRRORS = {
    "x": np.diag([-1.0, 1, 1]),
    "y": np.diag([1.0, -1, 1]),
    "y and z exchanged": np.eye(3)[[0, 2, 1]],
    "x and y exchanged": np.eye(3)[[1, 0, 2]],
}


def assert_same_person(found: np.ndarray, truth: np.ndarray) -> None:
    """Both recordings (F, M, 3) are one up to a turn and a move: distances and signed volumes agree."""
    for frame, true in zip(found, truth, strict=True):
        a, b = frame - frame.mean(axis=0), true - true.mean(axis=0)
        left, _, right = np.linalg.svd(a.T @ b)
        turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
        np.testing.assert_allclose(a @ turn, b, atol=2e-4)


@pytest.mark.parametrize("mirror", MIRRORS)
def test_a_mirrored_c3d_is_mirrored_back(tmp_path, mirror):
    truth = synthesise(3, 20).static.positions
    path = C3d(truth @ MIRRORS[mirror].T, list(plug_in_gait().names)).write(tmp_path / "a.c3d")
    known = known_markers(read_markers(path), plug_in_gait())
    assert_same_person(known.positions_m, truth / 1000)
    assert any("mirrored back" in line for line in known.assumed)
    right = known_markers(
        Markers(plug_in_gait().names, truth, 100, "mm", Upward("z", "the test")), plug_in_gait()
    )
    assert not right.assumed
    np.testing.assert_allclose(right.positions_m, truth / 1000)


@pytest.mark.parametrize("doing", ["walks", "lies", "stands"])
def test_the_joints_of_a_mirrored_skeleton_are_mirrored_back_and_solved_as_well(tmp_path, doing):
    (tmp_path / "a.bvh").write_text(bvh_of(doing))
    markers, places = read_bvh(tmp_path / "a.bvh")
    mirrored = Markers(
        markers.labels, markers.positions * [1, 1, -1], markers.frames_per_second, "m", markers.up
    )
    right, back = known_markers(markers, places), known_markers(mirrored, places)
    assert not any("mirrored" in line for line in right.assumed)
    assert any("mirrored back" in line for line in back.assumed)
    assert_same_person(back.positions_m, right.positions_m)
    if doing == "walks":
        motion, truth = solve(mirrored, markerset=places), solve(markers, markerset=places)
        np.testing.assert_allclose(motion.angles_rad[:, 1:], truth.angles_rad[:, 1:], atol=0.03)
        assert motion.report.assumed.count(back.assumed[-1]) == 1


def test_without_feet_nothing_is_mirrored():
    places = plug_in_gait()
    positions = synthesise(3, 5).moving.positions / 1000
    positions[:, [name[1:] in ("TOE", "HEE") for name in places.names]] = np.nan
    assert not np.isfinite(feet_ahead(positions, places.joint, places.at_m)).any()
    assert not is_mirrored(positions * [-1, 1, 1], places.joint, places.at_m)


def of_two(labels: list[str], columns: list[np.ndarray]) -> tuple[np.ndarray, tuple[str, ...]]:
    recording = Markers(tuple(labels), np.stack(columns, axis=1), 100, "mm", Upward("z", "the test"))
    known = known_markers(recording, plug_in_gait())
    return known.positions_m, known.assumed


def test_of_two_people_all_markers_are_of_the_one_who_is_seen_most():
    names, anna = plug_in_gait().names, synthesise(3, 20).moving.positions
    ben = anna + np.array([1500.0, 300.0, 0.0])
    ben[:5, 4] = np.nan
    anna[:, 7:9] = np.nan
    labels = [f"{who}:{name}" for name in names for who in ("Anna", "Ben")]
    columns = [person[:, i] for i in range(len(names)) for person in (anna, ben)]
    found, said = of_two([*labels, "Wand:LASI"], [*columns, 0 * anna[:, 0]])
    np.testing.assert_allclose(found, ben / 1000)
    assert said[0] == "the file holds 2 people ('Anna', 'Ben'); 'Ben' is used"


def test_of_two_skeletons_in_a_bvh_the_first_is_used_and_the_other_is_named(tmp_path):
    own = bvh_of("walks")
    head, _, motion = own.partition("MOTION")
    other = bvh_of("stands").partition("MOTION")
    first, *rows = motion.partition("0.033333\n")[0], *motion.partition("0.033333\n")[2].splitlines()
    theirs = other[2].partition("0.033333\n")[2].splitlines()
    beside = "\n".join(f"{a} {b}" for a, b in zip(rows, theirs, strict=True))
    both = f"{head}{other[0].replace('HIERARCHY', '')}MOTION{first}0.033333\n{beside}\n"
    for name, text in (("one", own), ("two", both)):
        (tmp_path / f"{name}.bvh").write_text(text)
    (one, _), (two, _) = (read_bvh(tmp_path / f"{name}.bvh") for name in ("one", "two"))
    np.testing.assert_allclose(two.positions, one.positions)
    assert [line for line in two.assumed if line not in one.assumed] == [
        "the file holds 2 people; the first is used"
    ]


def test_of_labels_that_occur_twice_the_one_seen_most_is_used():
    names, truth = list(plug_in_gait().names), synthesise(3, 20).moving.positions
    empty = np.full_like(truth, np.nan)
    columns = [*np.moveaxis(empty[:, :6], 1, 0), *np.moveaxis(truth, 1, 0)]
    found, said = of_two([*names[:6], *names], columns)
    np.testing.assert_allclose(found, truth / 1000)
    assert "6 labels name a marker that another label names" in said[0]


@pytest.mark.parametrize(
    ("unit", "mm"), [("in", 25.4), ("inches", 25.4), ("ft", 304.8), ("dm", 100), ("um", 0.001)]
)
def test_units_that_are_not_metric_or_rare_are_read(unit, mm):
    truth = synthesise(3, 5).moving.positions
    places: MarkerSet = plug_in_gait()
    known = known_markers(Markers(places.names, truth / mm, 100, unit, Upward("z", "the test")), places)
    np.testing.assert_allclose(known.positions_m, truth / 1000)
    assert known.unit == unit and not known.assumed


@pytest.mark.parametrize(("stated", "frames"), [(65535, 70000), (1, 65537)])
def test_frames_beyond_16_bits_are_read(tmp_path, stated, frames):
    some = np.random.default_rng(0).uniform(-900, 900, (1, 3, 3))
    points = np.repeat(some, frames, axis=0)
    path = C3d(
        points, ["a", "b", "c"], header={"last": stated}, parameters=[("POINT", "FRAMES", stated)]
    ).write(tmp_path / "a.c3d")
    markers = read_markers(path)
    assert len(markers.positions) == frames
    np.testing.assert_allclose(markers.positions[-1], some[0], rtol=1e-6)
    assert markers.assumed == (f"frames: the file states {stated}, a count of 16 bits, and holds {frames}",)
