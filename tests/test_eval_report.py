"""The comparison of label sets, its JSON, and the page: complete, inert, and drawn by a browser."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from annotate.cloud import ThermalCloud
from annotate.labels import FrameLabels
from annotate.parts import BODY_PARTS, PARTS, UNDEFINED, palette_rgb, swap_left_right
from annotate.store import LabelSet
from eval.compare import Comparison, compare_sets
from eval.report import figures
from eval.report.build import render, write_report
from eval.report.gallery import make_gallery, pick_frames
from eval.results import Result, load_result, save_result
from sensors.camera import Intrinsics
from sensors.errors import CloudError, ExistsError, FormatError

CAMERA = Intrinsics(width=96, height=80, fx=90.0, fy=90.0, cx=47.5, cy=39.5)
HOSTILE = "<script>alert(1)</script>"
LIMBS = {  # part id: ends of a capsule in units of the picture's height, and its radius
    1: ((0.60, 0.14), (0.60, 0.20), 0.075),
    2: ((0.60, 0.30), (0.60, 0.46), 0.12),
    3: ((0.75, 0.30), (0.80, 0.46), 0.045),
    4: ((0.45, 0.30), (0.40, 0.46), 0.045),
    5: ((0.80, 0.50), (0.74, 0.62), 0.040),
    6: ((0.40, 0.50), (0.46, 0.62), 0.040),
    7: ((0.55, 0.58), (0.65, 0.58), 0.085),
    8: ((0.67, 0.64), (0.72, 0.74), 0.060),
    9: ((0.53, 0.64), (0.48, 0.74), 0.060),
    10: ((0.73, 0.80), (0.73, 0.93), 0.045),
    11: ((0.47, 0.80), (0.47, 0.93), 0.045),
}


def person(seed: int, camera: Intrinsics = CAMERA) -> FrameLabels:
    """A seated doll of capsules 1.5 m away, posed by the seed, before a wall at 2.4 m."""
    rng = np.random.default_rng(seed)
    height = camera.height
    parts = np.zeros((camera.height, camera.width), np.uint8)
    for part, (start, end, radius) in LIMBS.items():
        ends = (np.array([start, end]) + rng.normal(0, 0.01, 2)) * height
        a, b = (tuple(round(c) for c in p) for p in ends)
        cv2.line(parts, a, b, part, thickness=int(2 * radius * height))
    inside = cv2.distanceTransform((parts > 0).astype(np.uint8), cv2.DIST_L2, 5)
    depth = np.where(parts > 0, 1500 - 12 * inside * 80 / height, 2400 + rng.normal(0, 4, parts.shape))
    parts[: height // 20] = UNDEFINED
    return FrameLabels(f"{seed:06d}", depth.astype(np.uint16), parts, status="truth", subject=f"s{seed % 3}")


def guessed(truth: FrameLabels, seed: int, shift: int = 1, swap: float = 0.15) -> FrameLabels:
    """A prediction that is shifted, holed, and now and then swaps left and right."""
    rng = np.random.default_rng(seed + 99)
    parts = np.roll(truth.parts, shift, axis=1)
    if rng.random() < swap:
        parts = swap_left_right(parts)
    v, u = rng.integers(0, 60, 2)
    parts[v : v + 9, u : u + 9] = rng.choice([0, 2, 7, UNDEFINED])
    return replace(truth, parts=parts, status="auto")


def cloud(truth: FrameLabels, camera: Intrinsics = CAMERA) -> ThermalCloud:
    """The doll's cloud: skin at 33 degrees, the wall at 22, some of it unseen by the thermal camera."""
    v, u = np.mgrid[: camera.height, : camera.width]
    z = truth.depth_mm.astype(np.float32) / 1000
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], -1)
    warm = np.where((truth.parts > 0) & (truth.parts != UNDEFINED), 33, 22).astype(np.float32)
    warm[:, :8] = np.nan
    gray = np.zeros((*z.shape, 3), np.uint8)
    return ThermalCloud(camera, truth.depth_mm, points.astype(np.float32), gray, z > 0, warm)


