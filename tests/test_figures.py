"""The documentation's figures: measured on the seed of a commit, compared by people, written into pages."""

import csv
import json
import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from annotate.parts import PAPER
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import predict_source
from eval.scores.confusion import mean_recall
from sensors.errors import CloudError
from sensors.importers.open_source import open_source
from synth.images.generate import Order, generate
from synth.images.presets import preset_named
from tests.helpers.real_takes import first_frames
from tools.figures import network, run
from tools.figures import table as measuring
from tools.figures.figure import Figure, average, median, moved, of_values, over_people, ratio
from tools.figures.pages import DERIVED, MARK, MOVED, PAGES, joined, spliced, write_pages
from tools.figures.table import (
    FIRST_SEED,
    KEPT,
    ROOT,
    Table,
    changes,
    commit_judged,
    is_done,
    judging_seed,
    load,
    measure,
    product_digest,
    rounded,
    save,
    seed_of,
)
from tools.figures.tables import TABLES
from tools.measure import real_people
from tools.measure.network_groups import measured

COMMIT, OTHER = "e68d388aa001", "41406c9fbb02"
PEOPLE = [f"p{i % 8}" for i in range(40)]


def drawn(seed):
    numbers = np.random.default_rng(seed).normal(0.5, 0.1, 40)
    score = of_values(numbers.tolist(), PEOPLE, average)
    return {"all": {"score": score, "frames": Figure(40)}, "none": {"frames": Figure(0)}}


