"""Blankets are told from parts by size, warmth, colour and place; a suit from clothes by its colours."""

import numpy as np
import pytest

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import shipped_weights
from annotate.person.clothed_mask import clothed_odds, patch_clues
from annotate.person.extract import Survey
from annotate.person.subject import colors_worn
from annotate.suit.palette import DEFAULT_SUIT
from sensors.rig.camera import Intrinsics, rays

CAMERA = Intrinsics(512, 424, 365.0, 365.0, 255.5, 211.5)
HEAD = (slice(40, 78), slice(222, 258))
TRUNK = (slice(80, 170), slice(205, 275))
HIPS = (slice(170, 190), slice(205, 275))
LEGS = ((slice(192, 250), slice(205, 237)), (slice(192, 250), slice(243, 275)))
SHINS = ((slice(252, 330), slice(208, 232)), (slice(252, 330), slice(248, 272)))
WEIGHTS = shipped_weights()
LAP = (slice(180, 300), slice(165, 315))
BLANKET_RGB, WHITE_RGB = (150, 120, 100), (180, 180, 180)
SIZED = ((HEAD, 1, 32.0), (TRUNK, 2, 30.0), (HIPS, 7, 30.0), (LEGS[0], 8, 29.0), (LEGS[1], 9, 29.0))


def cloud_of(lap_c=None, lap_rgb=BLANKET_RGB, shins_c=27.0):
    """Somebody in the suit 2 m away before a white wall of 20 degrees, with or without a cloth on the lap."""
    depth_mm = np.full(CAMERA.shape, 2600, np.uint16)
    rgb = np.full((*CAMERA.shape, 3), WHITE_RGB, np.uint8)
    celsius = np.full(CAMERA.shape, 20, np.float32)
    person = np.zeros(CAMERA.shape, np.bool_)
    for place, part, warm in (*SIZED, (SHINS[0], 10, shins_c), (SHINS[1], 11, shins_c)):
        color = DEFAULT_SUIT.colors_rgb[DEFAULT_SUIT.parts == part][-1]
        depth_mm[place], rgb[place], celsius[place], person[place] = 2000, color, warm, True
    if lap_c is not None:
        depth_mm[LAP], rgb[LAP], celsius[LAP], person[LAP] = 1980, lap_rgb, lap_c, True
    points = (rays(CAMERA) * (depth_mm[..., None] / 1000)).astype(np.float32)
    seen = np.ones(CAMERA.shape, np.bool_)
    return ThermalCloud(CAMERA, depth_mm, points, rgb, seen, celsius), person


def told(cloud, person, beside=None):
    odds = np.clip(cloud.temperature_c - 22, -3, 3).astype(np.float32)
    beside = np.zeros_like(person) if beside is None else beside
    clues = patch_clues(cloud, person, beside, ~(person | beside), DEFAULT_SUIT, odds, WEIGHTS)
    return np.zeros_like(odds) if clues is None else clothed_odds(clues, WEIGHTS)


@pytest.mark.parametrize("shins_c", [22.0, 27.0])
def test_a_body_is_all_worn_however_cold_its_legs(shins_c):
    cloud, person = cloud_of(shins_c=shins_c)
    assert (told(cloud, person)[person] > 0).mean() > 0.97


@pytest.mark.parametrize("lap_c", [25.0, 29.5])
@pytest.mark.parametrize("lap_rgb", [BLANKET_RGB, tuple(DEFAULT_SUIT.colors_rgb[-1])])
def test_a_large_cloth_is_none_of_theirs_however_warm_and_of_whatever_colour(lap_c, lap_rgb):
    cloud, person = cloud_of(lap_c, lap_rgb)
    odds = told(cloud, person)
    assert (odds[LAP] < 0).mean() > 0.95
    assert (odds[TRUNK][:-4] > 0).mean() > 0.95 and (odds[HEAD] > 0).mean() > 0.95


def test_the_darker_a_thing_on_the_lap_the_less_it_is_theirs_and_legs_stay():
    lid, by_shade = (slice(165, 205), slice(212, 268)), []
    for shade in (0.5, 0.3):
        cloud, person = cloud_of()
        cloud.depth_mm[lid], cloud.temperature_c[lid] = 1850, 31
        cloud.color_rgb[lid] = np.array([160, 165, 172]) * shade
        cloud.points_m[lid] *= 1.85 / cloud.points_m[lid][..., 2:]
        odds = told(cloud, person)
        by_shade.append(odds[lid].mean())
        assert (odds[LEGS[0]][14:] > 0).mean() > 0.9
    assert by_shade[0] > by_shade[1] + 0.5


def test_what_lies_beside_and_looks_like_a_leg_is_a_leg_and_the_wall_is_not():
    cloud, person = cloud_of(shins_c=21.0)
    seen = person.copy()
    seen[SHINS[0]] = False
    beside = seen.copy()
    beside[180:340, 160:320] = True
    beside &= ~seen
    odds = told(cloud, seen, beside)
    assert odds[SHINS[0]].mean() > odds[200:320, 165:195].mean() + 1
    assert (odds[200:320, 165:195] < 0).all()


def test_a_foot_far_below_a_cold_blanket_is_looked_at_and_found():
    cloud, person = cloud_of(lap_c=20.0, shins_c=27.5)
    v, u = np.indices(CAMERA.shape)
    rounded_m = 0.18 * np.cos((u - 240) / 28) + 0.1 * np.cos(v / 25) + 0.3
    depth_m = cloud.depth_mm / 1000 - np.where(person, rounded_m, 0)
    cloud.depth_mm[:], cloud.points_m[:] = depth_m * 1000, rays(CAMERA) * depth_m[..., None]
    found = Survey(cloud, (28.0, 34.0), DEFAULT_SUIT).person().mask
    assert found[TRUNK].mean() > 0.95 and not found[LAP][:110].any()
    assert found[304:328, SHINS[0][1]].mean() > 0.5


@pytest.mark.parametrize("lost", ["temperature_c", "color_valid"])
def test_without_temperature_or_colour_nothing_is_told(lost):
    cloud, person = cloud_of(lap_c=25.0)
    getattr(cloud, lost)[:] = np.nan if lost == "temperature_c" else False
    assert not told(cloud, person).any()


def test_a_suit_shows_more_colours_than_clothes_and_things_show_none():
    cloud, person = cloud_of(lap_c=25.0)
    clothes = colors_worn(cloud, person, ~person)
    strips = np.array_split(np.flatnonzero(person), len(DEFAULT_SUIT.colors_rgb))
    for strip, rgb in zip(strips, DEFAULT_SUIT.colors_rgb, strict=True):
        cloud.color_rgb.reshape(-1, 3)[strip] = rgb
    assert colors_worn(cloud, person, ~person) > 1.5 * clothes
    cloud.color_rgb[:] = WHITE_RGB
    assert colors_worn(cloud, person, ~person) == 0
