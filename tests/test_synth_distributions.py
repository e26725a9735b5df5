"""Figures of silhouettes and stances, and distributions of them beside a recording."""

import json

import cv2
import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.errors import CloudError, FormatError
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.images.comparison import charts, profile, ranges
from synth.images.distributions import Distributions, cut_out, distributions_at, figures_of, figures_of_labels
from synth.images.silhouette_statistics import widths
from synth.images.standing_statistics import ankles_m, arms_deg, facing_deg


def disc(size=100, radius=40):
    """A person as round as can be."""
    v, u = np.mgrid[:size, :size] - (size - 1) / 2
    return v**2 + u**2 < radius**2


def standing(turned_deg=0.0, knee_m=0.0, elbow_m=0.0):
    """Joints (J, 3) in millimetres of a person standing 2.5 m in front of a level camera."""
    places = {"pelvis": (0, 0, 0), "neck": (0, 0, 0.5)}
    for side, x in (("left", 1), ("right", -1)):
        places[f"{side}_shoulder"] = (0.2 * x, 0, 0.5)
        places[f"{side}_elbow"] = ((0.2 + elbow_m) * x, 0, 0.2)
        places[f"{side}_hip"] = (0.1 * x, 0, 0)
        places[f"{side}_knee"] = (0.1 * x, -knee_m, -0.4)
        places[f"{side}_ankle"] = (0.1 * x, 0, -0.8)
    joints = np.full((N_JOINTS, 3), 9.0)
    for name, place in places.items():
        joints[JOINT_ID[name]] = place
    turn = np.radians(turned_deg)
    x, y = joints[:, 0] * np.cos(turn) - joints[:, 1] * np.sin(turn), joints[:, 0] * np.sin(turn)
    # The body's front, -y, is towards the camera at 0 degrees.
    return 1000 * np.column_stack([x, -joints[:, 2], 2.5 + y + joints[:, 1] * np.cos(turn)])


def test_widths_leave_gaps_out_and_do_not_depend_on_size():
    person = np.zeros((130, 60), np.bool_)
    person[5:125, 10:20] = person[5:125, 40:50] = True
    np.testing.assert_allclose(widths(person), 20 / 120)
    large, small = (figures_of(cv2.resize(person.astype(np.uint8), None, fx=k, fy=k) > 0) for k in (4, 1))
    np.testing.assert_allclose(large["widths"], small["widths"], atol=0.02)
    assert (large["height_px"], small["height_px"]) == (480, 120)
    cut = figures_of(person[:100])
    assert np.isnan(cut["height_px"]) and np.isnan(cut["widths"]).all() and cut["roughness"] >= 1


@pytest.mark.parametrize("turned", [-120, -30, 0, 45, 170])
def test_stance_and_facing_of_known_joints(turned):
    joints = standing(turned, elbow_m=0.3)
    assert ankles_m(joints) == pytest.approx(0.2)
    np.testing.assert_allclose(arms_deg(joints), 45)
    assert facing_deg(joints) == pytest.approx(-turned, abs=5)
    assert np.isnan(ankles_m(standing(knee_m=0.2))) and np.isnan(facing_deg(np.full((N_JOINTS, 3), np.nan)))


def test_a_person_cut_out_is_told_from_a_room():
    person = np.where(np.pad(disc(), ((50, 0), (100, 100))), np.uint16(2500), np.uint16(0))
    assert cut_out(person)
    assert not cut_out(np.full_like(person, 3000)) and not cut_out(np.where(person > 0, 0, 3000))


def test_a_folder_and_a_label_set_have_the_same_figures(tmp_path):
    folder = tmp_path / "recording"
    (folder / "depth").mkdir(parents=True)
    camera = {name: getattr(KINECT2_PINHOLE, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "intrinsics.json").write_text(json.dumps(camera))
    labels = LabelSet.create(tmp_path / "labels", KINECT2_PINHOLE, {})
    for i in range(3):
        depth = np.zeros(KINECT2_PINHOLE.shape, np.uint16)
        depth[100 : 250 + 10 * i, 200:260] = 2500
        cv2.imwrite(str(folder / "depth" / f"{i}.png"), depth)
        notes = {"joints_mm": standing().tolist()}
        labels.write(
            FrameLabels(f"{i:06d}", depth, np.where(depth > 0, 255, 0).astype(np.uint8), notes=notes)
        )
    recorded, labelled = distributions_at(folder), distributions_at(labels.path)
    assert recorded.frames == labelled.frames == 3 and recorded.name == "recording"
    np.testing.assert_array_equal(recorded.figures["widths"], labelled.figures["widths"])
    np.testing.assert_array_equal(recorded.figures["height_px"][:, 0], [150, 160, 170])
    assert np.isnan(recorded.figures["ankles_m"]).all()
    np.testing.assert_allclose(labelled.figures["ankles_m"], 0.2)


def test_nobody_and_malformed_joints_are_refused(tmp_path):
    empty = FrameLabels("f", np.ones((9, 9), np.uint16), np.zeros((9, 9), np.uint8))
    with pytest.raises(CloudError, match="no person"):
        Distributions.of("x", [figures_of_labels(empty)])
    with pytest.raises(FormatError, match="joints_mm"):
        figures_of_labels(FrameLabels("f", empty.depth_mm, empty.parts, notes={"joints_mm": [1, "x"]}))


def people(spread, shift=0.0):
    """Distributions whose figures are all spread evenly about one."""
    values = np.linspace(1 - spread, 1 + spread, 101)[:, None] + shift
    names = ("holes", "roughness", "height_px", "ankles_m", "facing_deg", "height_cm", "bmi")
    several = {"widths": np.tile(values, 12), "arms_deg": np.tile(values, 2)}
    return Distributions("p", 101, dict.fromkeys(names, values) | several)


def test_a_range_is_inside_where_the_dataset_reaches_further():
    dataset = people(0.5)
    for real, inside in ((people(0.4), True), (people(0.4, 0.3), False), (people(0.9), False), (None, None)):
        rows = ranges(dataset, real) + profile(dataset, real)
        assert len(rows) == 8 + 12 and {row.inside for row in rows} == {inside}
    unknown = Distributions("q", 101, dataset.figures | {"ankles_m": np.full((101, 1), np.nan)})
    assert len(ranges(unknown, dataset)) == 7 and ranges(dataset, unknown)[0].inside is None


def test_charts_share_their_bins_and_their_scale():
    (chart, *_) = charts(people(0.5), people(0.1))
    assert chart.own.shape == chart.real.shape == (len(chart.edges) - 1,)
    assert chart.real.max() == 1 and 0 < chart.own.max() < 1
    assert charts(people(0.0), None)[0].real is None
    two = Distributions("two", 2, {name: values[:2] for name, values in people(0.0).figures.items()})
    assert all(np.isfinite(chart.own).all() for chart in charts(two, None))
