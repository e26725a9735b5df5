"""The verbs evaluate, compare, diff and report on label sets of different schemes."""

import shutil
from pathlib import Path

import pytest
from conftest import assert_refused

from annotate.parts import PAPER
from annotate.scheme.scheme_file import load_scheme, scheme_to_toml
from annotate.suit.palette import suit_to_toml
from synth.appearance.random_suit import random_suit
from tests.helpers.patches import pair, write_set
from tests.helpers.schemes import WARD


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels and truth of three frames in ``ward``, and a truth in ``six``."""
    out = tmp_path_factory.mktemp("schemes")
    for scheme, name in ((WARD, "ward"), (load_scheme("six"), "six"), (PAPER, "paper")):
        pairs = [pair(seed, scheme) for seed in range(3)]
        write_set(out / "labels" / name, [guess for guess, _ in pairs])
        write_set(out / "truth" / name, [truth for _, truth in pairs])
    return out


def test_the_scheme_of_a_comparison_is_said(annotate_cloud, folder, tmp_path):
    own = annotate_cloud("evaluate", folder / "labels/ward", folder / "truth/ward", "--out", tmp_path / "a")
    assert own.code == 0 and "compared in" not in own.err and "Wheelchair" in own.out
    given = ("evaluate", folder / "labels/ward", folder / "truth/six")
    mixed = annotate_cloud(*given, "--out", tmp_path / "b", "--title", "b", "--json")
    said = "compared in scheme six: head, torso, upper_arms, lower_arms, upper_legs, lower_legs"
    assert mixed.result["scheme"] == "six" and f"{said} (labels: ward, truth: six)" in mixed.err
    assert said in annotate_cloud("diff", *given[1:]).err
    apart = annotate_cloud("compare", tmp_path / "a", tmp_path / "b")
    assert apart.code == 0 and said in apart.err and "swaps" not in apart.out
    page = tmp_path / "report.html"
    assert annotate_cloud("report", tmp_path / "a", tmp_path / "b", "--out", page).code == 0
    assert said in page.read_text()


def test_a_scheme_to_compare_in_is_given(annotate_cloud, folder, tmp_path):
    (tmp_path / "ward.toml").write_text(scheme_to_toml(WARD))
    given = ("evaluate", folder / "labels/ward", folder / "truth/ward", "--scheme")
    done = annotate_cloud(*given, "paper", "--json")
    assert done.result["scheme"] == "paper" and "(labels: ward, truth: ward)" in done.err
    assert annotate_cloud(*given, tmp_path / "ward.toml", "--json").result["scheme"] == "ward"
    split = annotate_cloud(*given, "smpl-24")
    assert_refused(split, "lies in several parts of scheme 'smpl-24'")
    assert_refused(annotate_cloud(*given, "seven"), "scheme 'seven' does not exist")
    both = ("evaluate", folder / "labels", folder / "truth", "--out", tmp_path / "results")
    done = annotate_cloud(*both, "--json")
    assert done.code == 0 and (tmp_path / "results" / "six.npz").exists()
    again = annotate_cloud(*both, "--scheme", "six")
    assert again.code == 3 and "ward.npz has scheme 'ward'; pass --overwrite" in again.err
    assert annotate_cloud(*both, "--scheme", "six", "--overwrite").code == 0


def test_info_counts_the_pixels_of_the_set_s_own_parts(annotate_cloud, folder):
    pixels = annotate_cloud("info", folder / "truth/ward", "--json").result["pixels"]
    assert list(pixels) == ["background", *(part.name for part in WARD.parts)] and pixels["wheelchair"] > 0


def test_labels_in_another_scheme_than_the_suit_s_are_stated_wherever_a_suit_is_given(
    annotate_cloud, rig_session, tmp_path
):
    suit, sessions = tmp_path / "six.toml", tmp_path / "sessions"
    suit.write_text(suit_to_toml(random_suit(4, scheme=load_scheme("six"))))
    sessions.mkdir()
    shutil.copy(rig_session, sessions)
    for command in (
        ("label", rig_session, "--out", tmp_path / "one"),
        ("label", sessions, "--out", tmp_path / "each"),
        ("live", rig_session, "--no-window"),
    ):
        done = annotate_cloud(*command, "--suit", suit)
        assert done.code == 0, done.err
        assert done.err.count("labels have the parts of scheme 'paper'") == 1, command
