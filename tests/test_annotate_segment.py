"""The suit is read as it is worn, in shade and with stains, and what is not seen is never made up."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.cloud.supervoxels import Supervoxels, supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.store import LabelSet
from annotate.parts import BACKGROUND, LEFT_RIGHT, PART_ID, UNDEFINED, swap_left_right
from annotate.segmentation.bare import LIKELY_BARE, bareness, cuff_evidence, without_sides
from annotate.segmentation.confidence import worst_first
from annotate.segmentation.patches import patches_of
from annotate.segmentation.segment import NEIGHBOUR, SOME_UNDEFINED, refine, segment
from annotate.suit.color_model import BARE, under, unfitted
from annotate.suit.palette import DEFAULT_SUIT, Suit, chromaticity
from eval.scores.confusion import confusion_matrix, recall
from sensors.rig.camera import Intrinsics, rays
from sensors.session.reader import Session

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
        person = (truth > 0) & (truth < UNDEFINED)
        result = segment(cloud, person, DEFAULT_SUIT)
        assert result.parts.dtype == np.uint8
        assert result.confidence.dtype == np.float32
        on = person & cloud.valid
        assert (result.parts[~on] == BACKGROUND).all()
        assert (result.confidence[~on] == 0).all()
        untold = on & (result.parts == UNDEFINED)  # loose points that no camera but depth's sees
        assert untold.sum() < 0.01 * on.sum()
        assert not cloud.color_valid[untold].any()
        assert ((result.parts[on & ~untold] >= 1) & (result.parts[on & ~untold] <= 11)).all()
        assert ((result.confidence > 0) == (on & ~untold)).all()
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


def person_of(truth: np.ndarray) -> np.ndarray:
    return (truth > 0) & (truth < UNDEFINED)


def lit(cloud: ThermalCloud, gains: tuple[float, float, float]) -> ThermalCloud:
    """The cloud's colours under a lamp whose linear red, green and blue are multiplied."""
    linear = (cloud.color_rgb / 255) ** 2.2 * gains
    return replace(cloud, color_rgb=(255 * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8))


@pytest.mark.parametrize("gains", [(1.0, 0.75, 0.5), (0.6, 0.8, 1.0)], ids=["incandescent", "sky"])
def test_coloured_light_is_seen_through(seen, gains):
    cloud, truth = seen[0]
    person = person_of(truth)
    assert (segment(lit(cloud, gains), person, DEFAULT_SUIT).parts == truth)[person].mean() > 0.97


def test_a_colour_image_without_range_is_diagnosed_and_not_guessed(seen):
    cloud, truth = seen[0]
    for value, says in ((255, "over-exposed"), (6, "too dark")):
        spoilt = replace(cloud, color_rgb=np.full_like(cloud.color_rgb, value))
        result = segment(spoilt, person_of(truth), DEFAULT_SUIT)
        assert (result.parts[person_of(truth) & cloud.valid] == UNDEFINED).all()
        assert not result.confidence.any()
        assert says in result.notes[0]
        assert "colour" in result.notes[0]


def test_a_half_burnt_person_is_labelled_as_far_as_it_goes(seen):
    cloud, truth = seen[0]
    person = person_of(truth)
    rgb = cloud.color_rgb.copy()
    rgb[:, : int(np.median(np.nonzero(person)[1]))] = 255
    result = segment(replace(cloud, color_rgb=rgb), person, DEFAULT_SUIT)
    assert "over-exposed" in result.notes[0]
    told = person & (result.parts != UNDEFINED) & (rgb.max(axis=2) < 255)
    assert (result.parts == truth)[told].mean() > 0.85