TABLE = Table(
    "one", "virtual", "about it.", "Nothing.", ("page.md",), {"frames": ".0f", "score": ".3f"}, drawn
)


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A folder of pages, one with the marks of the table."""
    (tmp_path / "docs").mkdir()
    for page in ("page.md", *PAGES):
        marks = {"page.md": ["one"], "docs/figures.md": [MOVED]}.get(page, [])
        blocks = "".join(f"<!-- figures: {name} -->\nold\n<!-- end of figures -->\n" for name in marks)
        (tmp_path / page).write_text(f"before\n\n{blocks}after\n")
    return tmp_path


def test_a_table_is_measured_once_for_a_commit_and_a_product(house):
    kept = house / "docs" / "figures"
    first = measure(TABLE, COMMIT, "p", kept)
    again = load(TABLE, kept)
    assert again == first and first.seed == judging_seed(COMMIT) == FIRST_SEED + 0xE68D388
    np.testing.assert_allclose(again.rows["all"]["score"][:3], drawn(first.seed)["all"]["score"][:3], 1e-5)
    assert again.rows["all"]["frames"].value == 40 and again.rows["all"]["frames"].certain
    assert len(again.rows["all"]["score"].without) == 8
    assert is_done(TABLE, again, COMMIT, "p") and not is_done(TABLE, None, COMMIT, "p")
    assert not is_done(TABLE, again, OTHER, "p") and not is_done(TABLE, again, COMMIT, "q")
    assert not is_done(TABLE, replace(again, seed=31000), COMMIT, "p")
    second = measure(TABLE, OTHER, "p", kept)
    assert second.before == again.rows and f"seed {first.seed}" in second.before_from
    found = changes(TABLE, second.before, second.rows, paired=False)
    assert [(one.row, one.column) for one in found] == [("all", "score")]


def test_a_run_goes_on_at_its_commit_while_the_product_stays(house):
    kept = house / "docs" / "figures"
    begun = measure(TABLE, COMMIT, "p", kept)
    assert commit_judged([None, begun], "p") == COMMIT
    by_hand = replace(begun, seed=31000)
    here = measuring._git("rev-parse", "--short=12", "HEAD").strip()
    assert commit_judged([begun], "q") == commit_judged([by_hand], "p") == commit_judged([], "p") == here


def test_a_product_that_differs_from_its_commit_is_refused(tmp_path, monkeypatch):
    def git(*words):
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a", *words], cwd=tmp_path, check=True)

    monkeypatch.setattr(measuring, "ROOT", tmp_path)
    (tmp_path / "eval").mkdir()
    (tmp_path / "eval" / "a.py").write_text("a")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "a")
    clean = product_digest()
    (tmp_path / "eval" / "a.md").write_text("prose")
    (tmp_path / "README.md").write_text("figures")
    assert product_digest() == clean
    for name, text in (("a.py", "b"), ("new.py", "c")):
        (tmp_path / "eval" / name).write_text(text)
        with pytest.raises(CloudError, match=rf"first eval/{name}; commit them, or give --seed"):
            product_digest()
        git("stash", "-uq")
    (tmp_path / "eval" / "a.py").write_text("b")
    git("commit", "-qam", "b")
    assert product_digest() != clean


@pytest.mark.parametrize("how", [["--seed", "7"], ["--again"]])
def test_a_development_run_prints_and_writes_nothing(how, house, monkeypatch, capsys):
    kept = house / "docs" / "figures"
    measure(TABLE, COMMIT, "p", kept)
    before = {path: path.read_bytes() for path in house.rglob("*") if path.is_file()}
    worse = replace(TABLE, measure=lambda seed: {"all": {"score": Figure(0.1)}})
    monkeypatch.setattr(run, "TABLES", (worse,))
    monkeypatch.setattr(run, "load", lambda table: load(table, kept))
    monkeypatch.setattr("sys.argv", ["run", *how])
    run.main()
    said = capsys.readouterr().out
    assert "development seed 7" in said if "7" in how else "one: all, score" in said and "1 of them" in said
    assert {path: path.read_bytes() for path in house.rglob("*") if path.is_file()} == before


def test_pages_hold_what_was_measured_and_nothing_else_changes(house):
    seed = measure(TABLE, COMMIT, "p", house / "docs" / "figures").seed
    assert {path.name for path in write_pages([TABLE], house)} == {"page.md", "figures.md", "moved.csv"}
    text = (house / "page.md").read_text()
    assert text.startswith("before\n\n") and text.endswith("after\n") and "old" not in text
    assert "| none | 0 | - |" in text and f"seed {seed}" in text and "Nothing." in text
    assert write_pages([TABLE], house) == []
    unmeasured = replace(TABLE, name="two", pages=())
    marks = "<!-- figures: two -->\nold\n<!-- end of figures -->\n"
    assert spliced(marks, lambda name: None) == marks and load(unmeasured, house) is None


def test_a_moved_figure_is_a_line_of_a_file(house):
    kept = house / "docs" / "figures"
    measure(TABLE, COMMIT, "p", kept)
    worse = replace(TABLE, measure=lambda seed: {"all": {"score": Figure(0.1, 0.05, 0.15)}})
    found = measure(worse, OTHER, "p", kept)
    assert kept / f"{MOVED}.csv" in write_pages([TABLE], house)
    (line,) = list(csv.reader((kept / f"{MOVED}.csv").read_text().splitlines()))[1:]
    assert line[:3] == ["one", "all", "score"] and line[4].startswith("0.100 (0.050")
    assert line[5] == found.before_from
    text = (house / "docs" / "figures.md").read_text()
    assert "1 figures stood here before; 1 of them" in text and f"figures/{MOVED}.csv" in text


def test_a_table_apart_is_a_csv_file_that_its_page_shows(house):
    apart = replace(TABLE, apart=True)
    measure(apart, COMMIT, "p", house / "docs" / "figures")
    assert house / "docs" / "figures" / "one.csv" in write_pages([apart], house)
    lines = (house / "docs" / "figures" / "one.csv").read_text().splitlines()
    assert lines[0] == ",frames,score" and lines[2] == "none,0,-"
    text = (house / "page.md").read_text()
    assert all(x in text for x in ("\n[one.csv](figures/one.csv):\n", ":file: figures/one.csv", "about it."))
    assert "| none |" not in text and write_pages([apart], house) == []


def test_rows_of_the_same_cells_are_one_row():
    rows = {"a": ["1", "-"], "b": ["2", "-"], "c": ["1", "-"]}
    assert list(joined(rows)) == [("a; c", ("1", "-")), ("b", ("2", "-"))]


@given(st.floats(0.01, 0.99), st.floats(0.0, 0.2), st.floats(0.001, 0.2), st.floats(0.001, 0.2))
def test_other_recordings_move_outside_the_interval_of_the_difference(value, apart, one, other):
    assume(apart == 0 or abs(apart - math.hypot(one, other)) > 1e-9)
    a = Figure(value, value - one, value + one)
    b = Figure(value + apart, value + apart - other, value + apart + other)
    far = b.value - a.value > math.hypot(one, other) and f"{a.value:.3f}" != f"{b.value:.3f}"
    assert moved(a, b, ".3f", False) == moved(b, a, ".3f", False) == far
    assert not moved(a, a, ".3f", False) and not moved(a, Figure(math.nan), ".3f", False)
    assert not moved(Figure(0.91), Figure(0.92), ".2f", False)
    assert moved(Figure(0.91), Figure(0.92), ".2f", True)
    assert not moved(Figure(0.911), Figure(0.912), ".2f", True)


def test_the_same_recordings_move_by_a_paired_test():
    """Of changes without an effect, 5 % are called moved; a small common loss is seen among unlike people."""
    rng, chance, seen = np.random.default_rng(1), 0, 0
    for _ in range(400):
        people = rng.normal(0.9, 0.05, 8)[np.arange(40) % 8]
        old = of_values(people, PEOPLE, average, 200)
        own = rng.normal(0, 0.005, 8)[np.arange(40) % 8]
        same, worse = (of_values(people + own - lost, PEOPLE, average, 200) for lost in (0.0, 0.01))
        chance += moved(old, same, ".9f", True)
        seen += moved(old, worse, ".9f", True)
        assert not moved(old, worse, ".9f", False)
    assert 0.03 <= chance / 400 <= 0.07 and seen / 400 > 0.95


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Frames of a person are alike: an interval over frames would hold it in half of the sets."""
    rng, held = np.random.default_rng(1), {"mean": 0, "median": 0, "share": 0}
    subjects = [f"p{i // 8}" for i in range(160)]
    for _ in range(400):
        numbers = np.repeat(rng.normal(0, 1, 20), 8) + rng.normal(0, 0.5, 160)
        above = np.stack([numbers > 0, np.ones(160)], axis=-1).astype(np.int64)
        found = {
            "mean": of_values(numbers, subjects, average, 200),
            "median": of_values(numbers, subjects, median, 200),
            "share": over_people(above, subjects, ratio),
        }
        for name, figure in found.items():
            held[name] += figure.low <= (0.5 if name == "share" else 0) <= figure.high
    assert all(0.92 < count / 400 <= 0.99 for count in held.values()), held


