"""Baked bodies: what they measure, how they are skinned, what a blend of two is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from annotate.parts import LEFT_RIGHT, NEIGHBOURS, PART_ID, PARTS
from sensors.errors import CloudError, FormatError
from sensors.files.npz import array_sizes
from synth.body.body import blend, load_body, pose, save_body, shipped_bodies, volume_m3
from synth.body.body_picture import picture
from synth.body.body_table import PAPER_BODIES, describe, read_sizes
from synth.body.part_border import SNAP_M, borders, cut_into_parts
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, alignment

MEASURES = ("height_cm", "weight_kg", "waist_breadth_cm")
HARMONICS, SMOOTH_M = 4, 0.0015


@pytest.mark.parametrize("number", range(8))
def test_shipped_bodies_measure_what_table_1_says(number):
    body, size = shipped_bodies()[number], PAPER_BODIES[number]
    assert body.name == size.name
    for measure in MEASURES:
        assert abs(getattr(body, measure) - getattr(size, measure)) <= 0.05


def test_all_bodies_share_one_topology():
    first = shipped_bodies()[0]
    for body in shipped_bodies()[1:]:
        for name in ("faces", "face_parts", "bones", "weights", "waist"):
            np.testing.assert_array_equal(getattr(body, name), getattr(first, name))
    np.testing.assert_allclose(first.weights.sum(axis=1), 1, atol=1e-6)
    assert first.weights.min() >= 0


def test_every_part_is_one_patch_of_skin():
    body = shipped_bodies()[0]
    # Eyes, teeth and tongue are closed surfaces of their own inside the head.
    skin = _patches(body.faces) == _patches(body.faces)[0]
    assert skin.mean() > 0.95
    for part in PARTS[1:]:
        faces = body.faces[skin & (body.face_parts == part.id)]
        assert len(np.unique(_patches(faces))) == 1, part.name
    assert set(body.face_parts[~skin]) == {PART_ID["head"]}


def test_parts_meet_where_anatomy_joins_them_and_nowhere_else():
    body = shipped_bodies()[0]
    assert set(_border_vertices(body.faces, body.face_parts)) == NEIGHBOURS


@pytest.mark.parametrize("number", range(8))
def test_parts_are_symmetric_and_their_borders_smooth_curves(number):
    """A few harmonics around the limb describe a smooth border; one along whole faces jumps by a cm."""
    body = shipped_bodies()[number]
    area = _areas_m2(body.vertices_m.astype(float), body.faces)
    for left, right in LEFT_RIGHT:
        ours, theirs = (area[body.face_parts == part].sum() for part in (left, right))
        assert ours == pytest.approx(theirs, rel=0.03)
    for pair, vertices in _border_vertices(body.faces, body.face_parts).items():
        points = body.vertices_m[vertices].astype(float)
        points -= points.mean(axis=0)
        along, up, across = (points @ np.linalg.svd(points, full_matrices=False)[2].T).T
        angle = np.arctan2(up / up.std(), along / along.std())[:, None] * np.arange(HARMONICS + 1)
        waves = np.hstack([np.cos(angle), np.sin(angle[:, 1:])])
        rest = across - waves @ np.linalg.lstsq(waves, across, rcond=None)[0]
        assert rest.std() < SMOOTH_M, pair


@given(pair=st.permutations(range(8)), share=st.floats(0, 1))
@settings(max_examples=20, deadline=None)
def test_a_blend_measures_something_in_between(pair, share):
    a, b = (shipped_bodies()[i] for i in pair[:2])
    blended = blend(a, b, share)
    for measure in MEASURES:
        low, high = sorted((getattr(a, measure), getattr(b, measure)))
        # Lengths mix linearly; a volume is cubic in the shape and may leave the line a little.
        slack = 1.0 if measure == "weight_kg" else 0.35
        assert low - slack <= getattr(blended, measure) <= high + slack
    np.testing.assert_array_equal(blend(a, b, 0).vertices_m, a.vertices_m)
    np.testing.assert_array_equal(blend(a, b, 1).joints_m, b.joints_m)


def test_at_zero_angles_the_skin_is_the_linear_blend_of_the_aligned_bones():
    body, pelvis = shipped_bodies()[2], np.array([0.3, -0.2, 1.1])
    vertices, joints = pose(body, Posture(np.zeros((N_JOINTS, 3)), pelvis))
    np.testing.assert_allclose(joints[0], pelvis, atol=1e-12)
    frames = alignment(body.joints_m)
    moved = np.einsum("jab,jvb->jva", frames, body.vertices_m - body.joints_m[:, None]) + joints[:, None]
    expected = sum(
        body.weights[:, k, None] * moved[body.bones[:, k], np.arange(len(body.vertices_m))] for k in range(4)
    )
    np.testing.assert_allclose(vertices, expected, atol=2e-6)


def test_a_body_moved_rigidly_keeps_its_shape():
    body = shipped_bodies()[5]
    angles = np.zeros((N_JOINTS, 3))
    still, _ = pose(body, Posture(angles, np.zeros(3)))
    angles[JOINT_ID["pelvis"]] = (0.4, -0.7, 1.9)
    moved, _ = pose(body, Posture(angles, np.array([1.0, 2.0, 3.0])))
    pairs = np.random.default_rng(0).integers(0, len(still), (500, 2))
    before, after = (np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1) for v in (still, moved))
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_a_saved_body_comes_back_the_same(tmp_path, monkeypatch):
    body = shipped_bodies()[1]
    save_body(tmp_path / "me.npz", body)
    monkeypatch.setattr("synth.body.body.MAX_BYTES", sum(array_sizes(tmp_path / "me.npz", "").values()))
    again = load_body(tmp_path / "me.npz")
    assert again.name == "me"
    for name, value in vars(replace(body, name="me")).items():
        np.testing.assert_array_equal(getattr(again, name), value)


def test_what_is_no_body_is_refused(tmp_path):
    path = tmp_path / "bad.npz"
    body = shipped_bodies()[0]
    for make, refused, message in (
        (lambda: path.write_bytes(b"PK\x03\x04 no archive"), lambda: load_body(path), "cannot be read"),
        (lambda: np.savez_compressed(path, a=np.zeros((4000, 4000))), lambda: load_body(path), "unpacks to"),
        (lambda: np.savez(path, vertices_m=np.zeros((3, 3))), lambda: load_body(path), "cannot be read"),
        (lambda: None, lambda: replace(body, faces=body.faces + 1), "exceed its vertices"),
        (lambda: None, lambda: replace(body, weights=body.weights[:, :3]), "weights"),
    ):
        make()
        with pytest.raises(FormatError, match=message):
            refused()


@cache
def _cut_afresh():
    """A body cut anew, from its own skin without parts: (vertices, joints, cut skin)."""
    body = shipped_bodies()[4]
    by_joint = np.zeros((len(body.vertices_m), N_JOINTS), np.float32)
    np.add.at(by_joint, (np.arange(len(by_joint))[:, None], body.bones), body.weights)
    vertices = body.vertices_m.astype(float)
    # Nudged, so that borders pass beside the vertices that an earlier cut put on them.
    vertices += (0, 0.004, 0.007)
    return vertices, body, cut_into_parts(vertices, body.faces, body.joints_m, by_joint)


def test_a_cut_changes_neither_area_nor_volume():
    vertices, body, skin = _cut_afresh()
    cut = skin.recipe @ vertices
    assert len(cut) > len(vertices) + 100
    np.testing.assert_array_equal(cut[: len(vertices)], vertices)
    assert volume_m3(cut, skin.faces) == pytest.approx(volume_m3(vertices, body.faces), rel=1e-9)
    assert _areas_m2(cut, skin.faces).sum() == pytest.approx(_areas_m2(vertices, body.faces).sum(), rel=1e-9)
    edges = np.sort(skin.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}


def test_the_cut_runs_along_the_levels():
    vertices, body, skin = _cut_afresh()
    cut = skin.recipe @ vertices
    found = _border_vertices(skin.faces, skin.face_parts)
    assert set(found) == NEIGHBOURS
    for border in borders(vertices, body.joints_m):
        on = found[frozenset((border.before, border.beyond))]
        assert len(on) > 15
        # Beside a vertex nearer than SNAP_M the border goes through it; a level is steeper than 2 nowhere.
        assert np.abs(border.level(cut[on])).max() <= 2 * SNAP_M


def _areas_m2(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _patches(faces):
    """Per face the number of the patch it hangs together with over edges."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    of = np.unique(edges, axis=0, return_inverse=True)[1].reshape(-1)
    n, face = len(faces), np.repeat(np.arange(len(faces)), 3)
    joined = coo_array((np.ones(len(of)), (face, n + of)), shape=(n + of.max() + 1,) * 2)
    return connected_components(joined, directed=False)[1][:n]


