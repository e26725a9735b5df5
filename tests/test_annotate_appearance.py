"""What was corrected is known again by its colour and warmth, and what was not seen is left alone."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.appearance import Appearance
from annotate.correction.propagate import CorrectedFrame, propagate
from annotate.frame_labels import FrameLabels
from sensors.rig.camera import unproject
from tests.helpers.balls import CAMERA, seen

law = settings(deadline=None, max_examples=12)

COLORS = np.zeros((12, 3), np.uint8)
COLORS[:5] = (120, 110, 100), (180, 120, 90), (200, 200, 40), (40, 160, 60), (180, 120, 90)
"""By part: the room, skin, a yellow torso, a green arm and a bare one."""
ALL = np.ones(CAMERA.shape, np.bool_)


def cloud_of(truth: FrameLabels) -> ThermalCloud:
    """Everything in its colour, bodies warm."""
    depth_m = truth.depth_mm.astype(np.float32) / np.float32(1000)
    celsius = np.where(truth.parts > 0, np.float32(31), np.float32(21))
    rgb = COLORS[truth.parts]
    return ThermalCloud(CAMERA, truth.depth_mm, unproject(CAMERA, depth_m), rgb, ALL, celsius)


def read_as(frame: FrameLabels, part: int, name: int, share: float = 1.0) -> FrameLabels:
    """A part, or the upper share of its rows, called otherwise."""
    rows = np.nonzero(frame.parts == part)[0]
    upper = np.arange(CAMERA.height)[:, None] <= np.quantile(rows, share)
    return replace(frame, parts=np.where((frame.parts == part) & upper, np.uint8(name), frame.parts))


def wrong(truth: FrameLabels, parts: np.ndarray) -> int:
    return int((parts != truth.parts).sum())


def with_hand(arm: FrameLabels) -> FrameLabels:
    """A hand has come out below the arm."""
    v, u = np.nonzero(arm.parts == 4)
    hand = np.hypot(*(np.indices(arm.parts.shape) - [[[v.max() + 4]], [[round(u.mean())]]])) < 8
    depth_mm = np.where(hand, np.uint16(1750), arm.depth_mm)
    return replace(arm, depth_mm=depth_mm, parts=np.where(hand, np.uint8(4), arm.parts))


def test_a_hand_that_was_hidden_before_is_known_by_its_looks():
    before, after = seen(), with_hand(seen((0.01, 0, 0), "b"))
    missed = replace(after, parts=seen((0.01, 0, 0), "b").parts)
    worked = CorrectedFrame(read_as(before, 1, 8, 0.5), before)
    blind = propagate([worked], missed, CAMERA)
    sighted = propagate([replace(worked, cloud=cloud_of(before))], missed, CAMERA, cloud_of(after))
    assert wrong(after, missed.parts) > 100
    assert wrong(after, sighted) <= 0.1 * wrong(after, missed.parts)
    assert wrong(after, blind) > 0.5 * wrong(after, missed.parts)


def test_a_mistake_in_one_colour_casts_no_doubt_on_the_same_name_in_another():
    before, after = seen(), seen((0.01, 0, 0), "b")
    mistaken = read_as(before, 3, 2)
    done = propagate([CorrectedFrame(mistaken, before, cloud_of(before))], after, CAMERA, cloud_of(after))
    assert wrong(after, done) <= 5


def test_without_colours_labels_are_as_they_were_without_a_cloud():
    before, after = seen(), seen((0.03, 0.02, 0), "b")
    dark = [
        replace(cloud_of(x), color_valid=~ALL, temperature_c=np.full(CAMERA.shape, np.nan, np.float32))
        for x in (before, after)
    ]
    worked, missed = CorrectedFrame(read_as(before, 4, 8), before), read_as(after, 4, 8)
    alone = propagate([worked], missed, CAMERA)
    done = propagate([replace(worked, cloud=dark[0])], missed, CAMERA, dark[1])
    np.testing.assert_array_equal(done, alone)


colors = st.lists(st.tuples(*[st.integers(1, 255)] * 3), min_size=2, max_size=20)


def appearance(rgb: list[tuple[int, ...]]) -> Appearance:
    lab = np.array(rgb, np.uint8)
    return Appearance(lab, np.full(len(lab), 30, np.float32))


@law
@given(colors, colors)
def test_resemblance_is_mutual_and_whole_for_the_same(ours, theirs):
    a, b = appearance(ours), appearance(theirs)
    every = np.tile(np.arange(len(theirs)), (len(ours), 1))
    back = np.tile(np.arange(len(ours)), (len(theirs), 1))
    ab, ba = a.resemblance(b, every), b.resemblance(a, back)
    np.testing.assert_allclose(ab, ba.T, rtol=1e-5)
    assert ((ab >= 0) & (ab <= 1)).all()
    np.testing.assert_allclose(a.resemblance(a, np.arange(len(ours))[:, None]), 1)


@law
@given(colors)
def test_what_a_part_was_seen_as_is_likelier_for_it_than_for_a_part_unseen(rgb):
    a = appearance(rgb)
    likely = a.likelihood(a, np.full(len(rgb), 7, np.uint8))
    assert np.isfinite(likely).all()
    assert (likely[:, 7] > likely[:, 3]).all()
