"""Warnings about a picture: light, position, suit colours, a knocked thermal camera."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.label_recording import SuitLabeller, label_cloud
from annotate.live.frame_warnings import EVERY_NS, FRAMES, ShiftWatch, color_warning, person_warnings
from annotate.suit.palette import load_suit
from sensors.session.reader import Session
from synth.rig.simulate import suit_path


@pytest.fixture(scope="module")
def seen(rig_session):
    """A frame of the virtual rig, its suit, how it was read, and the person's mask."""
    session, suit = Session(rig_session), load_suit(suit_path(rig_session))
    frame, fuser = session.frame(0), Fuser(session.calibration)
    return frame, fuser, *read_by(suit, fuser.fuse_frame(frame))


def read_by(suit, cloud):
    result, person = label_cloud(SuitLabeller(suit), cloud, None)
    return suit, cloud, result, person


def in_light(frame, gains, most=255):
    """The frame with its colours multiplied by red, green and blue gains."""
    rgb = np.clip(frame.decode_color() * np.array(gains), 0, most).astype(np.uint8)
    return replace(frame, color_encoded=cv2.imencode(".jpg", rgb[..., ::-1])[1].tobytes())


def test_nothing_is_said_of_a_good_picture(seen):
    _, _, _, cloud, result, person = seen
    assert not list(person_warnings(cloud, person.mask))
    assert color_warning(cloud, person.mask, result.illuminant) is None
    watch = ShiftWatch()
    assert not any(watch.warning(cloud, person.mask, (i + 1) * EVERY_NS) for i in range(FRAMES + 1))


@pytest.mark.parametrize(("kind", "gain"), [("dark", 0.05), ("glare", 6.0)])
def test_bad_light_on_the_person_is_a_warning(seen, kind, gain):
    frame, fuser, _, _, _, person = seen
    cloud = fuser.fuse_frame(in_light(frame, [gain] * 3))
    assert [warning.kind for warning in person_warnings(cloud, person.mask)] == [kind]


@pytest.mark.parametrize(("axis", "side"), [(0, "top"), (1, "left"), (None, "")])
def test_a_person_at_the_rim_or_too_far_away_is_a_warning(seen, axis, side):
    _, _, _, cloud, _, person = seen
    if axis is None:
        away_m = 1.5 + np.median(cloud.points_m[..., 2][person.mask])
        (warning,) = person_warnings(replace(cloud, points_m=cloud.points_m + np.float32(1.5)), person.mask)
        assert warning.kind == "far" and f"{away_m:.1f} m" in warning.text
        return
    first = int(np.flatnonzero(person.mask.any(axis=1 - axis))[0])
    names = ("points_m", "color_rgb", "color_valid")
    moved = {name: np.roll(getattr(cloud, name), -first - 20, axis) for name in names}
    mask = np.roll(person.mask, -first - 20, axis)
    mask[-20:] &= axis == 1
    mask[:, -20:] &= axis == 0
    (warning,) = person_warnings(replace(cloud, **moved), mask)
    assert warning.kind == "cut off" and side in warning.text


def test_suit_colours_that_a_sodium_lamp_makes_alike_are_named(seen):
    frame, fuser, suit, *_ = seen
    _, cloud, result, person = read_by(suit, fuser.fuse_frame(in_light(frame, (1, 0.55, 0.03))))
    warning = color_warning(cloud, person.mask, result.illuminant)
    assert warning is not None and " and " in warning.text and "light" in warning.text


@pytest.mark.parametrize(
    ("down", "right", "says"), [(0, 6, "too far right"), (-6, 0, "too far up"), (5, -5, "left and")]
)
def test_a_knocked_thermal_camera_is_said_with_way_and_angle(seen, down, right, says):
    frame, fuser, _, _, _, person = seen
    cloud = fuser.fuse_frame(replace(frame, thermal_c=np.roll(frame.thermal_c, (down, right), (0, 1))))
    watch = ShiftWatch()
    said = [watch.warning(cloud, person.mask, (i + 1) * EVERY_NS) for i in range(FRAMES)]
    assert said[: FRAMES - 1] == [None] * (FRAMES - 1)
    assert said[-1].kind == "shifted" and says in said[-1].text
    degrees = np.degrees(np.arctan(np.hypot(down, right) / 110.1))
    stated = [float(number) for number in re.findall(r"([\d.]+) degrees", said[-1].text)]
    assert np.hypot(*[*stated, 0.0][:2]) == pytest.approx(degrees, abs=0.7)
