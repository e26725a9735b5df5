"""Borders of parts, beside the plain way: every pixel again in every round."""

import numpy as np
import pytest

from annotate.cloud.grid import JUMP
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import N_CLASSES
from annotate.segmentation.border_refinement import NEIGHBOUR, ROUNDS, SURELY_ROOM, refine_borders
from annotate.segmentation.input_channels import Rectangle
from annotate.segmentation.suit_network import mean_with_flip
from sensors.rig.camera import Intrinsics, rays

CAMERA = Intrinsics(30, 24, 25.0, 25.0, 14.5, 11.5)


def classes_naive(chance, depth_m):
    """Return classes (h, w) by iterated conditional modes (Besag 1986) over all undecided pixels."""
    undecided = (depth_m > 0) & (chance[0] < SURELY_ROOM)
    scores, found = np.log(chance), np.where(undecided, chance.argmax(axis=0), 0)
    for _ in range(ROUNDS):
        last = found.copy()
        for v, u in np.argwhere(undecided):
            total = scores[:, v, u].copy()
            for r, c in np.argwhere(undecided[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]):
                r, c = r + max(v - 1, 0), c + max(u - 1, 0)
                apart_m = abs(depth_m[r, c] - depth_m[v, u])
                if (r, c) != (v, u) and apart_m <= np.float32(JUMP) * depth_m[v, u]:
                    total[last[r, c]] += np.float32(NEIGHBOUR)
            found[v, u] = total.argmax()
    return found


@pytest.mark.parametrize("seed", range(4))
def test_classes_are_those_of_every_pixel_in_every_round(seed):
    rng = np.random.default_rng(seed)
    depth_mm = np.where(rng.random(CAMERA.shape) < 0.1, 0, 2000).astype(np.uint16)
    depth_mm[:, 13:] += np.where(depth_mm[:, 13:] > 0, 300, 0).astype(np.uint16)
    points_m = (rays(CAMERA) * depth_mm[..., None] / 1000).astype(np.float32)
    unseen = np.zeros(CAMERA.shape, np.bool_)
    rgb, celsius = np.zeros((*CAMERA.shape, 3), np.uint8), np.full(CAMERA.shape, np.nan, np.float32)
    cloud = ThermalCloud(CAMERA, depth_mm, points_m, rgb, unseen, celsius)
    scores = rng.normal(0, 1, (N_CLASSES + 1, *CAMERA.shape)).astype(np.float32)
    scores[0, :5], scores[1 + seed, 9:] = 9, 2.5
    chance = np.exp(scores) / np.exp(scores).sum(axis=0)
    named, sure = refine_borders(cloud, Rectangle(slice(0, 24), slice(0, 30)), chance, None)
    np.testing.assert_array_equal(named, classes_naive(chance, points_m[..., 2]))
    chosen = np.take_along_axis(chance, named[None].astype(np.intp), axis=0)[0]
    np.testing.assert_array_equal(sure[named > 0], chosen[named > 0])


def test_a_mean_with_the_flip_is_that_of_the_turned_planes():
    own, other = np.random.default_rng(0).random((2, 3, 4, 7), np.float32)
    twins = np.array([0, 2, 1])
    expected = np.float32(0.5) * (own + other[twins][..., ::-1])
    np.testing.assert_array_equal(mean_with_flip(own, other, twins), expected)
