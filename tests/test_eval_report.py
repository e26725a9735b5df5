"""The report's images, clouds, tables and page."""

import base64
import csv
import hashlib
import io
import json
import re
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from annotate.crop import SIZE
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND, BODY_PARTS, PAPER, PARTS, UNDEFINED, palette_rgb
from eval.compare.compare import Comparison, compare_sets
from eval.compare.results import Result, save_result
from eval.report import frame_images as figures
from eval.report import numbers
from eval.report.figures import plain
from eval.report.frame_images import render_thermal_cloud
from eval.report.gallery import (
    SCENE_POINTS,
    cloud_picture,
    make_frame,
    make_scene,
    make_shown_frame,
    pick_frames,
    points_of,
)
from eval.report.gather import Material, Sources, gather
from eval.report.page import render, sections, write_report
from eval.report.training_history import load_training
from sensors.errors import CloudError, ExistsError, FormatError
from tests.helpers.browser import Browser, chromium
from tests.helpers.report_doll import (
    CAMERA,
    HOSTILE,
    cloud,
    guessed,
    hostile_material,
    label_sets,
    person,
    trained,
)


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[LabelSet, LabelSet]:
    return label_sets(tmp_path_factory.mktemp("sets"))


@pytest.fixture(scope="module")
def compared(sets: tuple[LabelSet, LabelSet]) -> Comparison:
    return compare_sets(*sets)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(tmp_path_factory.mktemp("trained") / "compact")


@pytest.fixture(scope="module")
def material(sets: tuple[LabelSet, LabelSet], compared: Comparison, run: Path) -> Material:
    return hostile_material(sets, compared, run)


def test_picked_frames_are_the_extremes_and_never_twice(compared: Comparison) -> None:
    picked = pick_frames(compared, each=2)
    ranked = [compared.frame_ids[i] for i in np.argsort(compared.frame_miou, kind="stable")]
    assert picked["Worst"] == ranked[:2] and picked["Best"] == ranked[::-1][:2]
    everything = [*picked["Worst"], *picked["Random"], *picked["Best"]]
    assert len(everything) == len(set(everything)) == 6
    assert sum(map(len, pick_frames(compared, each=5).values())) == 6


def test_colours_follow_their_meaning() -> None:
    truth = np.array([[0, 0, 3, 3, 3, 3, 3, UNDEFINED]], np.uint8)
    guess = np.array([[0, 2, 3, 4, 0, 5, 11, 3]], np.uint8)
    image = figures.colorize_error(truth, guess, PAPER)[0]
    kinds = ["invented_person", "left_right_swap", "missed_person", "neighbour_part", "other_part"]
    for pixel, kind in zip((1, 3, 4, 5, 6), kinds, strict=True):
        assert tuple(image[pixel]) == figures.ERROR_KINDS[kind][1]
    assert len({tuple(p) for p in image}) == 8
    assert (figures.colorize_parts(truth, PAPER)[truth == 3] == PARTS[3].rgb).all()
    depth = figures.colorize_depth(np.array([[0, 800, 1600]], np.uint16))[0]
    assert tuple(depth[0]) == figures.CANVAS and depth[1, 0] > depth[2, 0]


def test_a_row_of_pictures_shows_the_person_large_and_whole() -> None:
    truth = person(0)
    row = make_frame(truth, guessed(truth, 0), partial(cloud_picture, cloud(truth)))
    assert {image.shape for image in row.columns.values()} == {(SIZE, SIZE, 3)}
    shown = row.columns["Target labels"].reshape(-1, 3)
    assert {tuple(c) for c in shown} == {tuple(palette_rgb()[part]) for part in np.unique(truth.parts)}
    share = (shown != palette_rgb()[BACKGROUND]).any(axis=1).mean()
    assert share > np.mean(truth.parts > 0)
    empty = replace(truth, parts=np.zeros_like(truth.parts))
    assert (make_shown_frame(empty).columns["Labels"] == palette_rgb()[BACKGROUND]).all()


