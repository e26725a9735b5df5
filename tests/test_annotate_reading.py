"""Suit segmentation holds in shade and any light, and leaves unreadable pixels undefined."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.cloud.supervoxels import supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_cloud
from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND, LEFT_RIGHT, PAPER, PART_ID, UNDEFINED, swap_left_right
from annotate.segmentation.labels_of_frame import labels_of
from annotate.segmentation.segmented_person import Segmentation
from annotate.suit.palette import DEFAULT_SUIT, Suit
from eval.scores.confusion import confusion_matrix, left_right_swap_rate, recall
from sensors.session.reader import Session
from synth.rig.simulate import truth_path
from tools.figures.reliability import worst_first

TORSO, HIP = PART_ID["torso"], PART_ID["hip"]


def color_of(part: int) -> np.ndarray:
    return DEFAULT_SUIT.colors_rgb[DEFAULT_SUIT.parts == part][0]


def read_in(
    cloud: ThermalCloud, suit: Suit = DEFAULT_SUIT, before: FrameLabels | None = None
) -> Segmentation:
    return label_cloud(SuitLabeller(suit), cloud, before)[0]


def body_of(truth: np.ndarray) -> np.ndarray:
    return (truth > 0) & (truth < UNDEFINED)


def right(result: Segmentation, truth: np.ndarray, among: np.ndarray | None = None) -> float:
    """Share of the body's pixels that are right."""
    asked = body_of(truth) if among is None else among
    return float((result.parts == truth)[asked].mean())


@pytest.fixture(scope="module")
def seen(rig_session) -> list[tuple[ThermalCloud, np.ndarray]]:
    """The clean rig's clouds and their true parts."""
    session = Session(rig_session)
    fuser, truth = Fuser(session.calibration), LabelSet.open(truth_path(rig_session))
    return [(fuser.fuse_frame(f), truth.read(f"{f.index:06d}").parts) for f in session]


@pytest.fixture(scope="module")
def read(seen) -> list[Segmentation]:
    """Segmentations of the clouds, each frame by itself."""
    return [read_in(cloud) for cloud, _ in seen]


def test_the_clean_rig_is_read_right(seen, read):
    total = np.zeros((12, 12), np.int64)
    for (_, truth), result in zip(seen, read, strict=True):
        total += confusion_matrix(truth, result.parts, PAPER)
    by_part = recall(total)[1:]
    assert np.nanmean(by_part) >= 0.97 and np.nanmin(by_part) >= 0.9
    assert left_right_swap_rate(total, PAPER) <= 0.01


def test_labels_stay_on_readings_and_each_has_its_confidence(seen, read):
    for (cloud, truth), result in zip(seen, read, strict=True):
        assert result.parts.dtype == np.uint8 and result.confidence.dtype == np.float32
        on = result.parts != BACKGROUND
        assert not on[~cloud.valid].any() and result.parts.max() <= 11
        assert ((result.confidence > 0) == on).all() and result.confidence.max() <= 1
        assert (on & (truth == 0)).sum() < 0.05 * on.sum()


def lit(cloud: ThermalCloud, gains: tuple[float, float, float] | np.ndarray) -> ThermalCloud:
    """The cloud's colours under a lamp whose linear red, green and blue are multiplied."""
    linear = (cloud.color_rgb / 255) ** 2.2 * gains
    return replace(cloud, color_rgb=(255 * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8))


@pytest.mark.parametrize("gains", [(1.0, 0.75, 0.5), (0.6, 0.8, 1.0)], ids=["incandescent", "sky"])
def test_coloured_light_is_seen_through(seen, read, gains):
    cloud, truth = seen[0]
    assert right(read_in(lit(cloud, gains)), truth) > right(read[0], truth) - 0.02


def test_a_shadow_across_the_body_changes_nothing(seen, read):
    cloud, truth = seen[0]
    columns = np.flatnonzero(body_of(truth).any(axis=0))
    shade = np.interp(np.arange(truth.shape[1]), columns[[0, -1]], (0.15, 1))[None, :, None]
    assert right(read_in(lit(cloud, shade)), truth) > right(read[0], truth) - 0.02


@pytest.mark.parametrize(
    ("value", "seen_by_camera", "says"),
    [(255, True, "over-exposed"), (6, True, "too dark"), (0, False, "no colour")],
)
def test_a_frame_without_readable_colours_is_diagnosed_and_not_guessed(seen, value, seen_by_camera, says):
    cloud, truth = seen[0]
    valid = cloud.color_valid & seen_by_camera
    result = read_in(replace(cloud, color_rgb=np.full_like(cloud.color_rgb, value), color_valid=valid))
    on = result.parts != BACKGROUND
    assert (result.parts[on] == UNDEFINED).all() and (on & body_of(truth)).sum() > 0.95 * body_of(truth).sum()
    assert not result.confidence.any()
    assert says in result.notes[0] and "colour" in result.notes[0]


