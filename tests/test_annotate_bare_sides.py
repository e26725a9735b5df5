"""Bare hands and shoes take the side of the cloth that they touch (annotate/segmentation/bare_sides.py)."""

import numpy as np
import pytest

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import PAPER, PART_ID
from annotate.segmentation.bare_sides import CLEAR, UNSIDED, settle_sides
from annotate.segmentation.input_channels import Rectangle
from annotate.segmentation.suit_network import other_person
from annotate.suit.color_model import BARE, unfitted
from annotate.suit.palette import DEFAULT_SUIT
from sensors.rig.camera import Intrinsics, rays

CAMERA = Intrinsics(48, 40, 60.0, 60.0, 23.5, 19.5)
EVERYWHERE = Rectangle(slice(0, 40), slice(0, 48))
SKIN, SHOE = (rgb for rgb, *_ in BARE)
LEFT_ARM, RIGHT_ARM = PART_ID["left_forearm"], PART_ID["right_forearm"]
LEFT_LEG, RIGHT_LEG = PART_ID["left_lower_leg"], PART_ID["right_lower_leg"]
LIMBS = [(LEFT_ARM, RIGHT_ARM, SKIN), (RIGHT_ARM, LEFT_ARM, SKIN), (LEFT_LEG, RIGHT_LEG, SHOE)]


def cloth(part: int) -> tuple[int, ...]:
    return tuple(DEFAULT_SUIT.swatches_of(part)[0].tolist())


def cloud_of(rgb: np.ndarray, depth_m: np.ndarray) -> ThermalCloud:
    points = (rays(CAMERA) * depth_m[..., None]).astype(np.float32)
    seen, unknown = np.ones(CAMERA.shape, np.bool_), np.full(CAMERA.shape, np.nan, np.float32)
    return ThermalCloud(CAMERA, (depth_m * 1000).astype(np.uint16), points, rgb, seen, unknown)


def certain(parts: np.ndarray, sure: float = 0.9) -> np.ndarray:
    """Return probabilities that name ``parts`` with a probability, and its twin with the rest."""
    chance = np.zeros((other_person(PAPER) + 1, *parts.shape), np.float32)
    np.put_along_axis(chance, parts[None].astype(np.int64), sure, axis=0)
    twins = PAPER.twin_classes[parts][None].astype(np.int64)
    np.put_along_axis(chance, twins, np.where(twins == parts, 1.0, 1 - sure).astype(np.float32), axis=0)
    return chance


def scene(sleeve: int, hand: int, bare: tuple[int, int, int]) -> tuple[np.ndarray, ...]:
    """Return colours, depth and labels of a sleeve (columns 10 to 24) and a bare piece to its right."""
    rgb, depth_m = np.full((*CAMERA.shape, 3), 90, np.uint8), np.full(CAMERA.shape, 2.6)
    parts = np.zeros(CAMERA.shape, np.uint8)
    rgb[16:24, 10:25], rgb[16:24, 25:34] = cloth(sleeve), bare
    parts[16:24, 10:25], parts[16:24, 25:34] = sleeve, hand
    depth_m[16:24, 10:34] = 2.0
    return rgb, depth_m, parts


def settled(rgb: np.ndarray, depth_m: np.ndarray, parts: np.ndarray) -> np.ndarray:
    chance = certain(parts)
    found = settle_sides(cloud_of(rgb, depth_m), EVERYWHERE, chance, unfitted(DEFAULT_SUIT), PAPER)
    np.testing.assert_allclose(found.sum(axis=0), chance.sum(axis=0), atol=1e-6)
    return found.argmax(axis=0)


@pytest.mark.parametrize(("sleeve", "other", "bare"), LIMBS)
def test_a_bare_piece_takes_the_side_of_the_cloth_that_it_grows_from(sleeve, other, bare):
    rgb, depth_m, parts = scene(sleeve, other, bare)
    right = np.where(parts == other, sleeve, parts)
    np.testing.assert_array_equal(settled(rgb, depth_m, parts), right)
    np.testing.assert_array_equal(settled(rgb, depth_m, right), right)


@pytest.mark.parametrize(("sleeve", "other", "bare"), LIMBS)
def test_a_piece_with_a_depth_step_to_the_cloth_stays(sleeve, other, bare):
    rgb, depth_m, parts = scene(sleeve, other, bare)
    depth_m[:, 25:34] -= 0.2
    np.testing.assert_array_equal(settled(rgb, depth_m, parts), parts)


@pytest.mark.parametrize(("sleeve", "other", "bare"), LIMBS)
def test_a_piece_between_cloth_of_both_sides_stays(sleeve, other, bare):
    rgb, depth_m, parts = scene(sleeve, other, bare)
    rgb[16:24, 34:44], parts[16:24, 34:44], depth_m[16:24, 34:44] = cloth(other), other, 2.0
    np.testing.assert_array_equal(settled(rgb, depth_m, parts), parts)


def faint(part: int, bare: tuple[int, int, int]) -> np.ndarray:
    """Return a blend of a part's cloth and a bare colour whose side is likely and not clear."""
    share = np.linspace(0, 1, 400)[:, None]
    blends = np.round(np.array(bare) + share * (np.array(cloth(part)) - bare)).astype(np.uint8)
    rows = np.searchsorted(PAPER.body_classes, [part, PAPER.twin_classes[part]])
    own, twin = unfitted(DEFAULT_SUIT).evidence(blends, PAPER)[rows]
    return blends[np.argmin(np.abs(own - twin - (UNSIDED + CLEAR) / 2))]


@pytest.mark.parametrize(("sleeve", "other", "bare"), LIMBS)
def test_cloth_keeps_its_own_side(sleeve, other, bare):
    rgb, depth_m, parts = scene(sleeve, other, bare)
    for worn in (cloth(other), faint(other, bare)):
        rgb[16:24, 25:34] = worn
        np.testing.assert_array_equal(settled(rgb, depth_m, parts), parts)


def test_another_kind_of_part_gives_no_side():
    rgb, depth_m, parts = scene(PART_ID["left_upper_arm"], RIGHT_ARM, SKIN)
    np.testing.assert_array_equal(settled(rgb, depth_m, parts), parts)