def test_twins_of_one_colour_are_told_by_what_they_join_or_left_open(seen):
    left, right = PART_ID["left_forearm"], PART_ID["right_forearm"]
    colors = DEFAULT_SUIT.colors_rgb.copy()
    colors[DEFAULT_SUIT.parts == right] = colors[DEFAULT_SUIT.parts == left]
    suit = Suit("alike", colors, DEFAULT_SUIT.parts)
    assert suit.look_alikes == ((left, right),)
    swapped = limbs = 0
    for cloud, truth in seen:
        rgb = cloud.color_rgb.copy()
        arm = truth == right
        rgb[arm] = color_of(left) * (rgb[arm].max(axis=1, keepdims=True) / 255)
        result = segment(replace(cloud, color_rgb=rgb), person_of(truth), suit)
        swapped += ((truth == left) & (result.parts == right)).sum()
        swapped += ((truth == right) & (result.parts == left)).sum()
        limbs += ((truth == left) | (truth == right)).sum()
        others = person_of(truth) & (truth != left) & (truth != right)
        assert (result.parts == truth)[others].mean() > 0.95
    assert swapped < 0.05 * limbs


def test_neighbours_of_one_colour_stay_undefined(seen):
    torso, hip = PART_ID["torso"], PART_ID["hip"]
    colors = DEFAULT_SUIT.colors_rgb.copy()
    colors[DEFAULT_SUIT.parts == hip] = colors[DEFAULT_SUIT.parts == torso]
    suit, (cloud, truth) = Suit("alike", colors, DEFAULT_SUIT.parts), seen[0]
    rgb = np.where((truth == hip)[..., None], color_of(torso), cloud.color_rgb).astype(np.uint8)
    result = segment(replace(cloud, color_rgb=rgb), person_of(truth), suit)
    both = (truth == torso) | (truth == hip)
    assert (result.parts == UNDEFINED)[both].mean() > 0.95
    assert (result.parts == truth)[person_of(truth) & ~both].mean() > 0.95
    assert SOME_UNDEFINED in result.notes


def test_a_suit_of_one_colour_stays_undefined():
    grey = Suit("grey", np.full((11, 3), 128, np.uint8), np.arange(1, 12, dtype=np.uint8))
    assert len(grey.look_alikes) == 55
    cloud = replace(wall(halves()), color_rgb=np.full((*CAMERA.shape, 3), 128, np.uint8))
    result = segment(cloud, ALL, grey)
    assert (result.parts == UNDEFINED).mean() > 0.9
    assert SOME_UNDEFINED in result.notes


def test_the_frame_before_helps_and_another_persons_does_no_harm(seen):
    cloud, truth = seen[0]
    person = person_of(truth)
    alone = segment(cloud, person, DEFAULT_SUIT).parts
    for parts in (truth, swap_left_right(truth), np.roll(truth, 40, axis=1)):
        before = FrameLabels("000000", cloud.depth_mm, np.where(cloud.valid, parts, 0).astype(np.uint8))
        with_it = segment(cloud, person, DEFAULT_SUIT, before).parts
        assert (with_it == truth)[person].mean() > (alone == truth)[person].mean() - 0.01


def test_wrong_pixels_are_where_confidence_is_low(seen):
    cloud, truth = seen[1]
    person = person_of(truth) & cloud.valid
    result = segment(cloud, person, DEFAULT_SUIT)
    wrong = result.parts[person] != truth[person]
    groups = supervoxels(cloud.points_m[person], cloud.color_rgb[person], seed_m=0.05)
    order = worst_first(result.confidence[person], groups)
    counts = np.bincount(groups.ids, wrong, groups.count)[order]
    assert counts[: int(0.3 * len(counts))].sum() >= 0.8 * counts.sum()
    assert abs(result.confidence[person].mean() - (~wrong).mean()) < 0.05


