"""A refinement moves borders and adds; it deletes no sure part."""

from dataclasses import replace

import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, PART_ID
from eval.network.sure_parts import keep_sure_parts

TORSO, LEG = PART_ID["torso"], PART_ID["left_lower_leg"]


def frame(leg_rows: int, sure: float) -> FrameLabels:
    """A torso of 100 rows and a leg below it, 20 pixels wide."""
    parts = np.zeros((200, 40), np.uint8)
    parts[:100, :20], parts[100 : 100 + leg_rows, :20] = TORSO, LEG
    confidence = np.where(parts == LEG, np.float32(sure), np.float32(0.9)) * (parts != BACKGROUND)
    depth_mm = np.full(parts.shape, 2000, np.uint16)
    persons = (parts != BACKGROUND).astype(np.uint8)
    return FrameLabels("f", depth_mm, parts, confidence.astype(np.float32), persons=persons)


def without(first: FrameLabels, rows: slice) -> FrameLabels:
    """First labels of which a refinement deleted some rows."""
    parts, confidence, persons = (np.copy(a) for a in (first.parts, first.confidence, first.persons))
    for array in (parts, confidence, persons):
        array[rows] = 0
    return replace(first, parts=parts, confidence=confidence, persons=persons)


@pytest.mark.parametrize("rows", [21, 60])
def test_a_sure_part_that_a_refinement_deletes_stays(rows):
    first = frame(rows, 0.8)
    kept = keep_sure_parts(first, without(first, slice(100, 100 + rows)))
    for name in ("parts", "confidence", "persons"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(first, name))


@pytest.mark.parametrize(
    ("first", "rows"),
    [
        pytest.param(frame(60, 0.4), slice(100, 160), id="unsure"),
        pytest.param(frame(60, 0.8), slice(130, 160), id="border moved by half of it"),
        pytest.param(frame(1, 0.8), slice(100, 101), id="less than a hundredth"),
    ],
)
def test_a_refinement_moves_borders_and_deletes_what_is_unsure(first, rows):
    refined = without(first, rows)
    np.testing.assert_array_equal(keep_sure_parts(first, refined).parts, refined.parts)


def test_other_people_and_other_parts_stay_as_refined():
    first = frame(60, 0.8)
    refined = without(first, slice(100, 160))
    refined.parts[100:160, 30:] = LEG
    first.persons[100:160, :20] = 2
    np.testing.assert_array_equal(keep_sure_parts(first, refined).parts, refined.parts)