def test_a_nearer_point_hides_a_farther_one() -> None:
    """A warm sheet and a cold one behind it on the same rays, in either order: only warm is seen."""
    v, u = np.mgrid[:60, :60]
    rays = np.stack([(u - 30) / 60, (v - 30) / 60, np.ones((60, 60))], -1)
    sheets = [(rays * 1.0, np.full((60, 60), 36.0)), (rays * 1.5, np.full((60, 60), 18.0))]
    for first, second in (sheets, sheets[::-1]):
        points = np.concatenate([first[0], second[0]]).astype(np.float32)
        warm = np.concatenate([first[1], second[1]]).astype(np.float32)
        image = render_thermal_cloud(points, warm, yaw_deg=0, pitch_deg=0).astype(int).sum(-1)
        assert image[80:130, 80:130].min() > 500
    hidden = np.full((8, 8, 3), np.nan, np.float32)
    assert (render_thermal_cloud(hidden, hidden[..., 0]) == figures.CANVAS).all()


def test_a_scene_holds_the_points_it_shows() -> None:
    """Unprojected by hand; a crop has the points of its image."""
    truth, predicted = person(0), guessed(person(0), 0)
    scene = make_scene("doll", predicted, CAMERA, truth, cloud(truth))
    assert scene is not None and set(scene.colors) == {"truth", "predicted", "error", "temperature_c"}
    assert len(scene.points_mm) <= SCENE_POINTS and {len(v) for v in scene.colors.values()} == {
        len(scene.points_mm)
    }
    assert set(scene.colors["truth"].tolist()) >= {part.id for part in BODY_PARTS}
    spread = np.ptp(scene.points_mm[scene.colors["truth"] == 1], axis=0)
    assert (spread[:2] > 100).all() and (spread < 500).all()
    v, u = 40, 60
    z = truth.depth_mm[v, u] / 1000
    assert points_of(truth, CAMERA)[v, u] == pytest.approx([(u - 47.5) / 90 * z, (v - 39.5) / 90 * z, z])
    whole = FrameLabels("a", np.full((212, 212), 2000, np.uint16), np.zeros((212, 212), np.uint8))
    crop = replace(whole, notes={"crop": [10, 20, 106]})
    with pytest.raises(FormatError, match="malformed"):
        points_of(replace(whole, notes={"crop": [10, 20, 0]}), CAMERA)
    assert points_of(crop, CAMERA)[100, 60] == pytest.approx([(49.75 - 47.5) / 45, (59.75 - 39.5) / 45, 2.0])
    empty = replace(truth, parts=np.zeros_like(truth.parts))
    assert make_scene("empty", empty, CAMERA) is None


def test_pictures_come_from_the_sets_that_were_measured(
    sets: tuple[LabelSet, LabelSet], compared: Comparison, tmp_path: Path
) -> None:
    lying = {"predicted": str(sets[0].path), "truth": str(sets[1].path)}
    results = [Result("Network", compared, lying), Result("Elsewhere", compared)]
    material = gather(Sources(results, each=1))
    assert [frame.group for frame in material.galleries["Network"]] == ["Worst", "Random", "Best"]
    assert not material.galleries["Elsewhere"] and len(material.scenes) == 3
    changed, truth = label_sets(tmp_path)
    worst = pick_frames(compared, 1)["Worst"][0]
    changed.write(replace(changed.read(worst), parts=truth.read(worst).parts))
    moved = Result("Changed", compared, {**lying, "predicted": str(changed.path)})
    other = replace(compared, frame_ids=tuple(f"{frame_id}9" for frame_id in compared.frame_ids))
    for result, frame in ((moved, worst), (Result("Other frames", other, lying), r"\d+9")):
        with pytest.raises(CloudError, match=f"frame {frame} .* evaluate again"):
            gather(Sources([result], each=1))


