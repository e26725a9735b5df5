"""The suit is read as it is worn, in shade and with stains, and what is not seen is never made up."""

import numpy as np
import pytest

from annotate.cloud import ThermalCloud
from annotate.fuse import Fuser
from annotate.parts import BACKGROUND, LEFT_RIGHT, PART_ID, UNDEFINED, swap_left_right
from annotate.segment import segment
from annotate.store import LabelSet
from annotate.suit import DEFAULT_SUIT, Suit
from eval.metrics import confusion_matrix, recall
from sensors.camera import Intrinsics, rays
from sensors.replay import Session

CAMERA = Intrinsics(72, 54, 365.0, 365.0, 35.5, 26.5)
TORSO, HIP, HEAD = PART_ID["torso"], PART_ID["hip"], PART_ID["head"]


def color_of(part: int) -> np.ndarray:
    return DEFAULT_SUIT.colors_rgb[DEFAULT_SUIT.parts == part][0]


def wall(worn: np.ndarray, color_valid: np.ndarray | None = None) -> ThermalCloud:
    """A gently curved surface 2 m away, each pixel dressed as part ``worn`` (h, w) of the default suit."""
    h, w = CAMERA.shape
    bulge = np.add.outer(np.square(np.arange(h) - h / 2), np.square(np.arange(w) - w / 2))
    depth = (2000 + bulge / 20).astype(np.uint16)
    rgb = np.stack([color_of(p) for p in range(1, 12)])[worn - 1]
    seen = np.ones(worn.shape, bool) if color_valid is None else color_valid
    points = (rays(CAMERA) * (depth / 1000)[..., None]).astype(np.float32)
    rgb = np.where(seen[..., None], rgb, 0).astype(np.uint8)
    return ThermalCloud(CAMERA, depth, points, rgb, seen, np.full(worn.shape, 30, np.float32))


def halves() -> np.ndarray:
    """Torso above hip."""
    worn = np.full(CAMERA.shape, TORSO)
    worn[CAMERA.height // 2 :] = HIP
    return worn


ALL = np.ones(CAMERA.shape, bool)


@pytest.fixture(scope="module")
def seen(rig_session) -> list[tuple[ThermalCloud, np.ndarray]]:
    """The clean rig's clouds and their true parts."""
    session = Session(rig_session)
    fuser = Fuser(session.calibration)
    truth = LabelSet.open(rig_session.with_suffix(".truth"))
    return [(fuser.fuse_frame(f), truth.read(f"{f.index:06d}").parts) for f in session]


def test_the_true_person_on_the_clean_rig_is_read_right(seen):
    total = np.zeros((12, 12), np.int64)
    for cloud, truth in seen:
        result = segment(cloud, (truth > 0) & (truth < UNDEFINED), DEFAULT_SUIT)
        total += confusion_matrix(truth, result.parts)
    by_part = recall(total)[1:]
    assert np.nanmean(by_part) >= 0.97
    assert np.nanmin(by_part) >= 0.9


def test_labels_stay_on_the_person(seen):
    for cloud, truth in seen:
        person = truth > 0
        result = segment(cloud, person, DEFAULT_SUIT)
        assert result.parts.dtype == np.uint8
        assert result.confidence.dtype == np.float32
        on = person & cloud.valid
        assert (result.parts[~on] == BACKGROUND).all()
        assert (result.confidence[~on] == 0).all()
        assert ((result.parts[on] >= 1) & (result.parts[on] <= 11)).all()
        assert ((result.confidence > 0) == on).all()
        assert result.confidence.max() <= 1


def test_a_mirrored_suit_gives_mirrored_labels(seen):
    cloud, truth = seen[0]
    twin = {a: b for pair in LEFT_RIGHT for a, b in (pair, pair[::-1])}
    mirrored = Suit(
        "m", DEFAULT_SUIT.colors_rgb, np.array([twin.get(int(p), p) for p in DEFAULT_SUIT.parts], np.uint8)
    )
    straight, swapped = (segment(cloud, truth > 0, suit).parts for suit in (DEFAULT_SUIT, mirrored))
    np.testing.assert_array_equal(swap_left_right(swapped), straight)


def test_it_is_deterministic(seen):
    cloud, truth = seen[0]
    a, b = (segment(cloud, truth > 0, DEFAULT_SUIT) for _ in range(2))
    np.testing.assert_array_equal(a.parts, b.parts)
    np.testing.assert_array_equal(a.confidence, b.confidence)


def test_one_colour_is_one_part():
    for part in range(1, 12):
        result = segment(wall(np.full(CAMERA.shape, part)), ALL, DEFAULT_SUIT)
        assert (result.parts == part).all()
        assert result.confidence.min() > 0.9


def test_a_seam_stays_where_it_is():
    worn = halves()
    assert (segment(wall(worn), ALL, DEFAULT_SUIT).parts == worn).mean() > 0.99


def test_shade_changes_nothing():
    worn = halves()
    cloud = wall(worn)
    dark = (cloud.color_rgb * np.linspace(0.35, 1, CAMERA.width)[None, :, None]).astype(np.uint8)
    shaded = ThermalCloud(
        cloud.camera, cloud.depth_mm, cloud.points_m, dark, cloud.color_valid, cloud.temperature_c
    )
    assert (segment(shaded, ALL, DEFAULT_SUIT).parts == worn).mean() > 0.98


def test_stains_and_unseen_points_take_their_surroundings():
    rng = np.random.default_rng(0)
    worn = np.where(rng.random(CAMERA.shape) < 0.1, HEAD, halves())
    unseen = rng.random(CAMERA.shape) < 0.3
    result = segment(wall(worn, ~unseen), ALL, DEFAULT_SUIT)
    clean = worn == halves()
    assert (result.parts == halves())[unseen & clean].mean() > 0.9
    assert (result.parts == halves())[clean].mean() > 0.95


def test_a_patch_that_no_camera_sees_takes_what_is_around_it():
    unseen = np.zeros(CAMERA.shape, bool)
    unseen[4:22, 20:38] = True  # 10 cm of torso: whole supervoxels without a colour
    unseen[34:50, 40:58] = True
    result = segment(wall(halves(), ~unseen), ALL, DEFAULT_SUIT)
    np.testing.assert_array_equal(result.parts[unseen], halves()[unseen])
    assert result.confidence[unseen].min() < result.confidence[~unseen].min()


def test_without_colour_parts_are_undefined():
    result = segment(wall(halves(), ~ALL), ALL, DEFAULT_SUIT)
    assert (result.parts == UNDEFINED).all()
    assert not result.confidence.any()
    assert "no colour" in result.notes[0]


def test_nobody_gets_no_part():
    cloud = wall(halves())
    for nobody in (~ALL, ALL & ~cloud.valid):
        result = segment(cloud, nobody, DEFAULT_SUIT)
        assert not result.parts.any()
        assert "no person" in result.notes[0]


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_person_of_a_few_points_is_labelled_too(n):
    few = np.zeros(CAMERA.shape, bool)
    few[10, 10 : 10 + n] = True
    result = segment(wall(halves()), few, DEFAULT_SUIT)
    assert (result.parts[few] == TORSO).all()
    assert (result.parts > 0).sum() == n
