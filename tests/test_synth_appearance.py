"""Colour camera: a suit keeps its colours, light has shadows, faults are as stated."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from annotate.parts import NEIGHBOURS
from annotate.scheme.regions import Region
from annotate.suit.palette import DEFAULT_SUIT
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose
from synth.appearance.color_camera import (
    GREY,
    RESTING,
    CameraFaults,
    CameraState,
    adjusted,
    develop,
    first_state,
    metered,
    smear,
)
from synth.appearance.lighting import CHEST_M, PLACES, Lighting, illuminate, light_room, white_rgb
from synth.appearance.outfit import PLAIN, Outfit, Wear, dress, dress_plainly
from synth.appearance.paint import Surfaces, paint
from synth.appearance.pattern import FACE, FIRST_SEAM, FOOT, HAND, N_ZONES, SKIN
from synth.appearance.photograph import CLEAN, HARD, NORMAL, ColorCamera, ColorDifficulty, plain_room, set_up
from synth.appearance.random_suit import random_suit
from synth.body.body import Body, shipped_bodies
from synth.surface.facets import noise_tile, smooth_noise
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box, look_at, merge, rasterize, sheet
from synth.surface.room import PLAIN_ROOM

CAMERA = Intrinsics(640, 480, 480.0, 480.0, 319.5, 239.5)
MAPS = tuple(m.astype(np.float32) for m in np.meshgrid(np.arange(640), np.arange(480)))
FRONT = look_at(np.array([0.0, -2.6, 1.2]), np.array([0.0, 0.0, 0.85]))
ABOVE = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.0]))
"""Straight down from 2 m: image x is world x, image y is world -y."""


def standing(body: Body) -> Mesh:
    person = Mesh(body.vertices_m, body.faces, body.face_parts.astype(np.int32))
    return merge([person, PLAIN_ROOM.mesh(1.0)])


def photographs(
    color: ColorDifficulty, seed: int, number: int = 1, velocity_m_s: np.ndarray | None = None
) -> list[bytes]:
    body, rng = shipped_bodies()[2], np.random.default_rng(seed)
    outfit = dress(body, DEFAULT_SUIT, color.wear, rng)
    camera = ColorCamera(CAMERA, MAPS, FRONT, set_up(color, DEFAULT_SUIT, rng), color.camera)
    return [camera.photograph(standing(body), [outfit], rng, velocity_m_s) for _ in range(number)]


def decoded(jpeg: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def parts_seen() -> np.ndarray:
    scene = standing(shipped_bodies()[2])
    seen = rasterize(CAMERA, FRONT.apply(scene.vertices_m).astype(np.float32), scene.faces)
    return np.where(seen.face >= 0, scene.tags[seen.face], 0)


def painted(scene: Mesh, outfits: list[Outfit], camera: Intrinsics = CAMERA, pose: Pose = ABOVE) -> Surfaces:
    seen = rasterize(camera, pose.apply(scene.vertices_m).astype(np.float32), scene.faces)
    return paint(seen, (camera, pose), scene, outfits, plain_room())


def test_a_clean_photograph_shows_the_suit_as_it_is():
    image, parts = decoded(photographs(CLEAN, 0)[0]).astype(int), parts_seen()
    for part in range(1, 12):
        inside = cv2.erode((parts == part).astype(np.uint8), np.ones((7, 7))) > 0
        assert inside.sum() > 20
        swatch = DEFAULT_SUIT.colors_rgb[DEFAULT_SUIT.parts == part][0].astype(int)
        assert np.abs(np.median(image[inside], axis=0) - swatch).max() <= 4


@pytest.mark.parametrize("color", [CLEAN, NORMAL, HARD])
def test_the_same_seed_gives_the_same_photographs(color):
    velocity = np.full((100, 3), 0.5)
    velocity = np.concatenate([velocity, np.zeros((len(standing(shipped_bodies()[2]).vertices_m) - 100, 3))])
    first, again = (photographs(color, 3, 2, velocity) for _ in range(2))
    assert first == again
    if color is not CLEAN:
        assert photographs(color, 4, 2, velocity) != first


def test_colour_is_exposed_when_it_is_and_not_with_the_depth():
    body, scene, rng = shipped_bodies()[2], standing(shipped_bodies()[2]), np.random.default_rng(0)
    outfit = dress(body, DEFAULT_SUIT, CLEAN.wear, rng)
    setting = replace(set_up(CLEAN, DEFAULT_SUIT, rng), offset_s=0.017)
    velocity = np.zeros((len(scene.vertices_m), 3))
    velocity[: len(body.vertices_m)] = (1.5, 0.0, 0.5)
    moved = Mesh((scene.vertices_m + 0.017 * velocity).astype(np.float32), scene.faces, scene.tags)
    then, there = (
        ColorCamera(CAMERA, MAPS, FRONT, setting, CLEAN.camera).photograph(shown, [outfit], rng, speed)
        for shown, speed in ((scene, velocity), (moved, None))
    )
    assert then == there
    assert then != photographs(CLEAN, 0)[0]


@pytest.mark.parametrize("color", [CLEAN, NORMAL, HARD])
def test_nothing_is_photographed_as_nothing(color):
    rng = np.random.default_rng(0)
    nothing = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros(0, np.int32))
    camera = ColorCamera(CAMERA, MAPS, FRONT, set_up(color, DEFAULT_SUIT, rng), color.camera)
    image = decoded(camera.photograph(nothing, [], rng, np.zeros((0, 3))))
    assert image.shape == (480, 640, 3)
    assert image.mean() < 12


def slab() -> Mesh:
    """A floor at z = 0 under a slab half a metre above it, seen from above."""
    floor = sheet(np.array([-2.0, -2, 0]), np.array([4.0, 0, 0]), np.array([0, 4.0, 0]), Surface.FLOOR)
    return merge([floor, box((-0.2, -0.2, 0.5), (0.2, 0.2, 0.55), Surface.TABLE)])


def test_light_falls_off_as_it_should_and_a_shadow_is_dark():
    """A point lamp: E = E_chest d_chest^2 cos / d^2 in the open; ambient alone in the umbra."""
    scene, lamp = slab(), np.array([1.0, 0.0, 2.0])
    lighting = Lighting(np.tile(lamp, (1, PLACES, 1)), np.array([[0.8, 0.6, 0.4]]), np.full(3, 0.1), 0.3)
    surfaces = painted(scene, [])
    light = illuminate(surfaces, scene, lighting) / np.maximum(surfaces.albedo, 1e-6)
    at = surfaces.point_m
    # The slab's shadow lies where the line to the lamp passes it, at x = -1/3.
    umbra = (np.abs(at[..., 0] + 1 / 3) < 0.15) & (np.abs(at[..., 1]) < 0.15) & (at[..., 2] < 0.01)
    umbra &= np.abs(at[..., 0]) > 0.25
    assert umbra.sum() > 50
    assert light[umbra].max() < 0.11
    open_ = (np.abs(at[..., 0] - 0.8) < 0.1) & (np.abs(at[..., 1]) < 0.3)
    away2 = ((lamp - at) ** 2).sum(axis=-1)
    direct = ((CHEST_M - lamp) ** 2).sum() * 2.0 / away2**1.5
    np.testing.assert_allclose(light[open_], (direct[open_, None] * lighting.rgb) + 0.1, atol=0.05)


def test_cold_light_is_blue_warm_light_red_and_daylight_white():
    np.testing.assert_allclose(white_rgb(6504), 1, atol=0.05)
    ratio = [white_rgb(k)[0] / white_rgb(k)[2] for k in (2000, 2700, 3500, 5000, 6500, 9000)]
    assert (np.diff(ratio) < 0).all()


@pytest.mark.parametrize("mean", [(0.02, 0.02, 0.02), (1.0, 0.8, 0.5), (0.2, 0.3, 0.4)])
def test_exposure_and_balance_settle_on_grey(mean):
    faults, rng = CameraFaults(balanced=1.0), np.random.default_rng(0)
    state, errors = RESTING, []
    for _ in range(40):
        state = adjusted(state, np.array(mean), faults, rng)
        errors.append(abs(np.log(np.mean(mean) * state.exposure / GREY)))
    assert errors[-1] < 1e-3
    assert (np.diff(errors) <= 1e-12).all()
    balanced = np.array(mean) * state.balance
    np.testing.assert_allclose(balanced, balanced[1], rtol=1e-3)


def test_exposure_and_balance_wander_as_far_as_stated():
    faults, rng = CameraFaults(balanced=1.0, exposure_sd=0.2, balance_sd=0.05), np.random.default_rng(0)
    state, drift = first_state(np.full(3, 0.3), faults, rng), []
    for _ in range(4000):
        state = adjusted(state, np.full(3, 0.3), faults, rng)
        drift.append(state.drift)
    np.testing.assert_allclose(np.std(drift, axis=0), (0.05, 0.2, 0.05), rtol=0.2)


def test_dim_light_is_bought_with_time_and_then_with_gain():
    states = [CameraState(exposure, np.ones(3), np.zeros(3)) for exposure in (0.5, 1, 2, 8)]
    assert [s.exposure_s for s in states] == sorted(s.exposure_s for s in states)
    assert states[0].gain == states[1].gain == 1
    for state in states:
        assert state.exposure_s <= 1 / 30
        assert state.exposure_s * state.gain == pytest.approx(states[1].exposure_s * state.exposure)


def test_meter_ignores_a_lamp():
    light = np.full((80, 80, 3), 0.2, np.float32)
    light[:16, :16] = 50
    assert metered(light).max() < 0.25


@pytest.mark.parametrize("rgb", [(0.5, 0.1, 0.05), (0.05, 0.4, 0.1), (0.02, 0.1, 0.6)])
def test_the_mosaic_keeps_colours(rgb):
    light = np.full((64, 64, 3), rgb, np.float32)
    faults = CameraFaults(noise=1e-9)
    plain = develop(light, RESTING, CameraFaults(), np.random.default_rng(0))
    mosaic = develop(light, RESTING, faults, np.random.default_rng(0))
    assert np.abs(mosaic[4:-4, 4:-4].astype(int) - plain[4:-4, 4:-4]).max() <= 1


def test_noise_grows_with_gain_as_photons_do():
    light = np.full((400, 400, 3), 0.05, np.float32)
    spread = []
    for gain in (1, 4):
        dim = replace(RESTING, exposure=4.0 * gain)
        image = develop(light / gain, dim, CameraFaults(noise=1.0), np.random.default_rng(0))
        spread.append(np.power(image[::2, 1::2, 1] / 255, 2.2).std())
    assert spread[1] / spread[0] == pytest.approx(2, rel=0.1)


def test_what_moves_is_smeared_along_its_way_and_loses_no_light():
    light = np.zeros((60, 120, 3), np.float32)
    face = np.zeros((60, 120), np.int32) - 1
    light[20:40, 50:70], face[20:40, 50:70] = 1, 0
    flow = np.array([(16.0, 0.0), (0.0, 0.0)], np.float32)
    blurred = smear(light, face, flow)
    np.testing.assert_array_equal(blurred[:19], 0)
    row = blurred[30, :, 0]
    assert row.sum() == pytest.approx(20, rel=0.1)
    assert row[60] == 1
    assert 0.3 < row[50] < 0.7
    assert ((row > 0.02) & (row < 0.98)).sum() == pytest.approx(32, abs=6)
    np.testing.assert_array_equal(smear(light, face, flow / 100), light)


def cloth_sheet(seam_sd_m: float, place_m: np.ndarray) -> tuple[Mesh, Outfit]:
    """A metre of cloth, one zone left and another right of x = 0."""
    flat = sheet(np.array([-0.5, -0.5, 0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 1)
    left = flat.vertices_m[flat.faces][..., 0].mean(axis=1) < 0
    regions = np.where(left, Region.CHEST, Region.HIP).astype(np.uint8)
    torso, hip = PLAIN.zone_of_region[[Region.CHEST, Region.HIP]].tolist()
    fields = np.full((len(flat.vertices_m), PLAIN.n_fields), -1, np.float32)
    fields[:, FIRST_SEAM + PLAIN.seams.index((torso, hip))] = flat.vertices_m[:, 0]
    fields[:, [n for n, pair in enumerate(PLAIN.seams, FIRST_SEAM) if pair[1] == torso]] = 1
    zones = np.zeros((N_ZONES, 3))
    zones[hip] = 1
    rest = flat.vertices_m + place_m.astype(np.float32)
    return flat, Outfit(PLAIN, regions, rest, fields, np.zeros(len(rest), np.float32), zones, seam_sd_m, 0.0)


def test_a_seam_strays_by_the_stated_distance():
    camera, rng, offsets = Intrinsics(800, 800, 1600.0, 1600.0, 399.5, 399.5), np.random.default_rng(0), []
    for _ in range(12):
        flat, outfit = cloth_sheet(0.01, rng.uniform(0, 20, 3))
        albedo = painted(flat, [outfit], camera).albedo[..., 0]
        offsets.append(0.5 - albedo[20:-20].mean(axis=1) / 1.0)
    assert np.std(offsets) == pytest.approx(0.01, rel=0.25)
    assert abs(np.mean(offsets)) < 0.004
    # Smooth: neighbouring rows, 1.25 mm apart, hardly differ.
    assert np.quantile(np.abs(np.diff(offsets, axis=1)), 0.99) < 0.003


def test_hands_faces_and_feet_are_bare_and_no_more():
    body = shipped_bodies()[3]
    outfit = dress(body, DEFAULT_SUIT, NORMAL.wear, np.random.default_rng(1))
    area = np.linalg.norm(
        np.cross(*(body.vertices_m[body.faces[:, i]] - body.vertices_m[body.faces[:, 0]] for i in (1, 2))),
        axis=1,
    )
    fields = outfit.fields_m[body.faces].mean(axis=1)
    bare = ((HAND, (5, 6), 0.3, 0.65), (FOOT, (10, 11), 0.2, 0.5), (FACE, (1,), 0.1, 0.6))
    for field, parts, least, most in bare:
        own = np.isin(body.face_parts, parts)
        share = area[own & (fields[:, field] > 0)].sum() / area[own].sum()
        assert least < share < most


def test_skin_covers_the_human_range():
    body = shipped_bodies()[0]
    skin = [dress_plainly(body, Wear(), np.random.default_rng(s)).zone_rgb[SKIN] for s in range(25)]
    luminance = np.array(skin) @ (0.2126, 0.7152, 0.0722)
    assert luminance.min() < 0.06
    assert luminance.max() > 0.6
    assert (np.array(skin)[:, 0] > np.array(skin)[:, 2]).all()


def test_noise_is_unit_smooth_and_seamless():
    def noise_at(places: np.ndarray) -> np.ndarray:
        return np.array([smooth_noise(noise_tile(), *place) for place in places])

    places = np.random.default_rng(0).uniform(-500, 500, (20_000, 3))
    values = noise_at(places)
    assert abs(values.mean()) < 0.05
    assert values.std() == pytest.approx(1, abs=0.06)
    np.testing.assert_allclose(noise_at(places + 64), values, atol=1e-6)


def test_rooms_differ_in_their_light_and_hard_ones_are_dim():
    def level(lighting: Lighting) -> float:
        return float(lighting.rgb.sum(axis=0).mean() + lighting.ambient.mean())

    normal, hard = (
        [level(light_room(spread, np.random.default_rng(seed))) for seed in range(40)]
        for spread in (NORMAL.light, HARD.light)
    )
    assert np.median(hard) < 0.2 * np.median(normal)
    assert len(set(normal)) == 40


def test_random_suits_are_whole_differ_by_seed_and_part_neighbours_by_colour():
    suits = [random_suit(seed) for seed in range(30)]
    for seed, suit in enumerate(suits):
        again = random_suit(seed)
        np.testing.assert_array_equal(again.colors_rgb, suit.colors_rgb)
        worn = {int(part): tuple(rgb) for part, rgb in zip(suit.parts[:11], suit.colors_rgb, strict=False)}
        assert 8 <= len(set(worn.values())) <= 11
        assert all(worn[a] != worn[b] for a, b in map(tuple, NEIGHBOURS))
    assert len({suit.colors_rgb.tobytes() for suit in suits}) == len(suits)
    assert 0 < sum(bool(suit.look_alikes) for suit in suits) < len(suits)