def _border_vertices(faces, parts):
    """Vertices on edges between two parts, by the pair."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    ends, part = edges[order].reshape(-1, 2, 2)[:, 0], np.repeat(parts, 3)[order].reshape(-1, 2)
    between = np.flatnonzero(part[:, 0] != part[:, 1])
    pairs = {frozenset(map(int, pair)) for pair in part[between]}
    return {
        pair: np.unique(ends[[i for i in between if frozenset(map(int, part[i])) == pair]]) for pair in pairs
    }


def test_the_paper_bodies_as_csv_come_back_and_are_described(tmp_path):
    path, body = tmp_path / "sizes.csv", shipped_bodies()[0]
    row = describe(body, PAPER_BODIES[0])
    assert (row["model"], row["asked_weight_kg"]) == ("body_0", 36.6)
    assert row["height_cm"] == pytest.approx(row["asked_height_cm"], abs=0.05)
    assert not any("asked" in key for key in describe(body, None))
    rows = [f"{s.name},{s.height_cm},{s.weight_kg},{s.waist_breadth_cm}" for s in PAPER_BODIES]
    path.write_text("\n".join([",".join(("name", *MEASURES)), *rows]), encoding="utf-8")
    assert read_sizes(path) == PAPER_BODIES


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ("a,170,60", "is not a table"),
        ("a,170,sixty,26", "is not a table"),
        ("", "has no bodies"),
        ("a,170,60,26\nA,171,61,27", "two bodies named a"),
        ("../a,170,60,26", "letters, digits"),
        *((f"{name},170,60,26", "letters, digits") for name in (".a", "a/b", "a\\b", "ä", "a" * 65, "<b>")),
        ("a,1700,60,26", "height_cm 1700.0 is impossible"),
        ("a,170,nan,26", "weight_kg nan is impossible"),
    ],
)
def test_what_is_no_table_of_bodies_is_refused_in_one_line(tmp_path, rows, why):
    path = tmp_path / "sizes.csv"
    path.write_text(f"name,{','.join(MEASURES)}\n{rows}", encoding="utf-8")
    with pytest.raises(CloudError, match=why) as caught:
        read_sizes(path)
    assert "\n" not in str(caught.value)


def test_the_picture_shows_every_part_from_both_sides():
    image = picture(shipped_bodies()[:2])
    front, back = image[:390], image[390:780]
    for view in (front, back):
        shown = view.reshape(-1, 3).astype(float)
        for part in PARTS[1:]:
            # Shading scales a colour and keeps its direction.
            rgb = np.array(part.rgb) / np.linalg.norm(part.rgb)
            likeness = shown @ rgb / np.maximum(np.linalg.norm(shown, axis=1), 1)
            assert (likeness > 0.999).sum() > 100, part.name