def test_confidence_is_lower_along_seams_and_silhouettes(seen):
    """Averaged over the person: at the outline and beside another part labels are less sure than within."""
    cloud, truth = seen[1]
    person = person_of(truth) & cloud.valid
    result = segment(cloud, person, DEFAULT_SUIT)
    square = np.ones((3, 3), np.uint8)
    inner = cv2.erode(result.parts, square) == cv2.dilate(result.parts, square)
    deep = cv2.erode(person.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    within = result.confidence[deep & inner].mean()
    assert result.confidence[person & ~deep].mean() < within
    assert result.confidence[deep & ~inner].mean() < within


def test_worst_first_counts_the_wrong_pixels_to_be_expected():
    groups = Supervoxels(np.repeat([0, 1, 2], [10, 100, 5]).astype(np.int32), 3, np.zeros((0, 2), np.int32))
    confidence = np.repeat([0.5, 0.9, 0.1], [10, 100, 5])  # 5, 10 and 4.5 wrong ones
    assert worst_first(confidence, groups).tolist() == [1, 0, 2]


def chain(colors: list[np.ndarray]) -> tuple[Supervoxels, np.ndarray]:
    """Supervoxels of fifty points in a row, 5 cm apart, each touching the next; their chromaticities."""
    ids = np.repeat(np.arange(len(colors)), 50).astype(np.int32)
    edges = np.column_stack([np.arange(len(colors) - 1), np.arange(1, len(colors))]).astype(np.int32)
    return Supervoxels(ids, len(colors), edges), chromaticity(np.stack(colors))


def test_a_hand_belongs_to_the_sleeve_it_grows_out_of():
    """Left sleeve, hand, chest, right sleeve in a row: skin alone leads to the left one."""
    left, right = PART_ID["left_forearm"] - 1, PART_ID["right_forearm"] - 1
    skin = np.array(BARE[0][0])
    colors = [color_of(left + 1), skin, skin, color_of(TORSO), color_of(right + 1)]
    groups, chroma = chain(colors)
    middle_m = np.column_stack([0.05 * np.arange(5), np.zeros(5), np.full(5, 2.0)])
    odds = bareness(under(unfitted(DEFAULT_SUIT), np.zeros(2)), chroma, np.full(5, 0.02))
    np.testing.assert_array_equal(odds > LIKELY_BARE, [False, True, True, False, odds[4] > LIKELY_BARE])
    belief = np.full((5, 11), 0.001)
    belief[[0, 1, 2, 3, 4], [left, right, right, TORSO - 1, right]] = 0.9  # the hand was taken for the other
    patches = patches_of(groups, chroma, np.full(5, 0.02), middle_m)
    clue = cuff_evidence(belief, odds, patches, groups, middle_m)
    assert (clue[1:3, left] == 0).all()
    assert (clue[1:3, right] < -2).all()
    assert not clue[[0, 3]].any()
    even = without_sides(belief, odds)
    np.testing.assert_allclose(even[1:3, left], even[1:3, right])
    np.testing.assert_array_equal(even[3], belief[3])


@pytest.mark.parametrize("value", [255, 6], ids=["over-exposed", "dark"])
@pytest.mark.parametrize("share", [0.35, 0.6])
def test_what_a_spoilt_part_of_a_person_shows_is_not_guessed(seen, value, share):
    """The spoilt rows are told where surroundings tell them, right, and else stay undefined."""
    cloud, truth = seen[0]
    person = person_of(truth) & cloud.valid
    rows = np.sort(np.nonzero(person)[0])
    spoilt = person & (np.arange(person.shape[0])[:, None] <= rows[int(share * len(rows))])
    rgb = np.where(spoilt[..., None], np.uint8(value), cloud.color_rgb)
    result = segment(replace(cloud, color_rgb=rgb), person, DEFAULT_SUIT)
    assert any("colour is" in note and "exposure" in note for note in result.notes)
    named = result.parts != UNDEFINED
    assert (result.parts == truth)[person & ~spoilt].mean() > 0.85
    assert (named & (result.parts != truth))[spoilt].mean() < 0.2
    assert (~named)[spoilt].mean() > 0.3


def test_refining_settles_on_the_best_of_score_and_neighbours():
    rng = np.random.default_rng(3)
    mask, depth = rng.random((12, 15)) < 0.8, np.full((12, 15), 2, np.float32)
    depth[:, 8:] = 3  # another surface: no neighbours across
    scores = rng.normal(0, 2, (mask.sum(), 4))
    chosen = refine(scores, scores.argmax(axis=1).astype(np.uint8), depth, mask)
    image = np.full(mask.shape, -1)
    image[mask] = chosen
    again = []
    for own, (v, u) in zip(scores, np.argwhere(mask), strict=True):
        window = np.s_[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
        near = image[window][np.abs(depth[window] - depth[v, u]) < 0.03].tolist()
        near.remove(image[v, u])
        again.append(np.argmax(own + NEIGHBOUR * np.array([near.count(part) for part in range(4)])))
    assert (np.array(again) == chosen).mean() > 0.97  # a few may still swing when the rounds end