def test_a_training_is_read_back(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = load_training(run)
    monkeypatch.setattr("eval.report.training_history.MAX_BYTES", (run / "history.json").stat().st_size - 1)
    with pytest.raises(FormatError, match="larger than"):
        load_training(run)
    monkeypatch.undo()
    assert training.points.shape == (24, 2) and training.epochs.shape == (12, 5)
    assert np.isnan(training.epochs[:, 3]).all() and training.epochs[-1, 2] == 0.8
    names = list(training.pictures)
    assert names[0] == "Depth" and names[-1] == "Truth" and {"Epoch 0", "Epoch 12"} <= set(names)
    for content in ("{}", "[", f'{{"points": [], "epochs": [], "images": {10**400}}}'):
        (tmp_path / "history.json").write_text(content)
        with pytest.raises(FormatError, match="not a history"):
            load_training(tmp_path)


@pytest.fixture(scope="module")
def page(material: Material) -> str:
    return render(material)


class Tags(HTMLParser):
    """Tags with their attributes, and the text of each script."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1][0] == "script" and data.strip():
            self.scripts.append(data)


def test_no_text_becomes_markup_and_only_the_page_s_own_scripts_run(page: str) -> None:
    parsed = Tags(page)
    tags = [tag for tag, _ in parsed.tags]
    assert not {"iframe", "object", "link", "base", "form", "embed"} & set(tags)
    assert tags.count("script") == len(parsed.scripts) == 3
    assert not [name for _, attributes in parsed.tags for name in attributes if name.startswith("on")]
    assert HOSTILE not in page and "<script>window" not in page and "&lt;script&gt;window" in page
    policy = next(a["content"] for tag, a in parsed.tags if a.get("http-equiv") == "Content-Security-Policy")
    allowed = re.findall(r"'sha256-([^']+)'", policy or "")
    digests = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in parsed.scripts[1:]]
    assert allowed == digests and "default-src 'none'" in (policy or "")


def test_the_page_loads_nothing(page: str) -> None:
    parsed = Tags(page)
    links = [tag.get(name) for _, tag in parsed.tags for name in ("src", "href", "srcset", "data", "action")]
    assert all(link is None or link.startswith(("data:image/", "#")) for link in links)
    for script in parsed.scripts:
        page = page.replace(script, "")
    assert not re.search(r"url\(|@import|https?://", page)


def test_the_page_shows_the_numbers(page: str, compared: Comparison) -> None:
    assert f"{compared.scores['mean_recall']:.3f}" in page and "0.864" in page and "0.732" in page
    assert "6 frames of 3 people" in page and "2026-01-02 to 2026-01-03" in page
    rows, columns, shown, training = 6, 4, 6 * 3, 9
    assert [tag for tag, _ in Tags(page).tags].count("img") == rows * columns + shown + training


def test_figures_show_hostile_names_letter_by_letter(material: Material) -> None:
    found = [figure for section in sections(material) for figure in section.drawn.values()]
    assert len(found) >= 15
    assert all("<img" not in figure.to_json().replace("\\u003c", "<") for figure in found)
    assert plain("<b>&") == "&lt;b&gt;&amp;" and len(plain("x" * 90, 28)) == 28


def test_absent_scores_are_left_out(compared: Comparison) -> None:
    """Nothing but background, no confidence: every score is absent, none is 0 or 1."""
    blank = replace(compared.counts, flat=np.zeros_like(compared.counts.flat))
    blank.confusion[:, 0, 0] = 50
    empty = replace(compared, counts=blank, joints_mm=None)
    titles = {section.title for section in sections(Material((Result("Empty", empty),)))}
    assert not {"Calibration", "Gallery", "Joints"} & titles and {"Headline", "Parts"} <= titles
    assert "--" in render(Material((Result("Empty", empty),)))


def test_a_browser_draws_every_figure_and_asks_for_nothing(page: str, tmp_path: Path) -> None:
    if chromium() is None:
        pytest.skip("needs chromium")
    (tmp_path / "report.html").write_text(page)
    browser = Browser(tmp_path / "profile")
    try:
        browser.open(tmp_path / "report.html")
        flat = "places.filter(place => !figures[place.dataset.figure].layout.scene)"
        assert browser.run(f"{flat}.every(place => place.data)") and browser.run(f"{flat}.length") >= 12
        scene = "places.find(place => figures[place.dataset.figure].layout.scene)"
        browser.run(f"{scene}.scrollIntoView()")
        look = f"const look = () => {scene}.data ? done(true) : setTimeout(look, 50)"
        assert browser.run(f"new Promise(done => {{ {look}; look(); }})")
        assert browser.run("window.hit") is None
        foreign = "svg a, svg foreignObject, img:not([src^='data:'])"
        assert browser.run(f'document.querySelectorAll("{foreign}").length') == 0
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        picture = cv2.imdecode(np.frombuffer(browser.picture(), np.uint8), cv2.IMREAD_COLOR)
        assert picture.std() > 10 and browser.pdf().startswith(b"%PDF")
        events = [e for e in browser.events if e["method"] == "Network.requestWillBeSent"]
        sent = [event["params"]["request"]["url"] for event in events]
        assert all(url.startswith(("file:", "data:image/", "blob:")) for url in sent)
        kinds = ("Runtime.exceptionThrown", "Log.entryAdded")
        faults = [e["params"] for e in browser.events if e["method"] in kinds]
        assert not [fault for fault in faults if fault.get("entry", {}).get("level") != "warning"]
    finally:
        browser.close()


def test_the_tables_hold_the_same_numbers(material: Material, compared: Comparison) -> None:
    texts = numbers.texts(material)
    rows = list(csv.DictReader(io.StringIO(texts[".csv"])))
    found = {(row["result"], row["score"], row["part"]): row["value"] for row in rows}
    miou, recall = (float(found["Automatic", *key]) for key in (("miou", ""), ("recall", "head")))
    assert [miou, recall] == pytest.approx(
        [float(compared.scores["miou"]), compared.scores["recall"][1]], abs=1e-6
    )
    assert float(found["Paper, real", "recall", "head"]) == 0.69
    value = json.loads(texts[".json"])
    assert value["results"][0]["miou"] == pytest.approx(float(compared.scores["miou"]))
    assert [one["b"] for one in value["differences"]] == ["Automatic"]
    assert texts[".tex"].count(r"\begin{tabular}") == 5 and f"{compared.scores['miou']:.3f}" in texts[".tex"]


def test_hostile_titles_stay_text_in_every_table(compared: Comparison) -> None:
    result = Result("=1+1,\\input{x}\n%_&", compared)
    assert list(csv.reader(io.StringIO(numbers.to_csv([result]))))[1][0].startswith("'=1+1")
    latex = numbers.to_latex(Material((result,)))
    assert r"\textbackslash{}input\{x\}\%\_\&" in latex and r"\input{x}" not in latex


def test_the_same_results_give_the_same_bytes(material: Material, page: str, tmp_path: Path) -> None:
    written = [path.read_bytes() for path in write_report(tmp_path / "report.html", material)]
    again = [*numbers.texts(material).values(), page]
    assert written == [text.encode(errors="replace") for text in again]


def test_a_report_is_not_overwritten_unasked(compared: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "new" / "report.html"
    written = write_report(path, Material((Result("Network", compared),)))
    assert [p.name for p in written] == ["report.csv", "report.json", "report.tex", "report.html"]
    path.unlink()
    with pytest.raises(ExistsError, match=r"report\.csv already exists"):
        write_report(path, Material((Result("Other", compared),)))
    assert not path.exists() and "Network" in path.with_suffix(".csv").read_text()
    write_report(path, Material((Result("Other", compared),)), overwrite=True)
    assert "Other" in path.read_text() and len(list(path.parent.iterdir())) == 4
    with pytest.raises(CloudError, match="give a name that ends in"):
        write_report(tmp_path / "a.json", Material((Result("Other", compared),)))
    for results, message in (((), "0 results"), ((Result("Same", compared),) * 2, "have the title 'Same'")):
        with pytest.raises(CloudError, match=message):
            Material(results)


def test_text_that_cannot_be_written_becomes_a_question_mark(compared: Comparison, tmp_path: Path) -> None:
    half = "a\ud800b"
    odd = replace(
        compared,
        frame_ids=(half, *compared.frame_ids[1:]),
        subjects=(half,) * len(compared.subjects),
        traits=tuple(replace(traits, hard=(half,), activity=half) for traits in compared.traits),
    )
    written = write_report(tmp_path / "r.html", Material((Result(half, odd, {half: half}),)))
    texts = {path.suffix: path.read_text() for path in written}
    assert len(texts) == 4 and "a?b" in texts[".html"]


def test_the_verb_takes_everything_there_is_to_show(
    annotate_cloud, sets: tuple[LabelSet, LabelSet], compared: Comparison, run: Path, tmp_path: Path
) -> None:
    result, page = tmp_path / "a.json", tmp_path / "report.html"
    save_result(result, Result("Network", compared))
    shown = ("--shown", sets[0].path, "--note", "A remark on real scans", "--audit", sets[0].path)
    given = ("report", result, "--out", page, "--ceiling", result, "--history", run, *shown)
    assert annotate_cloud(*given).code == 0
    text = page.read_text()
    assert "A remark on real scans" in text and "Epoch 12" in text
    for taken in (page, page.with_suffix(".csv")):
        again = annotate_cloud(*given)
        assert again.code == 1 and f"{taken.name} already exists" in again.err
        page.unlink(missing_ok=True)
    assert annotate_cloud("report", result, "--out", page, "--note", "of nothing", "--overwrite").code == 2
    nowhere = annotate_cloud("report", result, "--out", page, "--history", tmp_path, "--overwrite")
    assert nowhere.code == 1 and "history.json cannot be read" in nowhere.err and nowhere.err.count("\n") == 1
