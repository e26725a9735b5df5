"""The measuring tools and benchmarks: each can be imported, and the quick ones print their tables."""

import importlib
from pathlib import Path

import pytest

from annotate.engine import Engine
from tools.measure.ablation import labelled, row
from tools.measure.labels import print_figures

ROOT = Path(__file__).parent.parent
ALONE = {"tools.fuzz.run"}
"""Instruments what is imported after it: it needs a process of its own, and an extra."""
PATHS = [path.relative_to(ROOT) for folder in ("tools", "bench") for path in (ROOT / folder).rglob("*.py")]
MODULES = sorted({".".join(path.with_suffix("").parts) for path in PATHS} - ALONE)


@pytest.mark.parametrize("name", MODULES)
def test_a_tool_can_be_imported_and_shows_how_it_is_run(name):
    module = importlib.import_module(name)
    runs = "__main__" in Path(module.__file__).read_text()
    assert runs == (f"python -m {name}" in module.__doc__)


def test_the_engine_is_measured_against_a_simulated_session(rig_session, capsys):
    print_figures([rig_session])
    figures = dict(line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:])
    assert float(figures["mean recall"]) > 0.9 and 0 <= float(figures["calibration error"]) < 0.1


def test_without_a_difference_the_interval_of_a_row_is_empty(rig_session):
    whole = labelled(rig_session, Engine())
    cells = row("nothing", whole, whole).strip("| ").split(" | ")
    assert cells[0] == "nothing" and len(cells) == 5
    assert all(cell.endswith("]") and "+0.0" in cell for cell in cells[1:4])
