"""Foreign files: pipes, devices, impossible numbers, folders; each is refused at once, by its name."""

import json
import os

import cv2
import numpy as np
import pytest
from conftest import assert_refused, tree


@pytest.mark.parametrize("verb", ["info", "validate", "repair", "label --out {out}", "predict --out {out}"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_are_refused_at_once(annotate_cloud, tmp_path, verb, kind):
    path = tmp_path / "x.mcap"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    name, *words = verb.format(out=tmp_path / "out").split()
    assert_refused(annotate_cloud(name, path, *words), f"{path} is a pipe or a device")


@pytest.mark.parametrize(
    ("name", "value"), [("fx", "NaN"), ("fx", "1e999"), ("width", "-5"), ("cy", "-Infinity")]
)
def test_impossible_numbers_are_refused_with_their_file(annotate_cloud, tmp_path, name, value):
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "depth" / "0.png"), np.full((424, 512), 2000, np.uint16))
    numbers = {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 254.0, "cy": 211.0, name: "?"}
    file = tmp_path / "intrinsics.json"
    file.write_text(json.dumps(numbers).replace('"?"', value))
    assert_refused(annotate_cloud("import", tmp_path, tmp_path / "x.mcap"), file)


@pytest.mark.parametrize(
    "command", ["export {labels} {inside} --format coco", "convert {labels} --scheme six --out {inside}"]
)
def test_nothing_is_written_into_the_labels_that_are_read(annotate_cloud, rig_labels, command):
    """``learn`` refuses such a folder too."""
    before = tree(rig_labels.path)
    inside = rig_labels.path / "frames" / "more"
    done = annotate_cloud(*(word.format(labels=rig_labels.path, inside=inside) for word in command.split()))
    assert_refused(done, f"{inside} is inside the input")
    assert tree(rig_labels.path) == before


def test_axes_of_a_recording_without_points_are_refused(annotate_cloud, rig_session, tmp_path):
    refused = annotate_cloud("import", rig_session, tmp_path / "x.mcap", "--axes", "up")
    assert_refused(refused, "is not a cloud of points; leave the axes out (--axes)")


def test_a_folder_in_place_of_a_file_is_named(annotate_cloud, rig_session, rig_labels, tmp_path):
    strip = annotate_cloud("strip", rig_labels.path, tmp_path / "x.mcap", "--colour")
    assert_refused(strip, "is a folder; give a session's file")
    (tmp_path / "out.mcap").mkdir()
    assert_refused(annotate_cloud("simulate", tmp_path / "out.mcap"), "is a folder; give the name of a file")
