"""The measuring tools and benchmarks: each can be imported, and the quick ones print their tables."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from annotate.cloud.supervoxels import Supervoxels
from annotate.segmentation.input_channels import CHANNELS, network_input
from annotate.segmentation.suit_network import shipped_suit_network
from tools.measure.ablation import INPUTS, Without, labelled, row
from tools.measure.labels import print_figures, worst_first

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
    whole = labelled(rig_session, shipped_suit_network())
    cells = row("nothing", whole, whole).strip("| ").split(" | ")
    assert cells[0] == "nothing" and len(cells) == 6
    assert all(cell.endswith("]") and "+0.0" in cell for cell in cells[1:6])


@pytest.mark.parametrize("name", INPUTS)
def test_an_input_that_is_left_out_says_nothing(name):
    """However the channels left out change, the network is told the same; and it is told less than before."""
    rng, silence = np.random.default_rng(3), INPUTS[name]
    planes = rng.integers(1, 255, (len(CHANNELS), 16, 16)).astype(np.uint8)
    planes[0] = 31
    other, rows = planes.copy(), [CHANNELS.index(channel) for channel in silence.channels]
    other[rows] = rng.integers(0, 256, other[rows].shape)
    np.testing.assert_array_equal(silence.over(planes), silence.over(other))
    assert (network_input(silence.over(planes)) != network_input(planes)).any()
    assert (
        Without(silence).probabilities(planes, 1) != shipped_suit_network().probabilities(planes, 1)
    ).any()


def test_worst_first_counts_the_wrong_pixels_to_be_expected():
    groups = Supervoxels(np.repeat([0, 1, 2], [10, 100, 5]).astype(np.int32), 3, np.zeros((0, 2), np.int32))
    confidence = np.repeat([0.5, 0.9, 0.1], [10, 100, 5])  # 5, 10 and 4.5 wrong ones
    assert worst_first(confidence, groups).tolist() == [1, 0, 2]
