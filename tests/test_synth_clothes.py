"""Dressed people: what cloth may do to a body, and how what hangs follows it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from annotate.parts import LEFT_RIGHT, PART_ID
from synth.body.body import pose, volume_m3
from synth.body.crowd import crowd
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture
from synth.clothes.attire import Attire, Hair, Shoes, Skirt, Top, Trousers, draw_attire
from synth.clothes.dress import dress, dress_in, naked, put_down
from synth.clothes.rings import LINED, RING_M
from synth.clothes.skin_map import LEGS, skin_map
from synth.clothes.skirt import HangingSkirt
from synth.clothes.tube import slack_m
from synth.data_files import table

BARE = Hair(dark=0, lift_mm=0, fall=1.4)
TROUSERS = Trousers(dark=0, waist=0.2, hem=1.9, seat_mm=10, hem_mm=40, give=0, folds_mm=0)
JUMPER = Top(dark=0.3, hem=0, sleeve=1.9, body_mm=30, cuff_mm=10, give=0.2, folds_mm=4)
SKIRT = Skirt(dark=0.2, waist=0.2, hem=1.2, ease_mm=10, flare=0.2, folds_mm=4)


def worn(body=0, **attire):
    return dress_in(crowd()[body], Attire((), attire.pop("hair", BARE), **attire), np.random.default_rng(1))


def bent(dressed, **degrees):
    """A posture of the dressed body: vertices with what hangs, and its own alone, in the world."""
    angles = np.zeros((N_JOINTS, 3))
    for name, flexion in degrees.items():
        for side in ("left", "right"):
            angles[JOINT_ID[f"{side}_{name}"], 0] = np.radians(flexion)
    vertices, joints = pose(dressed.body, Posture(angles, np.zeros(3)))
    return dressed.drape(vertices, joints), vertices


@pytest.mark.parametrize("seed", range(8))
def test_a_dressed_body_keeps_all_but_its_skin_and_stands_on_its_soles(seed):
    rng = np.random.default_rng(seed)
    body = crowd()[3 * seed]
    dressed = dress(body, rng)
    for name in ("faces", "face_parts", "bones", "weights", "waist"):
        assert getattr(dressed.body, name) is getattr(body, name)
    assert np.isfinite(dressed.body.vertices_m).all() and abs(dressed.body.vertices_m[:, 2].min()) < 1e-6
    assert volume_m3(dressed.body.vertices_m, body.faces) >= volume_m3(body.vertices_m, body.faces)
    lift = dressed.body.joints_m - body.joints_m
    np.testing.assert_allclose(lift, np.broadcast_to([0, 0, lift[0, 2]], lift.shape), atol=1e-6)
    assert len(dressed.faces) == len(dressed.face_parts) == len(dressed.dark)
    assert dressed.dark.min() >= 0 and dressed.dark.max() <= 1
    drawn = dressed.drape(*pose(dressed.body, Posture.zero()))
    assert len(drawn) == dressed.faces.max() + 1 and np.isfinite(drawn).all()


def test_the_same_numbers_dress_the_same_way_and_a_naked_person_is_the_body():
    assert naked(crowd()[0]).body is crowd()[0]
    one, other = (dress(crowd()[4], np.random.default_rng(9)) for _ in range(2))
    np.testing.assert_array_equal(one.body.vertices_m, other.body.vertices_m)
    np.testing.assert_array_equal(one.faces, other.faces)


def test_a_third_or_a_little_more_wear_little_or_nothing():
    styles = table("clothes")["styles"]
    shares = {name: entry["share"] for name, entry in styles.items()}
    assert 0.3 <= (shares["bare"] + shares["thin"]) / sum(shares.values()) <= 0.4


def test_who_sits_has_put_down_the_bag_and_nothing_else():
    attire = Attire(("jumper", "skirt", "backpack"), BARE, top=JUMPER, skirt=SKIRT, bag="backpack")
    carrying = dress_in(crowd()[1], attire, np.random.default_rng(0))
    without = put_down(carrying)
    rest = carrying.body.vertices_m, carrying.body.joints_m
    at_rest = without.drape(*rest)
    assert [type(piece) for piece in without.pieces] == [HangingSkirt] and len(carrying.pieces) == 2
    assert without.body is carrying.body and put_down(without) is without
    assert without.clothes == ("jumper", "skirt")
    kept = len(without.faces)
    np.testing.assert_array_equal(without.faces, carrying.faces[:kept])
    np.testing.assert_array_equal(without.dark, carrying.dark[:kept])
    np.testing.assert_array_equal(at_rest, carrying.drape(*rest)[: len(at_rest)])


def test_every_number_of_every_garment_is_known():
    rng = np.random.default_rng(2)
    for _ in range(200):
        attire = draw_attire(rng, bags=False)
        worn_ = (attire.hair, attire.top, attire.trousers, attire.skirt, attire.shoes)
        assert attire.bag == "" and all(np.isfinite([*vars(one).values()]).all() for one in worn_ if one)


def test_loose_trousers_hide_the_calf_and_each_leg_keeps_its_side():
    body, dressed = crowd()[2], worn(2, trousers=TROUSERS)
    places = skin_map(body)
    radii = skin_map(dressed.body).limbs.away_m
    ring = [(places.limb == LEGS[0]) & (np.abs(places.along - at) < 0.06) for at in (0.7, 1.05, 1.3, 1.7)]
    outside = places.limbs.out[:, 0] > 0.5
    widths = [radii[own & outside].mean() for own in ring]
    assert np.ptp(widths) < 0.02 < np.ptp([places.limbs.away_m[own & outside].mean() for own in ring])
    for limb, sign in zip(LEGS, (1, -1), strict=True):
        own = places.limb == limb
        inwards = sign * dressed.body.vertices_m[own, 0] < np.minimum(sign * body.vertices_m[own, 0], 0.002)
        assert not inwards.any()


def test_a_tube_hangs_from_the_widest_place_above():
    down = np.repeat(np.linspace(0, 0.4, 21), 48).astype(np.float32)
    around = np.tile(np.linspace(-np.pi, np.pi, 48, endpoint=False), 21).astype(np.float32)
    away = (0.1 - 0.1 * down + 0.03 * (np.abs(down - 0.1) < 0.03)).astype(np.float32)
    everywhere = np.ones(len(down), bool)
    loose, tight = (slack_m((down, around, away), everywhere, give) for give in (0.0, 2.0))
    low = down > 0.3
    np.testing.assert_allclose((away + loose)[low], 0.12, atol=0.006)
    assert tight[low].max() < 0.006 and loose.min() >= 0


def test_shoes_lift_the_body_by_their_soles():
    shoes = Shoes(dark=0, sole_mm=30, upper_mm=5, shaft=1.6, shaft_mm=8)
    body, dressed = crowd()[1], worn(1, shoes=shoes)
    assert dressed.body.joints_m[0, 2] - body.joints_m[0, 2] == pytest.approx(0.03, abs=0.002)


@pytest.mark.parametrize(
    "attire", [{"skirt": SKIRT}, {"top": JUMPER, "bag": "backpack"}, {"top": JUMPER, "bag": "shoulder_bag"}]
)
def test_pieces_are_closed_and_face_outwards(attire):
    dressed = worn(5, **attire)
    (piece,) = dressed.pieces
    edges = piece.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    there = {tuple(edge) for edge in edges.tolist()}
    nodes = dressed.drape(dressed.body.vertices_m, dressed.body.joints_m)[len(dressed.body.vertices_m) :]
    a, b, c = (nodes[piece.faces[:, i]].astype(float) for i in range(3))
    assert np.einsum("ij,ij->", np.cross(a, b), c) > 0
    if attire.get("skirt"):
        assert len(there) == len(edges) and {(b, a) for a, b in there} == there


def test_a_skirts_halves_are_the_legs_beneath():
    dressed = worn(6, skirt=SKIRT)
    first = len(dressed.body.faces)
    vertices = dressed.drape(dressed.body.vertices_m, dressed.body.joints_m)
    x = vertices[dressed.faces[first:]].mean(axis=1)[:, 0]
    for side, sign in (("left", 1), ("right", -1)):
        own = np.isin(
            dressed.face_parts[first:], [PART_ID[f"{side}_upper_leg"], PART_ID[f"{side}_lower_leg"]]
        )
        assert own.sum() > 100 and (sign * x[own] > -0.01).all()


def covered(dressed, edge_m):
    """Faces (F,) of the body inside a skirt at rest, ``edge_m`` from its edges."""
    body, hidden = dressed.body, np.zeros(len(dressed.body.faces), bool)
    middles = body.vertices_m[body.faces].mean(axis=1)
    legs = (body.face_parts >= 7) | (body.face_parts == 2)
    first = len(body.vertices_m)
    nodes = dressed.drape(body.vertices_m, body.joints_m)[first:]
    for piece in dressed.pieces:
        own, nodes = np.split(nodes, [int(piece.faces.max()) + 1])
        if not isinstance(piece, HangingSkirt):
            continue
        edge = np.array([0, 0, edge_m])
        inside = ((middles > own.min(axis=0) + edge) & (middles < own.max(axis=0) - edge)).all(axis=1)
        hidden |= inside & legs
    return hidden


def misplaced(dressed, vertices_m):
    """Faces (F',) of pieces labelled as one limb though the other side's skin is clearly nearer."""
    wrong, body = np.zeros(len(dressed.faces), bool), dressed.body
    middles = vertices_m[dressed.faces].mean(axis=1)
    for pair in LEFT_RIGHT:
        skins = [cKDTree(vertices_m[np.unique(body.faces[body.face_parts == part])]) for part in pair]
        for own, other in ((0, 1), (1, 0)):
            cloth = np.flatnonzero(dressed.face_parts == pair[own])
            cloth = cloth[cloth >= len(body.faces)]
            away = [skin.query(middles[cloth])[0] for skin in skins]
            wrong[cloth] = 1.3 * away[other] + 0.02 < away[own]
    return wrong


@pytest.mark.parametrize("pose_of", [{}, {"hip": 30, "knee": -40}, {"hip": 85, "knee": -90}])
@pytest.mark.parametrize("body", [0, 9, 27])
def test_flesh_stays_inside_a_skirt(body, pose_of):
    dressed = worn(body, skirt=SKIRT)
    draped, own = bent(dressed, **pose_of)
    hidden = np.unique(dressed.body.faces[covered(dressed, LINED * RING_M + 0.05)])
    nodes = draped[len(own) :]
    faces = dressed.pieces[0].faces
    # Winding number of the closed piece about a point: 1 inside, 0 outside.
    some = own[hidden[:: max(1, len(hidden) // 60)]].astype(float)
    a, b, c = (nodes[faces[:, i]].astype(float) - some[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    below = la * lb * lc + lc * (a * b).sum(2) + la * (b * c).sum(2) + lb * (c * a).sum(2)
    winding = np.arctan2(volume, below).sum(axis=1) / (2 * np.pi)
    assert (winding > 0.5).mean() > 0.95
    assert misplaced(dressed, draped).sum() <= 0.02 * len(faces)


def test_cloth_follows_a_body_that_turns_about_the_vertical():
    dressed = worn(8, top=JUMPER, skirt=SKIRT, bag="backpack")
    vertices, joints = pose(dressed.body, Posture.zero())
    turn, shift = Rotation.from_euler("z", 70, degrees=True), np.array([1.0, -2.0, 0.3])
    moved = dressed.drape((turn.apply(vertices) + shift).astype(np.float32), turn.apply(joints) + shift)
    np.testing.assert_allclose(moved, turn.apply(dressed.drape(vertices, joints)) + shift, atol=2e-4)


def test_a_skirt_gives_way_to_a_hand():
    dressed = worn(3, skirt=replace(SKIRT, flare=0.25, ease_mm=30))
    vertices, joints = pose(dressed.body, Posture.zero())
    first, hand = len(vertices), dressed.pieces[0].carrier.arms
    vertices[hand] += 5
    before = dressed.drape(vertices, joints)[first:]
    node = int(np.argmax(before[:, 0]))
    vertices[hand] = before[node]
    pressed = dressed.drape(vertices, joints)[first:]
    assert pressed[node, 0] < before[node, 0] - 0.01
    np.testing.assert_array_equal(pressed[before[:, 0] < 0], before[before[:, 0] < 0])
