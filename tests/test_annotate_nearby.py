"""Corrections carry over within one person and a reach, and their sources are named."""

from dataclasses import replace

import numpy as np
import pytest

from annotate.correction.correction import Correction
from annotate.correction.nearby import REACH_FRAMES, corrected_nearby, frames_text
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID, swap_left_right
from bench.window import figure
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from tests.helpers.gui_driver import Driver

TORSO, HIP = PART_ID["torso"], PART_ID["hip"]
SHAPE = (106, 128)


def made(path, count: int, change: int, near_m: float = 0.0, names: bool = False) -> LabelSet:
    """Frames of a figure, and from one on of another: beside it, nearer by metres, or by another name."""
    labels = LabelSet.create(path, Intrinsics(SHAPE[1], SHAPE[0], 92.0, 92.0, 64.0, 53.0), {})
    for i in range(count):
        later = i >= change
        depth, parts = figure(*SHAPE, 0.002 * i + (0.3 if later and not near_m and not names else 0.0))
        depth = np.where(parts > 0, depth - round(1000 * near_m) * later, depth).astype(np.uint16)
        subject = ("anna" if later else "ben") if names else ""
        labels.write(FrameLabels(f"{i:06d}", depth, parts, notes={"confidence": 0.9}, subject=subject))
    return labels


def corrected(correction: Correction, *frames: int) -> None:
    for frame in frames:
        editor = correction.edit(f"{frame:06d}")
        editor.paint(editor.parts == TORSO, HIP)
        editor.judge("accept")


@pytest.mark.parametrize("how", [{}, {"near_m": 0.6}, {"names": True}])
def test_nothing_comes_from_another_person(tmp_path, how):
    labels = made(tmp_path / "labels", 10, 5, **how)
    with Correction.open(labels.path, "ann") as correction:
        corrected(correction, 1, 3, 7)
        assert corrected_nearby(correction, "000004") == ["000003", "000001"]
        assert corrected_nearby(correction, "000006") == ["000007"]
        assert corrected_nearby(correction, "000003") == ["000001"]


def test_nor_from_farther_than_the_reach(tmp_path):
    labels = made(tmp_path / "labels", REACH_FRAMES + 3, 99)
    with Correction.open(labels.path, "ann") as correction:
        corrected(correction, 0)
        assert corrected_nearby(correction, f"{REACH_FRAMES:06d}") == ["000000"]
        with pytest.raises(CloudError, match=f"within {REACH_FRAMES} frames"):
            corrected_nearby(correction, f"{REACH_FRAMES + 1:06d}")


def test_nor_from_rejected_frames_nor_past_a_broken_one(tmp_path):
    labels = made(tmp_path / "labels", 6, 99)
    with Correction.open(labels.path, "ann") as correction:
        corrected(correction, 0, 5)
        correction.edit("000004").judge("reject", "blurred")
        correction.edit("000003")
        assert corrected_nearby(correction, "000003") == ["000005", "000000"]
        (labels.path / "frames" / "000002.parts.png").write_bytes(b"broken")
        assert corrected_nearby(correction, "000003") == ["000005"]


def test_swapped_sides_are_no_other_person(tmp_path):
    labels = made(tmp_path / "labels", 3, 99)
    frame = labels.read("000001")
    labels.write_labels(replace(frame, parts=swap_left_right(frame.parts)))
    with Correction.open(labels.path, "ann") as correction:
        corrected(correction, 0)
        assert corrected_nearby(correction, "000002") == ["000000"]


def test_frames_in_words():
    assert frames_text(["000012"]) == "frame 12"
    assert frames_text(["000013", "000000", "000012"]) == "frames 0, 12, 13"


@pytest.mark.parametrize("automatic", [False, True])
def test_the_window_carries_over_within_a_person_and_names_the_frames(qapp, tmp_path, automatic):
    """By the key, and in each frame that accepting opens."""
    labels = made(tmp_path / "labels", 6, 4)
    with Correction.open(labels.path, "mia") as correction:
        corrected(correction, 0, 1)
    driver = Driver(labels.path)
    assert int(driver.window.frame_id) == 2
    driver.key("propagate")
    if automatic:
        driver.key("carry")
        driver.key("accept")
    sources = "0, 1, 2" if automatic else "0, 1"
    assert f"Carried over from frames {sources}: " in driver.said
    assert not (driver.parts == TORSO).any() and (driver.parts == HIP).any()
    driver.window.open_frame("000004")
    driver.settle()
    before = driver.parts.copy()
    driver.key("propagate")
    np.testing.assert_array_equal(driver.parts, before)
    assert driver.said.startswith("Nothing to carry over")
    driver.close()