def test_an_empty_room_gets_no_part(seen):
    cloud = seen[0][0]
    empty = replace(cloud, temperature_c=np.where(cloud.valid, np.float32(20), np.float32(np.nan)))
    result, person = label_cloud(SuitLabeller(DEFAULT_SUIT), empty, None)
    assert not result.parts.any() and not person.mask.any()
    assert "no person" in (*person.notes, *result.notes)[0]


@pytest.mark.parametrize(("value", "says"), [(255, "over-exposed"), (6, "too dark")])
def test_a_half_spoilt_person_is_labelled_as_far_as_it_goes(seen, value, says):
    cloud, truth = seen[0]
    body = body_of(truth)
    spoilt = np.arange(truth.shape[1])[None, :] < int(np.median(np.nonzero(body)[1]))
    rgb = np.where(spoilt[..., None], np.uint8(value), cloud.color_rgb)
    result = read_in(replace(cloud, color_rgb=rgb))
    assert says in result.notes[0] and "exposure" in result.notes[0]
    assert right(result, truth, body & ~spoilt) > 0.85
    assert result.confidence[body & spoilt].mean() < result.confidence[body & ~spoilt].mean()


def alike(cloud: ThermalCloud, truth: np.ndarray, one: int, other: int) -> tuple[ThermalCloud, Suit]:
    """The cloud with a part in another's colour, shaded as before, and the suit of which that is true."""
    colors = DEFAULT_SUIT.colors_rgb.copy()
    colors[DEFAULT_SUIT.parts == other] = colors[DEFAULT_SUIT.parts == one]
    rgb, there = cloud.color_rgb.copy(), truth == other
    rgb[there] = color_of(one) * (rgb[there].max(axis=1, keepdims=True) / 255)
    return replace(cloud, color_rgb=rgb), Suit("alike", colors, DEFAULT_SUIT.parts)


def test_neighbours_of_one_colour_are_less_sure(seen, read):
    """Above all at their border, where only shape is left."""
    cloud, truth = seen[0]
    result = read_in(*alike(cloud, truth, TORSO, HIP))
    both, beside = (truth == TORSO) | (truth == HIP), np.ones((9, 9), np.uint8)
    border = both.copy()
    for part in (TORSO, HIP):
        border &= cv2.dilate((truth == part).astype(np.uint8), beside) > 0
    assert result.confidence[border].mean() < read[0].confidence[border].mean() - 0.1
    assert result.confidence[both].mean() < read[0].confidence[both].mean()
    assert right(result, truth, body_of(truth) & ~both) > 0.95


def test_a_leg_of_two_colours_is_one_leg(seen, read):
    """Trousers whose lower half has a colour of its own, which the suit names."""
    cloud, truth = seen[0]
    leg, second = PART_ID["left_lower_leg"], np.array([250, 250, 60])
    rows = np.nonzero(truth == leg)[0]
    low = (truth == leg) & (np.arange(truth.shape[0])[:, None] > np.median(rows))
    rgb = cloud.color_rgb.copy()
    rgb[low] = second * (rgb[low].max(axis=1, keepdims=True) / 255)
    suit = Suit(
        "two",
        np.vstack([DEFAULT_SUIT.colors_rgb, second]).astype(np.uint8),
        np.append(DEFAULT_SUIT.parts, np.uint8(leg)),
    )
    result = read_in(replace(cloud, color_rgb=rgb), suit)
    assert right(result, truth, truth == leg) > right(read[0], truth, truth == leg) - 0.1


def test_the_frame_before_does_no_harm_whoever_s_it_is(seen, read):
    cloud, truth = seen[0]
    for parts in (truth, swap_left_right(truth), np.roll(truth, 40, axis=1)):
        before = FrameLabels("000000", cloud.depth_mm, np.where(cloud.valid, parts, 0).astype(np.uint8))
        assert right(read_in(cloud, before=before), truth) > right(read[0], truth) - 0.01


def test_while_the_flag_is_closed_the_suit_is_read_all_the_same(seen):
    cloud, truth = seen[0]
    before = labels_of("x", cloud.depth_mm, *label_cloud(SuitLabeller(DEFAULT_SUIT), cloud, None))
    blind = replace(cloud, temperature_c=np.full_like(cloud.temperature_c, np.nan))
    for known in (before, None):
        assert right(read_in(blind, before=known), truth) > 0.9