def label_sets(folder: Path, frames: int = 6) -> tuple[LabelSet, LabelSet]:
    """A prediction and its truth on disk."""
    truth = LabelSet.create(folder / "truth", CAMERA, {})
    predicted = LabelSet.create(folder / "predicted", CAMERA, {})
    for seed in range(frames):
        truth.write(person(seed))
        predicted.write(guessed(person(seed), seed))
    return predicted, truth


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[LabelSet, LabelSet]:
    return label_sets(tmp_path_factory.mktemp("sets"))


@pytest.fixture(scope="module")
def compared(sets: tuple[LabelSet, LabelSet]) -> Comparison:
    return compare_sets(*sets)


def test_a_set_against_itself_is_perfect(sets: tuple[LabelSet, LabelSet]) -> None:
    summary = compare_sets(sets[1], sets[1]).to_evaluation_json()
    assert summary["mean_recall"] == summary["miou"] == summary["boundary_f"] == summary["person_iou"] == 1.0
    assert summary["left_right_swap_rate"] == 0.0 and summary["ci95"]["miou"] == [1.0, 1.0]


def test_json_has_the_keys_of_the_contract(compared: Comparison) -> None:
    keys = {"frames", "mean_recall", "recall", "miou", "iou", "boundary_f"}
    keys |= {"left_right_swap_rate", "person_iou"}
    assert set(compared.to_json()) == keys
    full = json.loads(json.dumps(compared.to_evaluation_json(), allow_nan=False))
    assert set(full) >= {*keys, "ci95", "confusion", "background"}
    assert list(full["recall"]) == [part.name for part in BODY_PARTS]
    assert np.array(full["confusion"]).shape == (12, 12)
    low, high = full["ci95"]["mean_recall"]
    assert low <= full["mean_recall"] <= high
    assert 0 < full["undefined"]["truth"] < 0.1 and full["subjects"] == 3


def test_the_summary_is_that_of_the_pixels(sets: tuple[LabelSet, LabelSet], compared: Comparison) -> None:
    """Person IoU and swap rate once more, straight from the label maps."""
    truth = np.stack([frame.parts for frame in sets[1]])
    guess = np.stack([frame.parts for frame in sets[0]])
    defined, seen = truth != UNDEFINED, (guess > 0) & (guess != UNDEFINED)
    person_iou = (defined & (truth > 0) & seen).sum() / (defined & ((truth > 0) | seen)).sum()
    limb = defined & (swap_left_right(truth) != truth)
    swapped = limb & (guess == swap_left_right(truth))
    summary = compared.to_json()
    assert summary["person_iou"] == pytest.approx(person_iou, abs=1e-12)
    assert summary["left_right_swap_rate"] == pytest.approx(swapped.sum() / limb.sum(), abs=1e-12)
    assert summary["frames"] == len(truth) and 0 < summary["left_right_swap_rate"] < 1


def test_absent_parts_are_null_in_json(compared: Comparison) -> None:
    matrices = compared.matrices.copy()
    matrices[:, 1, :] = matrices[:, :, 1] = 0
    full = replace(compared, matrices=matrices).to_evaluation_json()
    assert full["recall"]["head"] is None and full["absent_parts"] == ["head"]
    json.dumps(full, allow_nan=False)


def test_frames_that_do_not_match_are_named(tmp_path: Path) -> None:
    predicted, truth = label_sets(tmp_path, frames=3)
    predicted.write(replace(person(7), frame_id="extra"))
    assert compare_sets(predicted, truth).extra_frames == 1
    with pytest.raises(CloudError, match=r"lacks 1 of the 4 frames .* first extra; predict"):
        compare_sets(truth, predicted)
    small = Intrinsics(width=48, height=40, fx=45.0, fy=45.0, cx=23.5, cy=19.5)
    other = LabelSet.create(tmp_path / "small", small, {})
    for seed in range(3):
        other.write(person(seed, small))
    with pytest.raises(CloudError, match=r"frame 000000 is \(40, 48\) .* \(80, 96\)"):
        compare_sets(other, truth)
    with pytest.raises(CloudError, match="no frames"):
        compare_sets(truth, LabelSet.create(tmp_path / "none", CAMERA, {}))