@given(st.lists(st.integers(0, 9), min_size=1, max_size=9), st.integers(0, 99))
def test_statistics_of_copies_are_the_statistics_of_the_repeated_values(values, seed):
    copies = np.random.default_rng(seed).integers(0, 4, (5, len(values))) + (np.arange(len(values)) == 0)
    numbers = np.array(values, float)
    repeated = [np.repeat(numbers, row) for row in copies]
    np.testing.assert_allclose(median(numbers, copies), [np.median(row) for row in repeated])
    np.testing.assert_allclose(average(numbers, copies), [np.mean(row) for row in repeated])


def test_a_person_has_no_interval_and_people_without_an_error_have_the_rule_of_three():
    right = np.ones((12, 2), np.int64)
    for lone in (over_people(right, ["anna"] * 12, ratio), of_values([1.0, 1.0], ["anna"] * 2, average)):
        assert (lone.value, lone.certain, lone.without) == (1.0, True, ())
    four = over_people(right, list("abcd") * 3, ratio)
    assert four[:3] == (1.0, 0.25, 1.0) and four.without == (1.0,) * 4
    assert of_values([1.6] * 8, list("abcd") * 2, median).certain


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Judging images of several people; the shipped network's counts, twice, and with 1 % of wrong pixels."""

    seen = {}

    class Remembering(OnnxNetwork):
        def outputs(self, depth):
            if (key := depth.tobytes()) not in seen:
                seen[key] = super().outputs(depth)
            return seen[key]

    class Worse(Remembering):
        def outputs(self, depth):
            planes, *rest = super().outputs(depth)
            rng = np.random.default_rng(3)
            wrong = rng.random(planes[:, 0].shape) < 0.0125  # a random part is wrong in 10 of 11 draws
            part = rng.integers(1, planes.shape[1], planes[:, 0].shape)
            planes = planes.copy()
            for number in range(1, planes.shape[1]):
                planes[:, number][wrong & (part == number)] = planes.max() + 1
            return planes, *rest

    out = tmp_path_factory.mktemp("images") / "d"
    preset = replace(preset_named("sitting-test", "judge"), each=2)
    with network.ThreadPoolExecutor(1) as thread:
        generate(Order(preset, 20, 7), out, network.Workers(thread, 1), lambda n: None)
    networks = OnnxNetwork(), Remembering(), Worse()
    return [measured(one.in_scheme(PAPER), out)["all"] for one in networks]