def test_wrong_pixels_are_where_confidence_is_low(seen, read):
    first, total, surer = 0, 0, []
    for (cloud, truth), result in zip(seen, read, strict=True):
        on = (result.parts != BACKGROUND) & (truth != UNDEFINED)
        wrong = result.parts[on] != truth[on]
        groups = supervoxels(cloud.points_m[on], cloud.color_rgb[on], seed_m=0.05)
        counts = np.bincount(groups.ids, wrong, groups.count)[worst_first(result.confidence[on], groups)]
        first, total = first + counts[: int(0.3 * len(counts))].sum(), total + counts.sum()
        surer.append(result.confidence[on] - ~wrong)
    assert first >= 0.75 * total
    assert abs(np.concatenate(surer).mean()) < 0.05


@pytest.mark.parametrize(
    "told", [None, "dark", [0.1], [0.1, "x"], [float("nan"), 0.0], [1e9, 0.0], [0.6, -0.6]]
)
def test_a_light_that_the_frame_before_tells_is_kept_or_found_anew(seen, read, told):
    cloud = seen[0][0]
    survey = SuitLabeller(DEFAULT_SUIT).detect(cloud).persons.person(None)
    before = labels_of("0", cloud.depth_mm, read[0], survey)
    assert before.notes["light"] == read[0].illuminant.log_gain.round(3).tolist()
    if told is not None:
        before = replace(before, notes=before.notes | {"light": told})
    again = read_in(cloud, before=before)
    assert np.abs(again.illuminant.log_gain - read[0].illuminant.log_gain).max() < 0.05
    assert (again.parts != read[0].parts)[body_of(read[0].parts)].mean() < 0.03


def test_a_glance_names_what_a_reading_names(seen, read):
    """Except at borders; and only at pixels with depth."""
    for (cloud, truth), whole in zip(seen[:3], read, strict=False):
        found = label_cloud(SuitLabeller(DEFAULT_SUIT, single_pass=True), cloud, None)[0]
        assert right(found, truth) > right(whole, truth) - 0.03 and not found.parts[~cloud.valid].any()
        assert ((found.parts > 0) == (whole.parts > 0)).mean() > 0.99
        assert (found.confidence[found.parts > 0] > 0).all()


def test_a_mirrored_world_gives_mirrored_labels(seen, read):
    """Sides of a suit that is worn mirrored by a mirrored person are its own sides."""
    cloud = seen[0][0]
    camera = replace(cloud.camera, cx=cloud.camera.width - 1 - cloud.camera.cx)
    images = (cloud.depth_mm, cloud.points_m * (-1, 1, 1), cloud.color_rgb, cloud.color_valid)
    flipped = ThermalCloud(camera, *(image[:, ::-1].copy() for image in (*images, cloud.temperature_c)))
    flipped = replace(flipped, points_m=flipped.points_m.astype(np.float32))
    twin = {a: b for pair in LEFT_RIGHT for a, b in (pair, pair[::-1])}
    parts = np.array([twin.get(int(part), part) for part in DEFAULT_SUIT.parts], np.uint8)
    found = read_in(flipped, Suit("mirrored", DEFAULT_SUIT.colors_rgb, parts)).parts[:, ::-1]
    on = (found > 0) | (read[0].parts > 0)
    assert (swap_left_right(found) == read[0].parts)[on].mean() > 0.95


def test_twins_of_one_colour_are_told_by_what_they_join(seen):
    one, other = PART_ID["left_forearm"], PART_ID["right_forearm"]
    total = np.zeros((12, 12), np.int64)
    for cloud, truth in seen:
        changed, suit = alike(cloud, truth, one, other)
        total += confusion_matrix(truth, read_in(changed, suit).parts, PAPER)
    assert total[one, other] + total[other, one] < 0.05 * total[[one, other]].sum()


def test_confidence_is_lower_along_seams_and_silhouettes(seen, read):
    """Averaged over the person: at the outline and beside another part labels are less sure than within."""
    result = read[1]
    on, square = result.parts != BACKGROUND, np.ones((3, 3), np.uint8)
    inner = cv2.erode(result.parts, square) == cv2.dilate(result.parts, square)
    deep = cv2.erode(on.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    within = result.confidence[deep & inner].mean()
    assert result.confidence[on & ~deep].mean() < within
    assert result.confidence[deep & ~inner].mean() < within
