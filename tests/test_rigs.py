"""Rigs by name: their files fit each other, and their twins' truth is true."""

import json
from contextlib import closing
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from annotate.cloud.fuse import Fuser
from annotate.parts import UNDEFINED
from cli.main import app
from sensors.device.address import KINDS
from sensors.device.mounting import Mounting
from sensors.errors import CloudError
from sensors.recording.open_device import OPENERS, open_device
from sensors.recording.rig_file import load_rig
from sensors.recording.rig_templates import TEMPLATES
from sensors.rig.camera import Intrinsics, project
from sensors.rig.rig_calibration import Pose, RigCalibration
from synth.rig.rig_variants import VARIANTS
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from tests.helpers.swinging_ball import swinging_ball

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("rig", TEMPLATES.values(), ids=str)
def test_every_camera_sees_the_whole_plate_and_its_holes(rig):
    assert rig.name in VARIANTS
    width, height = rig.plate.size_m.T
    corners = np.array([[*xy, 0.0] for xy in product(width - width.mean(), height - height.mean())])
    for distance in rig.plate_m:
        points = corners + np.array([0, 0, distance])
        for name in ("color", "thermal"):
            camera, pose = (getattr(rig.calibration, part) for part in (name, f"{name}_from_depth"))
            px = project(camera, pose.apply(points))
            assert ((px > 0) & (px < (camera.width, camera.height))).all(), name
            assert camera.fx * rig.plate.hole_m / distance > 2
        px = project(rig.calibration.depth, points)
        assert ((px > 0) & (px < (rig.calibration.depth.width, rig.calibration.depth.height))).all()


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_becomes_a_rig_file(tmp_path, name):
    done = CliRunner().invoke(app, ["rig", name, "--out", str(tmp_path / "mine"), "--json"])
    assert json.loads(done.stdout)["rig"].endswith("rig.toml")
    rig = load_rig(tmp_path / "mine" / "rig.toml")
    assert rig.devices == TEMPLATES[name].devices
    assert rig.calibration.thermal == TEMPLATES[name].calibration.thermal
    plate = TEMPLATES[name].plate
    assert (tmp_path / "mine" / "plate.svg").read_text().count("<circle") == plate.rows * plate.columns


def test_rigs_are_listed_and_an_unknown_one_refused():
    assert all(name in CliRunner(env={"COLUMNS": "120"}).invoke(app, ["rig"]).stdout for name in TEMPLATES)
    assert "use kinect2-optris" in str(CliRunner().invoke(app, ["rig", "webcam", "--out", "x"]).exception)


@pytest.mark.parametrize("name", ["d455-lepton", "azure-boson"])
def test_a_twins_cameras_agree_on_the_person(name):
    """Away from silhouettes, which mix, temperatures of the person lie where depth has the person."""
    rig = VirtualRig(1, 1, "normal", 11, RigOptions(rig=name, draft=True))
    ((frame, known),) = rig.with_truth()
    assert frame.depth_mm.shape == rig.calibration.depth.shape
    labels, cloud = (
        truth_labels(frame, known, rig.calibration.depth),
        Fuser(rig.calibration).fuse_frame(frame),
    )
    person, measured = (labels.parts > 0) & (labels.parts < UNDEFINED), np.isfinite(cloud.temperature_c)
    # The thermal camera's drift moves all temperatures alike.
    medians = [np.median(cloud.temperature_c[mask & measured]) for mask in (person, labels.parts == 0)]
    warm = cloud.temperature_c > np.mean(medians)
    assert medians[0] - medians[1] > 5
    assert (person & measured).sum() > 0.7 * person.sum() > 4000
    assert warm[person & measured].mean() > 0.9 > 0.1 > warm[(labels.parts == 0) & measured].mean()


@given(quarters=st.integers(0, 3), mirror=st.booleans())
def test_an_upright_image_shows_the_same_point(quarters, mirror):
    """A point's pixel moves as the image does, and colour sees it where it did."""
    lens = Intrinsics(64, 48, 50.0, 52.0, 30.5, 25.0, 0.1, -0.05, 0.01, -0.02, 0.003)
    turn = np.array([[0.96, -0.28, 0], [0.28, 0.96, 0], [0, 0, 1]])
    factory = RigCalibration(lens, replace(lens, cx=33.0), Pose(turn, np.array([-0.05, 0.01, 0.02])))
    mounting = Mounting(quarters, mirror)
    upright = mounting.calibration(factory)
    point, image = np.array([0.2, -0.15, 1.0]), np.zeros((48, 64), np.uint16)
    seen = point * (-1 if mirror else 1, 1, 1)
    for _ in range(quarters):
        seen = np.array([-seen[1], seen[0], seen[2]])
    u, v = np.rint(project(lens, point)).astype(int)
    image[v, u] = 7
    v, u = np.argwhere(mounting.image(image))[0]
    np.testing.assert_allclose(project(upright.depth, seen), (u, v), atol=0.51)
    before = project(factory.color, factory.color_from_depth.apply(point))
    after = project(upright.color, upright.color_from_depth.apply(seen))
    np.testing.assert_allclose(after, (63 - before[0] if mirror else before[0], before[1]), atol=1e-9)


def test_a_camera_on_its_side_gives_upright_images():
    with closing(open_device("virtual:kinect2?turn=90", swinging_ball())) as device:
        device.start()
        assert device.calibration.depth.shape == (512, 424) and device.address.endswith("turn=90")
        while (reading := device.read(1.0)).stream != "depth":
            pass
        assert reading.value.depth_mm.shape == (512, 424) == reading.value.infrared.shape
    with pytest.raises(CloudError, match="use 0, 90, 180, 270"):
        open_device("virtual:kinect2?turn=45", ())


def test_the_documentation_says_of_every_kind_what_it_was_tested_with():
    lines = (ROOT / "docs" / "devices.md").read_text().splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines]
    told = {row[0].strip("`").split(":")[0]: tuple(row[2:]) for row in rows if len(row) == 4}
    assert set(KINDS) == set(OPENERS)
    assert {kind: told[kind] for kind in KINDS} == {kind: tuple(known) for kind, known in KINDS.items()}
