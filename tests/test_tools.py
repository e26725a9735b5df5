"""Measuring tools and benchmarks: imports, and the ablation."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from annotate.segmentation.input_channels import CHANNELS, network_input
from annotate.segmentation.suit_network import shipped_suit_network
from tools.measure.ablation import INPUTS, Without, labelled, row

ROOT = Path(__file__).parent.parent
ALONE = {"tools.fuzz.run"}
"""Needs its own process and an extra, because it instruments later imports."""
PATHS = [path.relative_to(ROOT) for folder in ("tools", "bench") for path in (ROOT / folder).rglob("*.py")]
MODULES = sorted({".".join(path.with_suffix("").parts) for path in PATHS} - ALONE)


@pytest.mark.parametrize("name", MODULES)
def test_a_tool_can_be_imported_and_shows_how_it_is_run(name):
    module = importlib.import_module(name)
    runs = "__main__" in Path(module.__file__).read_text()
    assert runs == (f"python -m {name}" in module.__doc__)


def test_without_a_difference_the_interval_of_a_row_is_empty(rig_session):
    whole = labelled(rig_session, shipped_suit_network())
    cells = row("nothing", whole, whole).strip("| ").split(" | ")
    assert cells[0] == "nothing" and len(cells) == 6
    assert all(cell.endswith("]") and "+0.0" in cell for cell in cells[1:6])


@pytest.mark.parametrize("name", INPUTS)
def test_a_silenced_input_changes_nothing(name):
    rng, silence = np.random.default_rng(3), INPUTS[name]
    planes = rng.integers(1, 255, (len(CHANNELS), 16, 16)).astype(np.uint8)
    planes[0] = 31
    other, rows = planes.copy(), [CHANNELS.index(channel) for channel in silence.channels]
    other[rows] = rng.integers(0, 256, other[rows].shape)
    np.testing.assert_array_equal(silence.over(planes), silence.over(other))
    assert (network_input(silence.over(planes)) != network_input(planes)).any()
    without, shipped = (net.probabilities(planes, 1) for net in (Without(silence), shipped_suit_network()))
    assert (without != shipped).any()
