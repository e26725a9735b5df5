"""Suit network: input channels, probabilities, flips, and borders by colour."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.onnx_graph import parsed
from annotate.parts import N_CLASSES, PAPER, PART_ID, swap_left_right
from annotate.person.extract import PersonDetection
from annotate.segmentation.border_refinement import refine_borders
from annotate.segmentation.input_channels import (
    CHANNELS,
    LIKELIHOODS,
    RANGES,
    Rectangle,
    channels,
    network_input,
    rectangle,
    with_likelihoods,
)
from annotate.segmentation.suit_network import (
    MULTIPLE,
    SHIPPED_SUIT_NETWORK,
    SuitNetwork,
    flip_averaged,
    flipped,
    shipped_suit_network,
)
from annotate.suit.color_model import fit_illuminant
from annotate.suit.palette import DEFAULT_SUIT
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics, rays

CAMERA = Intrinsics(96, 64, 80.0, 80.0, 47.5, 31.5)
SEEDS = st.integers(0, 2**32 - 1)
TORSO, ARM = PART_ID["torso"], PART_ID["left_upper_arm"]


def color_of(part: int) -> np.ndarray:
    return DEFAULT_SUIT.colors_rgb[list(DEFAULT_SUIT.parts).index(part)]


def wall(worn: np.ndarray) -> ThermalCloud:
    """A wall two metres away whose pixels (h, w) show the cloth of the parts named, 0 = a grey wall."""
    depth_mm = np.full(CAMERA.shape, 2000, np.uint16)
    rgb = np.full((*CAMERA.shape, 3), 120, np.uint8)
    for part in np.unique(worn[worn > 0]):
        rgb[worn == part] = color_of(part)
    seen = np.ones(CAMERA.shape, bool)
    celsius = np.where(worn > 0, 31, 21).astype(np.float32)
    return ThermalCloud(CAMERA, depth_mm, (rays(CAMERA) * 2).astype(np.float32), rgb, seen, celsius)


@given(st.integers(0, 90), st.integers(0, 60), st.integers(1, 40), st.integers(1, 40))
def test_the_rectangle_holds_the_outline_and_an_arm_s_reach(column, row, width, height):
    subject = np.zeros(CAMERA.shape, bool)
    subject[row : row + height, column : column + width] = True
    where, pixels_per_m = rectangle(wall(subject.astype(np.uint8)), subject)
    assert round(pixels_per_m) == 40  # pixels are 25 mm apart
    assert subject[where].sum() == subject.sum()
    arm = 43  # 1.1 m at 2 m
    middle = (row + min(row + height, 64) - 1) // 2
    assert where.rows.start <= max(0, middle - arm) and where.rows.stop >= min(64, middle + arm)


@given(SEEDS)
def test_what_is_not_known_is_nothing_to_the_network(seed):
    rng = np.random.default_rng(seed)
    planes = rng.integers(0, 256, (len(CHANNELS), 8, 8)).astype(np.uint8)
    planes[0], planes[1] = 0, 0
    planes[-len(LIKELIHOODS) + 2 :] = 0
    assert not network_input(planes, len(PAPER.parts)).any()


def test_colour_moves_a_border_that_the_network_leaves_open():
    worn = np.where(np.arange(96) < 50, TORSO, ARM)[None].repeat(64, 0).astype(np.uint8)
    cloud = wall(worn)
    light = fit_illuminant(DEFAULT_SUIT, cloud.color_rgb.reshape(-1, 3))
    chance = np.full((N_CLASSES + 1, *CAMERA.shape), 1e-3, np.float32)
    chance[TORSO, :, :44], chance[ARM, :, 56:] = 0.9, 0.9
    chance[[TORSO, ARM], :, 44:56] = 0.5
    everywhere = Rectangle(slice(0, 64), slice(0, 96))
    named, sure = refine_borders(cloud, everywhere, chance, light)
    assert (named == worn).mean() > 0.999 and (sure[named == worn] >= 0.5).all()
    chance[0], chance[1:] = 0.99, 1e-3
    assert not refine_borders(cloud, everywhere, chance, light)[0].any()


def test_the_network_takes_any_size_and_damage_is_named(tmp_path):
    network = shipped_suit_network()
    sent = pickle.loads(pickle.dumps(network))
    for shape, step in (((MULTIPLE, 3 * MULTIPLE), 1), ((37, 50), 1), ((37, 50), 3)):
        planes = np.random.default_rng(5).integers(0, 256, (len(CHANNELS), *shape)).astype(np.uint8)
        found = network.probabilities(planes, step)
        assert found.shape == (N_CLASSES + 1, *shape) and sent.sha256 == network.sha256
        np.testing.assert_allclose(found.sum(axis=0), 1, atol=1e-5)
        np.testing.assert_array_equal(sent.probabilities(planes, step), found)
    whole = SHIPPED_SUIT_NETWORK.read_bytes()
    blind = parsed(whole)
    del blind.graph.input[:]
    others = b"no network", whole[:-1000], blind.SerializeToString(), b""
    for other in (
        *others,
        SHIPPED_SUIT_NETWORK.parents[1].joinpath("person", "detection", "finder.onnx").read_bytes(),
    ):
        (tmp_path / "w.onnx").write_bytes(other)
        with pytest.raises(FormatError, match="train-labels"):
            SuitNetwork(tmp_path / "w.onnx")


def test_a_pixel_is_seen_among_every_step_th():
    reader, planes = (
        shipped_suit_network(),
        np.random.default_rng(7).integers(0, 256, (len(CHANNELS), 33, 50)),
    )
    planes = planes.astype(np.uint8)
    found = reader.probabilities(planes, 3)
    np.testing.assert_allclose(found[:, ::3, ::3], reader.probabilities(planes[:, ::3, ::3], 1), atol=1e-6)
    # An image that repeats each pixel is the same in all samples, except for the shifted context.
    doubled = planes[:, :32, :48].repeat(2, axis=1).repeat(2, axis=2)
    once, twice = reader.probabilities(planes[:, :32, :48], 1), reader.probabilities(doubled, 2)
    assert (twice[:, 1::2, 1::2].argmax(axis=0) == once.argmax(axis=0)).mean() > 0.7


@given(st.integers(0, 40), st.integers(0, 60), st.integers(1, 30), st.integers(1, 30), st.integers(1, 3))
@settings(max_examples=8, deadline=None)
def test_a_part_of_an_image_is_read_as_in_the_whole(top, left, height, width, step):
    planes = np.random.default_rng(9).integers(0, 256, (len(CHANNELS), 48, 80)).astype(np.uint8)
    near = Rectangle(slice(top, min(top + height, 48)), slice(left, min(left + width, 80)))
    wide = Rectangle(*(slice(max(s.start - 32 * step, 0), s.stop + 32 * step) for s in near))
    whole = shipped_suit_network().probabilities(planes, step)
    wide = Rectangle(*(slice(s.start, min(s.stop, side)) for s, side in zip(wide, (48, 80), strict=True)))
    found = shipped_suit_network().probabilities(planes, step, wide)
    inner = (slice(n.start - w.start, n.stop - w.start) for n, w in zip(near, wide, strict=True))
    np.testing.assert_allclose(found[:, *inner], whole[:, *near], atol=1e-4)


@given(st.integers(40, 50), st.integers(1, 3))
@settings(max_examples=8, deadline=None)
def test_a_frame_and_its_mirror_image_are_read_alike(width, step):
    planes = np.random.default_rng(11).integers(0, 256, (len(CHANNELS), 36, width)).astype(np.uint8)
    near, twins = Rectangle(slice(3, 30), slice(7, 29)), [*swap_left_right(np.arange(12, dtype=np.uint8)), 12]
    there = Rectangle(near.rows, slice(width - 29, width - 7))
    assert (flipped(flipped(planes)) == planes).all() and (flipped(planes) != planes).any()
    found = flip_averaged(shipped_suit_network(), planes, step, near)
    assert found.shape == (N_CLASSES + 1, 27, 22)
    if (width - 1) % step == 0:
        other = flip_averaged(shipped_suit_network(), flipped(planes), step, there)
        np.testing.assert_allclose(other[twins][:, :, ::-1], found, atol=1e-6)


@pytest.mark.parametrize("width", [48, 49, 50])
def test_around_a_place_the_mirror_shows_the_same_pixels(width):
    """The likeness is known of every step-th column alone, but near the parts."""
    seen = []

    class Watched:
        own = scheme = PAPER

        def probabilities(self, planes, step, near):
            seen.append((planes[:, ::step, ::step], planes[:, *near]))
            return np.zeros((N_CLASSES + 1, *planes[0, *near].shape), np.float32)

    planes = np.random.default_rng(12).integers(0, 256, (len(CHANNELS), 20, width)).astype(np.uint8)
    flip_averaged(Watched(), planes, 3, Rectangle(slice(4, 9), slice(8, width)))
    for one, other in zip(*seen, strict=True):
        np.testing.assert_array_equal(flipped(one), other)


def test_every_channel_keeps_its_range():
    worn = np.zeros(CAMERA.shape, np.uint8)
    worn[10:50, 30:60] = TORSO
    cloud = wall(worn)
    survey = PersonDetection(CoarseCloud.of(cloud))
    person = replace(survey.person(None), mask=worn > 0, persons=(worn > 0).astype(np.uint8))
    light = fit_illuminant(DEFAULT_SUIT, cloud.color_rgb[worn > 0])
    where = rectangle(cloud, worn > 0)[0]
    bare = channels(cloud, survey, person, where)
    planes = with_likelihoods(bare, cloud.color_rgb[where], light)
    assert planes.shape[0] == len(CHANNELS) and planes.dtype == np.uint8
    torso, arm = (planes[CHANNELS.index(name)] for name in ("torso", "left_upper_arm"))
    own = worn[where] > 0
    assert torso[own].min() > arm[own].max() and set(RANGES) <= set(CHANNELS)
    assert not bare[-len(LIKELIHOODS) :].any()
    np.testing.assert_array_equal(planes[: -len(LIKELIHOODS)], bare[: -len(LIKELIHOODS)])
