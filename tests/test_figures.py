"""The documentation's figures: measured once for a seed, compared, written into pages."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tools.figures import table as measuring
from tools.figures.figure import Figure, mean, median, moved, share
from tools.figures.pages import MARK, MOVED, SOURCES, spliced, write_pages
from tools.figures.table import ROOT, Table, changes, is_done, load, measure
from tools.figures.tables import TABLES


def drawn(seed):
    numbers = np.random.default_rng(seed).normal(0.5, 0.1, 40)
    return {"all": {"score": mean(numbers.tolist()), "frames": Figure(40)}, "none": {"frames": Figure(0)}}


TABLE = Table("one", "virtual", "about it.", ("page.md",), {"frames": ".0f", "score": ".3f"}, drawn)


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A folder of pages, one with the marks of the table."""
    (tmp_path / "docs").mkdir()
    for page in ("page.md", "docs/figures.md"):
        marks = ["one"] if page == "page.md" else [SOURCES, MOVED]
        blocks = "".join(f"<!-- figures: {name} -->\nold\n<!-- end of figures -->\n" for name in marks)
        (tmp_path / page).write_text(f"before\n\n{blocks}after\n")
    monkeypatch.setattr(measuring, "_git", lambda *words: "abc\n")
    return tmp_path


def test_a_table_is_measured_once_for_a_seed_and_a_product(house):
    kept = house / "docs" / "figures"
    first = measure(TABLE, 1, "p", kept)
    again = load(TABLE, kept)
    np.testing.assert_allclose(again.rows["all"]["score"], first.rows["all"]["score"], rtol=1e-5)
    assert again.rows["all"]["frames"].value == 40 and again.rows["all"]["frames"].certain
    assert is_done(TABLE, again, 1, "p")
    assert not is_done(TABLE, again, 2, "p") and not is_done(TABLE, again, 1, "q")
    assert is_done(replace(TABLE, seeded=False), again, 2, "p") and not is_done(TABLE, None, 1, "p")
    second = measure(TABLE, 2, "p", kept)
    assert second.before["all"]["score"] == again.rows["all"]["score"] and "seed 1" in second.before_from
    assert [(row, column) for row, column, *_ in changes(TABLE, second)] == [("all", "score")]


def test_pages_hold_what_was_measured_and_nothing_else_changes(house):
    measure(TABLE, 1, "p", house / "docs" / "figures")
    assert {path.name for path in write_pages([TABLE], house)} == {"page.md", "figures.md"}
    text = (house / "page.md").read_text()
    assert text.startswith("before\n\n") and text.endswith("after\n") and "old" not in text
    assert "| none | 0 | - |" in text and "seed 1" in text
    assert write_pages([TABLE], house) == []
    unmeasured = replace(TABLE, name="two", pages=())
    marks = "<!-- figures: two -->\nold\n<!-- end of figures -->\n"
    assert spliced(marks, lambda name: None) == marks and load(unmeasured, house) is None


@given(st.floats(0.01, 0.99), st.floats(0.0, 0.2), st.floats(0.001, 0.2), st.floats(0.001, 0.2))
def test_a_move_lies_outside_the_interval_of_the_difference(value, apart, one, other):
    assume(apart == 0 or abs(apart - math.hypot(one, other)) > 1e-9)
    a = Figure(value, value - one, value + one)
    b = Figure(value + apart, value + apart - other, value + apart + other)
    assert (
        moved(a, b, ".3f") == moved(b, a, ".3f") == (apart > 0 and b.value - a.value > math.hypot(one, other))
    )
    assert not moved(a, a, ".3f")
    assert not moved(a, Figure(math.nan), ".3f")
    assert moved(Figure(0.91), Figure(0.92), ".2f") and not moved(Figure(0.911), Figure(0.912), ".2f")


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng, held = np.random.default_rng(1), {"mean": 0, "median": 0, "share": 0}
    for _ in range(400):
        numbers = rng.normal(0, 1, 30)
        above = int((numbers > 0).sum())
        found = {"mean": mean(numbers), "median": median(numbers), "share": share(above, 30)}
        for name, figure in found.items():
            held[name] += figure.low <= (0.5 if name == "share" else 0) <= figure.high
    assert all(0.92 < count / 400 <= 0.99 for count in held.values()), held


def test_the_documentation_holds_the_figures_that_were_kept(tmp_path):
    assert len({table.name for table in TABLES}) == len(TABLES)
    known = {table.name: table for table in TABLES}
    for page in {page for table in TABLES for page in table.pages} | {"docs/figures.md"}:
        text = (ROOT / page).read_text()
        marked = {match["name"] for match in MARK.finditer(text)} - {SOURCES, MOVED}
        assert marked == {name for name, table in known.items() if page in table.pages}, page
        (tmp_path / page).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / page).write_text(text)
    (tmp_path / "docs" / "figures").symlink_to(ROOT / "docs" / "figures")
    assert write_pages(list(TABLES), tmp_path) == []
