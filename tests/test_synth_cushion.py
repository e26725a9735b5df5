"""Soft surfaces give way where a body is and nowhere else, and keep its warmth for a while."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth.rig.cushion import CLEARANCE_M, CONTACT_C, COOLING_S, WARMING_S, Cushion
from synth.rig.locations import located
from synth.surface.furniture import Sofa, Solid, Surface
from synth.surface.rasterize import merge
from synth.surface.varied_furniture import Bars

SEAT = Solid((-0.5, 0.0, 0.0), (0.5, 0.5, 0.4), 0.03, Surface.SOFA)


def ball(centre, radius=0.08):
    """Points on a ball, closer together than the cushion's cells."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 60), np.linspace(0, 2 * np.pi, 90))
    directions = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    return (centre + radius * directions.reshape(-1, 3)).astype(np.float32)


@given(x=st.floats(-0.3, 0.3), y=st.floats(0.15, 0.35), sunk=st.floats(0.0, 0.06))
@settings(max_examples=30, deadline=None)
def test_a_ball_dents_the_seat_under_it_as_deep_as_it_sinks(x, y, sunk):
    cushion = Cushion(SEAT, "top", 0.0)
    dent = cushion.press(ball((x, y, 0.4 + 0.08 - sunk)))
    assert dent.max() == pytest.approx(sunk + CLEARANCE_M, abs=0.002)
    n, m = dent.shape
    i, j = np.unravel_index(int(dent.argmax()), dent.shape)
    assert abs(-0.5 + i / (n - 1) - x) < 0.04 and abs(0.5 * j / (m - 1) - y) < 0.04
    # No point of the ball is below the dented surface: it is seen, not drowned.
    nodes = cushion.vertices(dent)[8:].reshape(n, m, 3)
    assert nodes[..., 2].min() <= 0.4 - sunk
    assert nodes[0, :, 2].min() == pytest.approx(0.4) and nodes[..., 2].max() <= 0.4 + 1e-6


def test_nobody_leaves_no_dent_and_a_puffed_seat_is_highest_in_the_middle():
    cushion = Cushion(SEAT, "top", 0.02)
    dent = cushion.press(ball((0, 0.25, 0.7)))
    assert not dent.any()
    heights = cushion.vertices(dent)[8:, 2].reshape(dent.shape)
    middle = tuple(k // 2 for k in dent.shape)
    assert heights[middle] == pytest.approx(0.42, abs=1e-3)
    assert heights[0].max() == heights[:, -1].max() == pytest.approx(0.4)


def test_a_back_rest_gives_way_backwards():
    back = Sofa().solids()[1]
    cushion = Cushion(back, "front", 0.0)
    front = back.rotation @ np.array([0.0, 0.0, 0.3]) + back.translation
    out = -back.rotation[:, 1]
    dent = cushion.press(ball(front + 0.06 * out))
    assert dent.max() == pytest.approx(0.02 + CLEARANCE_M, abs=0.002)
    moved = (cushion.vertices(dent) - cushion.vertices(0 * dent))[8:]
    assert (moved @ out).min() == pytest.approx(-dent.max(), abs=1e-5)


@given(seconds=st.floats(0.5, 600), pieces=st.integers(1, 5))
@settings(max_examples=20, deadline=None)
def test_warming_and_cooling_follow_their_time_constants_however_time_is_cut(seconds, pieces):
    cushion = Cushion(SEAT, "top", 0.0)
    dent = cushion.press(ball((0.0, 0.25, 0.45)))
    for _ in range(pieces):
        cushion.warm(dent, seconds / pieces)
    assert cushion.heat.max() == pytest.approx(1 - np.exp(-seconds / WARMING_S))
    warmest = cushion.heat.max()
    for _ in range(pieces):
        cushion.warm(0 * dent, seconds / pieces)
    assert cushion.heat.max() == pytest.approx(warmest * np.exp(-seconds / COOLING_S))
    assert not cushion.heat[dent == 0].any()


def test_temperatures_lie_between_the_rooms_and_the_sitters():
    cushion = Cushion(SEAT, "top", 0.0)
    assert (cushion.celsius(20.0) == 20.0).all()
    dent = cushion.press(ball((0.0, 0.25, 0.42)))
    cushion.warm(dent, 1e6)
    celsius = cushion.celsius(20.0)
    assert len(celsius) == len(cushion.mesh.faces)
    assert celsius.min() == 20.0 and 28 < celsius.max() <= CONTACT_C + 1e-9
    cushion.leave_warm(cushion.press(ball((0.3, 0.25, 0.42))), 0.5)
    assert 20 < np.partition(cushion.heat.ravel(), -1)[-1] * 10 + 20 <= 30.1


@pytest.mark.parametrize("scene", ["sofa", "chair", "bed"])
def test_cushions_stand_where_their_furniture_does(scene):
    place = located(scene)(np.random.default_rng(4))
    bare = np.concatenate([solid.mesh().vertices_m for solid in place.furniture.solids()])
    drawn = np.concatenate([c.mesh.vertices_m for c in place.cushions()])
    assert (drawn >= bare.min(axis=0) - 0.02).all() and (drawn <= bare.max(axis=0) + 0.02).all()
    assert len(place.cushions()) + len(place.hard_solids()) == len(place.furniture.solids())


def test_a_slatted_back_has_no_cushion():
    drawn = (located("chair")(np.random.default_rng(seed)) for seed in range(60))
    slatted = [place for place in drawn if any(isinstance(one, Bars) for one in place.furniture.solids()[:2])]
    assert slatted
    for place in slatted:
        shown = [*(c.mesh for c in place.cushions()), *(solid.mesh() for solid in place.hard_solids())]
        mesh = merge(shown)
        assert len(np.unique(mesh.faces)) == len(mesh.vertices_m)
        (seat,) = place.cushions()
        assert np.allclose(seat.mesh.vertices_m[:, 2].max(), place.furniture.height)