def test_a_hundredth_of_recall_is_seen_and_a_run_again_is_not(images):
    kept, again, worse = (rounded({"all": network.scores(tally, False)}) for tally in images)
    lost = kept["all"]["mean recall"].value - worse["all"]["mean recall"].value
    assert lost == pytest.approx(0.01, abs=0.004)
    table = next(table for table in TABLES if table.name == "network")
    assert not any(one.moved for one in changes(table, kept, again, paired=True))
    found = {one.column: one for one in changes(table, kept, worse, paired=True)}
    assert found["mean recall"].moved
    independent = {one.column: one for one in changes(table, kept, worse, paired=False)}
    assert not independent["mean recall"].moved


def test_a_posture_counts_where_another_was_possible(images):
    tally = images[0]
    assert not network.several_postures(tally) and "posture" not in network.scores(tally, False)
    two = replace(tally, true_postures=["sitting"] * network.LEAST + ["lying"] * network.LEAST)
    assert network.several_postures(two)
    assert not network.several_postures(replace(two, true_postures=two.true_postures[:-1]))
    people = len(set(tally.subjects))
    assert 1 < people < len(tally.subjects) / 2
    assert len(network.scores(tally, False)["mean recall"].without) == people
    value = over_people(np.array(tally.matrices), tally.subjects, mean_recall)
    assert network.scores(tally, False)["mean recall"] == value


@pytest.mark.skipif(not real_people.PEOPLE.is_dir(), reason="recordings of real people are absent")
def test_real_people_are_counted_as_their_own_score_does(tmp_path):
    take, net = first_frames(real_people.PEOPLE / "takes" / "a22_s1_t1", tmp_path), OnnxNetwork()
    found = real_people.measure_people(take, net)
    labels = predict_source(open_source(take), net, tmp_path / "p", lambda n: None).labels
    command = [sys.executable, real_people.PEOPLE / "score.py", labels.path, take]
    scored = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    counts = found.joints.sum(0)
    assert set(found.subjects) == {"s1"} and counts[:, 0].sum() == scored["joints"]
    assert round(float(real_people.mean_hit_rate(counts)), 4) == scored["mean_hit_rate"]
    assert round(float(real_people.swap_rate(counts)), 4) == scored["swap_rate"]


def test_the_documentation_holds_the_figures_that_were_kept(tmp_path):
    assert len({table.name for table in TABLES}) == len(TABLES)
    known = {table.name: table for table in TABLES}
    for page in {page for table in TABLES for page in table.pages} | PAGES:
        text = (ROOT / page).read_text()
        marked = {match["name"] for match in MARK.finditer(text)} - {MOVED} - DERIVED.keys()
        assert marked == {name for name, table in known.items() if page in table.pages}, page
        (tmp_path / page).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / page).write_text(text)
    (tmp_path / "docs" / "figures").symlink_to(ROOT / "docs" / "figures")
    assert write_pages(list(TABLES), tmp_path) == []


def stale(tables, folder):
    """Return the names of the tables whose file has another seed than its commit gives."""
    kept = {table.name: (table, load(table, folder)) for table in tables}
    return [name for name, (table, one) in kept.items() if one and one.seed != seed_of(table, one.commit)]


def test_every_figure_was_measured_on_the_seed_of_its_commit():
    assert not stale(TABLES, KEPT)
    assert {path.stem for path in KEPT.glob("*.json")} <= {table.name for table in TABLES}


@pytest.mark.parametrize("seed", [31000, None, judging_seed(OTHER)])
def test_a_seed_that_somebody_chose_is_found(seed, tmp_path):
    found = measure(TABLE, COMMIT, "p", tmp_path)
    assert not stale([TABLE], tmp_path)
    save(TABLE, replace(found, seed=seed), tmp_path)
    assert stale([TABLE], tmp_path) == ["one"]
    assert json.loads((tmp_path / "one.json").read_text())["seed"] == seed


def test_no_seed_of_development_stands_beside_a_figure():
    """Commands of examples may have one: nothing is claimed of their recordings."""
    seeds = re.compile(r"(?<!--)\bseeds? (\d+)")
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        found = [int(number) for number in seeds.findall(path.read_text())]
        assert all(number >= FIRST_SEED for number in found), (path.name, found)
