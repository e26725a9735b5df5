"""Blankets are told from parts by size, warmth and colour; somebody in a suit from somebody in clothes."""

import numpy as np
import pytest

from annotate.cloud import ThermalCloud
from annotate.covers import colors_worn, covers
from annotate.suit import DEFAULT_SUIT
from sensors.camera import Intrinsics, rays

CAMERA = Intrinsics(512, 424, 365.0, 365.0, 255.5, 211.5)
TRUNK = (slice(80, 180), slice(200, 280))
LAP = (slice(180, 300), slice(170, 310))
LEG = (slice(300, 370), slice(200, 224))
BLANKET_RGB, WHITE_RGB = (150, 120, 100), (180, 180, 180)


def cloud_of(lap_c, lap_rgb=BLANKET_RGB):
    """Trunk, lap and a leg 2 m away before a white wall of 20 degrees."""
    depth_mm = np.full(CAMERA.shape, 2600, np.uint16)
    rgb = np.full((*CAMERA.shape, 3), WHITE_RGB, np.uint8)
    celsius = np.full(CAMERA.shape, 20, np.float32)
    person = np.zeros(CAMERA.shape, np.bool_)
    for place, color, warm in (
        (TRUNK, (230, 200, 20), 30.0),
        (LAP, lap_rgb, lap_c),
        (LEG, (90, 160, 240), 27.0),
    ):
        depth_mm[place], rgb[place], celsius[place], person[place] = 2000, color, warm, True
    points = (rays(CAMERA) * (depth_mm[..., None] / 1000)).astype(np.float32)
    seen = np.ones(CAMERA.shape, np.bool_)
    return ThermalCloud(CAMERA, depth_mm, points, rgb, seen, celsius), person


def test_a_large_tepid_cloth_is_a_cover_and_the_rest_is_not():
    cloud, person = cloud_of(lap_c=25.0)
    found = covers(cloud, person, ~person)
    assert found[LAP].mean() > 0.95
    assert not found[TRUNK][:-4].any() and not found[LEG][4:].any()
    assert not (found & ~person).any()


def test_what_is_as_warm_as_the_trunk_is_no_cover():
    cloud, person = cloud_of(lap_c=31.0)
    assert not covers(cloud, person, ~person).any()


@pytest.mark.parametrize("lost", ["temperature_c", "color_valid"])
def test_without_temperature_or_colour_nothing_is_a_cover(lost):
    cloud, person = cloud_of(lap_c=25.0)
    getattr(cloud, lost)[:] = np.nan if lost == "temperature_c" else False
    assert not covers(cloud, person, ~person).any()


def test_a_suit_shows_more_colours_than_clothes_and_things_show_none():
    cloud, person = cloud_of(lap_c=25.0)
    clothes = colors_worn(cloud, person, ~person)
    strips = np.array_split(np.flatnonzero(person), len(DEFAULT_SUIT.colors_rgb))
    for strip, rgb in zip(strips, DEFAULT_SUIT.colors_rgb, strict=True):
        cloud.color_rgb.reshape(-1, 3)[strip] = rgb
    assert colors_worn(cloud, person, ~person) > 1.5 * clothes
    cloud.color_rgb[:] = WHITE_RGB
    assert colors_worn(cloud, person, ~person) == 0
