"""Files that are no data: pipes, devices, impossible numbers; each is refused at once, by its name."""

import json
import os

import cv2
import numpy as np
import pytest
from conftest import assert_refused


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
