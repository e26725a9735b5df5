"""Furniture and cameras."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from synth.body.body import volume_m3
from synth.data_files import TRAINING
from synth.images.viewpoints import overhead_place
from synth.surface.furniture import FLOOR, Bed, Chair, Ground, Sofa, Solid, Surface
from synth.surface.furniture_variation import vary_bed, vary_chair, vary_sofa
from synth.surface.judge_furniture import draw_bed, draw_chair, draw_sofa
from synth.surface.rasterize import box, look_at, merge, sheet
from synth.surface.varied_furniture import Bars

FURNITURE = [Sofa(), Chair(), Bed()]


def test_boxes_and_sheets_have_their_volume_and_area_and_merge_keeps_faces_and_tags():
    a, b = box((0, -1, 2), (2, 0.5, 3), Surface.TABLE), box((2, 0, 0), (3, 1, 1), 7)
    assert volume_m3(a.vertices_m, a.faces) == pytest.approx(2 * 1.5 * 1)
    both = merge([a, b])
    np.testing.assert_array_equal(both.vertices_m[both.faces[12:]], b.vertices_m[b.faces])
    assert both.tags.tolist() == [Surface.TABLE] * 12 + [7] * 12
    mesh = sheet(np.zeros(3), np.array([2.0, 0, 0]), np.array([0, 1.1, 0]), Surface.FLOOR)
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(2.2, rel=1e-5)


@given(
    angles=st.tuples(*[st.floats(-3, 3)] * 3),
    place=st.tuples(*[st.floats(-2, 2)] * 3),
    point=st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_a_solids_depth_is_that_of_its_box_wherever_it_stands(angles, place, point):
    turn, low, high = Rotation.from_euler("xyz", angles).as_matrix(), (-0.5, -0.4, -0.3), (0.5, 0.4, 0.3)
    solid = Solid(low, high, 0.0, Surface.SOFA, turn, np.array(place))
    world = np.array(place) + turn @ np.array(point)
    expected = max(0.0, min(h - abs(p) for h, p in zip(high, point, strict=True)))
    assert solid.depth_m(world[None]) == pytest.approx(expected, abs=1e-9)
    packed = solid.packed()
    assert np.allclose(packed[:3], place) and np.allclose(packed[3:6], high)
    assert np.allclose(packed[8:].reshape(3, 3), turn)


@pytest.mark.parametrize("furniture", FURNITURE, ids=lambda f: type(f).__name__)
def test_what_a_camera_sees_of_furniture_is_what_stops_a_limb(furniture):
    mesh, solids = furniture.mesh(), furniture.solids()
    assert len(mesh.faces) == 12 * len(solids)
    assert (mesh.vertices_m[:, 2] >= -1e-6).all()
    # Every corner lies on the surface of its own solid.
    for i, solid in enumerate(solids):
        corners = mesh.vertices_m[8 * i : 8 * i + 8]
        assert solid.depth_m(corners).max() < 1e-6
        assert solid.depth_m(corners.mean(axis=0)[None])[0] > 0.005


@given(seed=st.integers(0, 2**32 - 1))
def test_sampled_furniture_has_the_sizes_of_furniture(seed):
    rng = np.random.default_rng(seed)
    sofa, chair, bed = Sofa.sample(rng), Chair.sample(rng), Bed.sample(rng)
    assert 0.35 < sofa.height < 0.5 and 0.4 <= chair.height <= 0.5
    assert 1.9 < bed.length < 2.2 and 0.8 < bed.width < 1.7 and 0.3 < bed.height < 0.8
    assert np.ptp(bed.mesh().vertices_m[:, 1]) == pytest.approx(bed.length + 0.05, abs=1e-5)


VARIED = {vary_bed: Bed, vary_sofa: Sofa, vary_chair: Chair}


@pytest.mark.parametrize("vary", VARIED, ids=lambda vary: vary.__name__)
@given(seed=st.integers(0, 2**32 - 1))
def test_varied_furniture_stands_on_the_floor_inside_its_footprint_and_solids(vary, seed):
    rng = np.random.default_rng(seed)
    furniture = vary(VARIED[vary].sample(rng), rng)
    half, front, back = furniture.footprint
    points = furniture.mesh().vertices_m
    assert points[:, 2].min() >= -1e-6 and np.abs(points[:, 0]).max() <= half + 1e-6
    assert front - 1e-6 <= points[:, 1].min()
    for solid in furniture.solids():
        low, high = np.array(solid.low), np.array(solid.high)
        mesh = solid.mesh().vertices_m
        local = (mesh - solid.translation) @ solid.rotation
        assert (high > low).all() and (local >= low - 1e-4).all() and (local <= high + 1e-4).all()
        leans = solid.rotation[1, 1] < 1
        assert leans or mesh[:, 1].max() <= back + 1e-6


@given(seed=st.integers(0, 2**32 - 1))
def test_fences_and_cushions_stay_at_their_furniture(seed):
    rng = np.random.default_rng(seed)
    bed, sofa = (vary(VARIED[vary].sample(rng), rng) for vary in (vary_bed, vary_sofa))
    points = bed.mesh().vertices_m
    assert np.abs(points[:, 1]).max() <= bed.length / 2 + 0.05 + 1e-6
    assert bed.top.half_width_m == bed.width / 2 and -bed.top.front_y == bed.length / 2
    cushions = [one for one in sofa.solids()[4:] if one.tag == Surface.PILLOW]
    assert all(abs(x) <= sofa.width / 2 for one in cushions for x in (one.low[0], one.high[0]))
    assert len(sofa.cleared().solids()) == len([one for one in sofa.solids() if not beside(one, sofa)])


def beside(solid, sofa):
    """Return whether a solid is a cushion or a stool of a varied sofa."""
    return solid.tag == Surface.PILLOW or solid.high[1] < 0


def test_training_draws_varied_furniture_and_some_plain_ones_and_no_other_number_changes():
    for draw, plain in ((draw_bed, Bed), (draw_sofa, Sofa), (draw_chair, Chair)):
        one, other = np.random.default_rng(3), np.random.default_rng(3)
        drawn = [type(draw(TRAINING, one)) for _ in range(60)]
        assert 5 < sum(kind is plain for kind in drawn) < 40
        for _ in range(60):
            plain.sample(other)
        assert one.bit_generator.state == other.bit_generator.state


def test_bars_are_gaps_to_the_eye_and_a_board_to_a_limb():
    bars = Bars((0, -0.02, 0.5), (1, 0.02, 1.0), 0.0, Surface.WOOD, horizontal=2, upright=5)
    points, faces = bars.mesh().vertices_m, bars.mesh().faces
    assert len(faces) == 7 * 12 and volume_m3(points, faces) < 0.4 * 1.0 * 0.04 * 0.5
    assert bars.depth_m(np.array([[0.1, 0.0, 0.75]], np.float32))[0] == pytest.approx(0.02, abs=1e-6)


def test_the_ground_is_the_floor_and_floor_stops_everything():
    assert Ground().solids() == [] and np.ptp(Ground().mesh().vertices_m[:, 2]) == 0
    assert FLOOR.depth_m(np.array([[3.0, -2.0, -0.25]]))[0] == pytest.approx(0.25)


@given(eye=st.tuples(*[st.floats(-3, 3)] * 3), roll=st.floats(-1, 1))
def test_a_camera_looks_where_it_should(eye, roll):
    target = np.array([0.1, 0.2, 5.0])
    camera_from_world = look_at(np.array(eye), target, roll)
    seen = camera_from_world.apply(target[None])[0]
    assert np.allclose(seen[:2], 0, atol=1e-9) and seen[2] > 0
    assert np.allclose(camera_from_world.apply(np.array([eye]))[0], 0, atol=1e-9)


def test_recumbent_cameras_stand_all_around_at_several_heights():
    rng, centre = np.random.default_rng(0), np.array([0.1, -0.2, 0.5])
    eyes = np.array([overhead_place(rng, centre)[0] for _ in range(4000)])
    off = eyes - centre
    azimuth = np.histogram(np.arctan2(off[:, 0], off[:, 1]), 12, (-np.pi, np.pi))[0]
    assert azimuth.min() > 0.7 * 4000 / 12
    assert (np.histogram(eyes[:, 2], [0.7, 1.0, 1.35, 1.9, 2.4])[0] > 300).all()
    assert (off[:, 2] >= 0.3 - 1e-9).all()
    distance = np.hypot(off[:, 0], off[:, 1])
    assert distance.min() > 1.1 and distance.max() < 2.7
