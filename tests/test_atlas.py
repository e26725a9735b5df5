"""The atlas: regions refine the paper's parts on every body, the same on both sides, through clothes too."""

import numpy as np
import pytest

from annotate.parts import BODY_PARTS, LEFT_RIGHT, PAPER_PARTS
from annotate.scheme.regions import REGION_NEIGHBOURS, Region, swap_regions
from synth.body.atlas_border import face_regions
from synth.body.body import reference_body, shipped_bodies
from synth.body.crowd import crowd_of
from synth.data_files import JUDGE, TRAINING
from synth.images.people import crowd_person

BODIES = [*shipped_bodies(), *crowd_of(TRAINING)[::6], *crowd_of(JUDGE)]


def areas_cm2(body):
    a, b, c = (body.vertices_m[body.faces[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2 * 1e4
    return np.bincount(face_regions(body), area, minlength=len(Region) + 1)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_regions_refine_the_parts_of_the_paper_and_both_sides_are_alike(body):
    np.testing.assert_array_equal(PAPER_PARTS[face_regions(body)], body.face_parts)
    area = areas_cm2(body)
    assert (area[1:] > 25).all()
    for region in Region:
        assert area[region] == pytest.approx(area[region.twin], rel=0.08)


def test_regions_meet_where_anatomy_joins_them():
    body = reference_body()
    regions = face_regions(body)
    edges = np.sort(body.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, first, inverse = np.unique(edges, axis=0, return_index=True, return_inverse=True)
    owner = np.repeat(regions, 3)
    pairs = {
        frozenset((int(a), int(b)))
        for a, b in zip(owner, owner[first][inverse.ravel()], strict=True)
        if a != b
    }
    assert pairs == REGION_NEIGHBOURS


def test_clothes_have_the_regions_of_the_body_beneath():
    rng = np.random.default_rng(45)
    for _ in range(6):
        dressed = crowd_person(rng).dressed
        np.testing.assert_array_equal(PAPER_PARTS[dressed.face_regions], dressed.face_parts)


def test_exchanging_sides_twice_changes_nothing_and_agrees_with_the_paper():
    ids = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(swap_regions(swap_regions(ids)), ids)
    table = np.arange(256)
    for left, right in LEFT_RIGHT:
        table[[left, right]] = right, left
    np.testing.assert_array_equal(
        PAPER_PARTS[swap_regions(ids[: len(Region) + 1])], table[PAPER_PARTS[: len(Region) + 1]]
    )
    assert {int(part) for part in PAPER_PARTS[1 : len(Region) + 1]} == {part.id for part in BODY_PARTS}
