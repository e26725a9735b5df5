"""A twin's loop shows each frame from its stamp on, and all of them again and again."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sensors.rig.frame import RigFrame
from sensors.virtual.frame_loop import FRAMES_PER_SECOND, FrameLoop


def loop(stamps_ns):
    frames = (RigFrame(i, stamp, np.full((2, 2), i, np.uint16)) for i, stamp in enumerate(stamps_ns))
    return FrameLoop(frames)


def number_at(scene, seconds):
    return int(scene.depth(seconds)[0, 0])


@given(st.lists(st.integers(10**6, 10**10), min_size=1, max_size=29), st.integers(0, 3), st.data())
def test_each_frame_is_shown_from_its_stamp_on_in_every_round(steps_ns, rounds, data):
    stamps = np.r_[0, np.cumsum(steps_ns)] + 123_456
    scene, number = loop(stamps.tolist()), data.draw(st.integers(0, len(stamps) - 1))
    length = np.r_[steps_ns, np.median(steps_ns)][number] * 1e-9
    period = (stamps[-1] - stamps[0] + np.median(steps_ns)) * 1e-9
    start = rounds * period + (stamps[number] - stamps[0]) * 1e-9
    assert number_at(scene, start + 0.02 * length) == number_at(scene, start + 0.98 * length - 2e-6) == number


@given(st.integers(1, 30), st.integers(0, 200))
def test_frames_without_rising_stamps_are_shown_at_thirty_a_second(count, at):
    assert number_at(loop([0] * count), at / FRAMES_PER_SECOND) == at % count