def test_results_come_back_from_disk(compared: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    save_result(path, Result("Network", compared, {"command": HOSTILE}))
    loaded = load_result(path)
    assert loaded.title == "Network" and loaded.facts == {"command": HOSTILE}
    assert loaded.comparison.to_evaluation_json() == compared.to_evaluation_json()
    assert loaded.comparison.frame_ids == compared.frame_ids
    with pytest.raises(ExistsError):
        save_result(path, loaded)


@pytest.mark.parametrize(
    "damage",
    [
        lambda v: v.pop("matrices"),
        lambda v: v.update(schema=9),
        lambda v: v["matrices"].pop(),
        lambda v: v["borders"][0].__setitem__(0, -1),
        lambda v: v["borders"][0].__setitem__(0, 0.5),
        lambda v: v.update(frame_ids=[]),
        lambda v: v["matrices"][0][0].__setitem__(0, 10**30),
    ],
)
def test_damaged_results_are_refused(compared: Comparison, tmp_path: Path, damage) -> None:
    path = tmp_path / "result.json"
    save_result(path, Result("Network", compared))
    value = json.loads(path.read_text())
    damage(value)
    path.write_text(json.dumps(value))
    with pytest.raises(CloudError):
        load_result(path)


def test_no_json_is_no_result(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[" * 100_000)
    for path in (tmp_path / "a.json", tmp_path / "missing.json"):
        with pytest.raises(FormatError):
            load_result(path)


def test_picked_frames_are_the_extremes_and_never_twice(compared: Comparison) -> None:
    picked = pick_frames(compared, each=2)
    ranked = [compared.frame_ids[i] for i in np.argsort(compared.frame_miou, kind="stable")]
    assert picked["Worst"] == ranked[:2] and picked["Best"] == ranked[::-1][:2]
    everything = [*picked["Worst"], *picked["Random"], *picked["Best"]]
    assert len(everything) == len(set(everything)) == 6
    assert sum(map(len, pick_frames(compared, each=5).values())) == 6


def test_error_colours_follow_the_error_kinds() -> None:
    truth = np.array([[0, 0, 3, 3, 3, 3, 3, UNDEFINED]], np.uint8)
    guess = np.array([[0, 2, 3, 4, 0, 5, 11, 3]], np.uint8)
    image = figures.colorize_error(truth, guess)[0]
    kinds = ["invented_person", "left_right_swap", "missed_person", "neighbour_part", "other_part"]
    for pixel, kind in zip((1, 3, 4, 5, 6), kinds, strict=True):
        assert tuple(image[pixel]) == figures.ERROR_KINDS[kind][1]
    assert len({tuple(p) for p in image}) == 8


def test_pictures_hold_what_they_show() -> None:
    truth = person(0)
    assert (figures.colorize_parts(truth.parts)[truth.parts == 1] == PARTS[1].rgb).all()
    uri = figures.data_uri(figures.to_size(figures.colorize_parts(truth.parts)))
    assert uri.startswith("data:image/png;base64,")
    depth = figures.colorize_depth(np.array([[0, 800, 1600]], np.uint16))[0]
    assert tuple(depth[0]) == figures.CANVAS and depth[1, 0] > depth[2, 0]
    assert (figures.colorize_depth(np.zeros((2, 2), np.uint16)) == figures.CANVAS).all()
    known = {tuple(c) for c in palette_rgb()}
    enlarged = figures.to_size(figures.colorize_parts(truth.parts))
    assert {tuple(c) for c in enlarged.reshape(-1, 3)} <= known


def test_a_crop_passes_the_edges_and_keeps_the_person() -> None:
    mask = np.zeros((20, 50), np.bool_)
    mask[2:20, 40:50] = True
    box = figures.person_box(mask, margin=0.3)
    cropped = figures.crop(mask, box)
    assert cropped.shape == (box[2], box[2]) and cropped.sum() == mask.sum()


def test_a_nearer_point_hides_a_farther_one() -> None:
    """A warm sheet and a cold one behind it on the same rays, in either order: only warm is seen."""
    v, u = np.mgrid[:60, :60]
    rays = np.stack([(u - 30) / 60, (v - 30) / 60, np.ones((60, 60))], -1)
    sheets = [(rays * 1.0, np.full((60, 60), 36.0)), (rays * 1.5, np.full((60, 60), 18.0))]
    for first, second in (sheets, sheets[::-1]):
        points = np.concatenate([first[0], second[0]]).astype(np.float32)
        warm = np.concatenate([first[1], second[1]]).astype(np.float32)
        image = figures.render_thermal_cloud(points, warm, yaw_deg=0, pitch_deg=0).astype(int).sum(-1)
        assert image[80:130, 80:130].min() > 500
    hidden = np.full((8, 8, 3), np.nan, np.float32)
    assert (figures.render_thermal_cloud(hidden, hidden[..., 0]) == figures.CANVAS).all()


class Page(HTMLParser):
    """Tags, their attributes, and whether every tag is closed in order."""

    VOID = frozenset(("meta", "img", "br", "col"))

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(sets: tuple[LabelSet, LabelSet], compared: Comparison) -> str:
    hostile = replace(
        compared,
        frame_ids=(HOSTILE, *compared.frame_ids[1:]),
        subjects=(*compared.subjects[1:], f'"><img src=x onerror={HOSTILE}>'),
    )
    frames = make_gallery(compared, *sets, cloud_of=lambda frame_id: cloud(person(int(frame_id))), each=2)
    frames = [replace(frames[0], frame_id=HOSTILE, group=HOSTILE), *frames[1:]]
    title = f"Network {HOSTILE}"
    results = [Result("Automatic", compared), Result(title, hostile, {HOSTILE: HOSTILE})]
    return render(results, {title: frames}, {"seed": "1", HOSTILE: HOSTILE}, [5.0, 7.0, 30.0])


def test_no_text_becomes_markup(page: str) -> None:
    tags = Page(page).tags
    assert not {"script", "iframe", "object", "link", "base", "form"} & {tag for tag, _ in tags}
    assert not [name for _, attributes in tags for name in attributes if name.startswith("on")]
    assert HOSTILE not in page and "&lt;script&gt;alert(1)" in page


def test_the_page_loads_nothing(page: str) -> None:
    for _, attributes in Page(page).tags:
        for name in ("src", "href", "srcset", "data", "action", "xlink:href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:image/", "#"))
    assert not re.search(r"url\(|@import|https?://", page)
    assert "default-src 'none'" in page


def test_the_page_says_what_the_numbers_say(page: str, compared: Comparison) -> None:
    assert f"{compared.scores['mean_recall']:.3f}" in page
    assert "0.864" in page and "0.732" in page
    assert "7.0 s" in page and "6 frames of 3 people" in page
    assert page.count("data:image/") == 6 * 5


def test_a_report_is_not_overwritten_unasked(compared: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "new" / "report.html"
    write_report(path, [Result("Network", compared)])
    with pytest.raises(ExistsError):
        write_report(path, [Result("Network", compared)])
    write_report(path, [Result("Other", compared)], overwrite=True)
    assert "Other" in path.read_text() and [p.name for p in path.parent.iterdir()] == ["report.html"]
    with pytest.raises(CloudError, match="0 results"):
        write_report(tmp_path / "none.html", [])


def test_a_report_of_one_poor_frame_still_renders(compared: Comparison) -> None:
    """Nothing but background in truth and prediction: every score is absent, none is 0 or 1."""
    matrices = np.zeros((1, 12, 12), np.int64)
    matrices[0, 0, 0] = 50
    zeros = {"borders": (1, 4), "by_distance": compared.by_distance[:1].shape, "undefined": (1, 3)}
    counts = {name: np.zeros(shape, np.int64) for name, shape in zeros.items()}
    empty = Comparison(("a",), ("x",), matrices, **counts)
    Page(render([Result("Empty", empty)], {}, {}))


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs chromium")
def test_a_browser_draws_the_page(page: str, tmp_path: Path) -> None:
    path, picture = tmp_path / "report.html", tmp_path / "report.png"
    path.write_text(page)
    arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1280,900"]
    command = ["chromium", *arguments, f"--user-data-dir={tmp_path}/profile", f"--screenshot={picture}"]
    subprocess.run([*command, path.as_uri()], check=True, capture_output=True, timeout=60)
    drawn = cv2.imread(str(picture))
    assert drawn.shape[:2] == (900, 1280) and drawn.std() > 10
