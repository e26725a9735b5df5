"""The crowd, MakeHuman's base mesh about it, and garments from files."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sensors.errors import CloudError, FormatError
from synth.body.body import blend, shipped_bodies
from synth.body.crowd import BASE_VERTICES, base_mesh_m, crowd
from synth.clothes.makehuman_garments import choose, kind_of, read_garment, read_garments, wear
from synth.images.generate import Order
from synth.images.people import Wardrobe
from synth.images.presets import PRESETS, dressed_from

GARMENTS = Path(__file__).parents[2] / "shared/data/garments"
SCALES = "x_scale 5399 11998 1.4\nz_scale 962 5320 1.9\ny_scale 791 881 2.3\n"
ROWS = "10\n20 30 40 0.2 0.3 0.5 0 0 0\n50 60 70 1 0 0 0 0 0.1\n"


def write_garment(folder: Path, head="basemesh hm08\n", rows=ROWS, faces="f 1 2 3\n", obj="rag.obj") -> Path:
    (folder / "rag.obj").write_text("v 0 0 0\n" + faces)
    path = folder / "rag.mhclo"
    path.write_text(
        f"# rag\n{head}{SCALES}obj_file {obj}\nverts 0\nmaterial m\n{rows}\ndelete_verts\n3 - 5 9\n"
    )
    return path


def test_the_crowd_is_of_all_builds_on_one_mesh():
    like, people = shipped_bodies()[0], crowd()
    heights = np.array([body.height_cm for body in people])
    bmi = np.array([body.weight_kg for body in people]) / (heights / 100) ** 2
    assert len(people) == 28 and heights.min() >= 149.9 and heights.max() <= 195
    assert bmi.min() < 17.1 and bmi.max() > 37.9 and (bmi < 25).sum() in range(10, 19)
    for body in people:
        assert np.array_equal(body.faces, like.faces) and abs(body.vertices_m[:, 2].min()) < 2e-4


def test_the_base_mesh_of_two_blended_is_their_base_meshes_blended():
    one, other = crowd()[3], crowd()[10]
    both = base_mesh_m(blend(one, other, 0.3))
    expected = 0.7 * base_mesh_m(one) + 0.3 * base_mesh_m(other)
    assert both.shape == (BASE_VERTICES, 3) and np.abs(both - expected).max() < 5e-4


def test_a_garment_sits_where_its_rows_put_it(tmp_path):
    garment, base = read_garment(write_garment(tmp_path)), base_mesh_m(crowd()[0])
    own = garment.place(base)
    forwards = np.abs(base[962, 1] - base[5320, 1]) / 1.9 * 0.1
    assert np.allclose(own[0], base[10], atol=1e-6)
    assert np.allclose(own[1], 0.2 * base[20] + 0.3 * base[30] + 0.5 * base[40], atol=1e-6)
    assert np.allclose(own[2], base[50] - (0, forwards, 0), atol=1e-6)
    assert np.flatnonzero(garment.hidden).tolist() == [3, 4, 5, 9]


@pytest.mark.parametrize(
    ("spoilt", "message"),
    [
        ({"head": "basemesh alpha7\n"}, "is made for alpha7"),
        ({"rows": "10\n20 30 40 0.2 0.3\n"}, "is not a garment"),
        ({"rows": ROWS.replace("70", "19158")}, "vertices beyond"),
        ({"rows": ROWS.replace("0.2", "nan")}, "is not a garment"),
        ({"faces": "f 1 2 4\n"}, "do not belong"),
        ({"obj": "../elsewhere/other.obj"}, "cannot be read"),
    ],
)
def test_what_is_no_garment_is_refused_in_one_line(tmp_path, spoilt, message):
    with pytest.raises(FormatError, match=message) as error:
        read_garment(write_garment(tmp_path, **spoilt))
    assert "\n" not in str(error.value)


def test_a_folder_without_garments_is_refused(tmp_path):
    with pytest.raises(CloudError, match=r"has no \.mhclo"):
        read_garments(tmp_path)


@pytest.mark.skipif(not GARMENTS.is_dir(), reason="MakeHuman's garments are not beside this checkout")
def test_makehumans_garments_cover_the_body_and_are_of_its_parts():
    garments, rng = read_garments(GARMENTS), np.random.default_rng(0)
    kinds = [kind_of(garment, crowd()[0]) for garment in garments]
    assert {kind: kinds.count(kind) for kind in kinds} == {"clothes": 12, "shoes": 6, "hair": 12}
    for body in crowd()[5:8]:
        dressed = wear(body, choose(garments, body, rng))
        centres = dressed.body.vertices_m[dressed.faces].mean(axis=1)
        sided = centres[:, 0] > 0.03
        assert not np.isin(dressed.face_parts[sided], (4, 6, 9, 11)).any()
        lift = (dressed.body.joints_m - body.joints_m)[0].astype(np.float32)
        moved = dressed.body.vertices_m - lift
        drawn_in = np.linalg.norm(moved[: len(body.vertices_m)] - body.vertices_m, axis=1) > 1e-3
        cloth = cKDTree(moved[len(body.vertices_m) :])
        away = cloth.query(body.vertices_m[drawn_in])[0]
        assert dressed.body.vertices_m[:, 2].min() == pytest.approx(0, abs=1e-6)
        assert drawn_in.mean() > 0.2 and np.quantile(away, 0.95) < 0.06


def test_a_wardrobe_is_its_garments_wherever_they_lie(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        write_garment(folder)
    assert Wardrobe.of(here).sha256 == Wardrobe.of(there).sha256
    order = Order(dressed_from(PRESETS["people"], here), 1, 0)
    assert order.manifest()["garments"] == Wardrobe.of(here).sha256
    with pytest.raises(CloudError, match="other garments"):
        Wardrobe(there, "0")(np.random.default_rng(0))
    with pytest.raises(CloudError, match="are naked"):
        dressed_from(PRESETS["upright"], here)
