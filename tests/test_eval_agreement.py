"""Label sets of the same frames, each compared with each: scores, page, and the verbs compare and report."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import assert_refused

from annotate.frame_labels import FrameLabels
from eval.compare.compare import compare_sets
from eval.network.body_state import BodyState
from eval.report.agreement import agreements, work_of
from eval.report.agreement_page import Compared, agreement_html, worst_frames
from sensors.errors import CloudError
from tests.test_eval_compare import CAMERA, PEOPLE, guess_frame, label_set, truth_frame
from tests.test_eval_report import Tags

STANDING, SITTING = (np.eye(6, dtype=np.float32)[i] for i in (0, 1))


def with_state(
    frame: FrameLabels, posture: np.ndarray, facing_deg: float, moved_mm: float = 0
) -> FrameLabels:
    """The frame with 15 joints in its middle, moved to the right."""
    joints_px = np.tile([14.5 + moved_mm * CAMERA.fx / 1500, 11.5, 1500.0], (15, 1))
    return replace(frame, notes={"bearing": BodyState(facing_deg, 1.0, posture, joints_px).note()})


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """Three label sets: joints of the first and of the third lie 30 and 60 mm beside the second's."""
    folder, truth = tmp_path_factory.mktemp("agreement"), [truth_frame(i) for i in range(6)]
    guess = [guess_frame(i) for i in range(6)]
    return {
        "depth": label_set(folder / "depth", [with_state(f, STANDING, -170, 30) for f in guess]),
        "colour": label_set(folder / "colour", [with_state(f, STANDING, 170) for f in truth]),
        "suit": label_set(folder / "suit", [with_state(f, SITTING, 90, 60) for f in truth]),
    }


@pytest.fixture(scope="module")
def found(sets):
    return agreements(sets)


def test_each_pair_is_scored_with_the_second_as_the_reference(sets, found):
    assert [(one.a, one.b) for one in found] == [("depth", "colour"), ("depth", "suit"), ("colour", "suit")]
    parts = compare_sets(sets["depth"], sets["colour"])
    np.testing.assert_array_equal(found[0].comparison.confusion, parts.confusion)
    apart = [one.comparison.joints.estimates.scores["mpjpe_mm"][0] for one in found]
    assert apart == pytest.approx([30, 30, 60], abs=0.5)
    assert found[2].comparison.scores["miou"] == 1
    assert [one.same_facing for one in found] == [(6, 6), (0, 6), (0, 6)]
    assert [one.same_posture for one in found] == [(6, 6), (0, 6), (0, 6)]
    assert found[0].turned_deg == pytest.approx([20] * 6)


def test_exchanged_sets_agree_as_much(sets):
    done = []
    two = {name: sets[name] for name in ("colour", "depth")}
    (there,), (back,) = agreements(two, done.append), agreements(dict(reversed(two.items())))
    assert sum(done) == work_of(two) == 18
    np.testing.assert_array_equal(there.comparison.confusion, back.comparison.confusion.T)
    np.testing.assert_array_equal(there.comparison.joints_mm, back.comparison.joints_mm)
    np.testing.assert_array_equal(there.turned_deg, back.turned_deg)


def test_intervals_are_over_known_people_alone(found, tmp_path):
    assert found[0].has_people
    for names in (("anna",), ("anna", "")):
        frames = [replace(truth_frame(i), subject=names[i % len(names)]) for i in range(4)]
        a, b = (label_set(tmp_path / f"{name}{len(names)}", frames) for name in "ab")
        (one,) = agreements({"a": a, "b": b})
        assert not one.has_people
        assert one.comparison.joints is None
        page = agreement_html(Compared({"a": a, "b": b}, [one]))
        assert "[" not in page.split("<h2>Agreement")[1].split("</table")[0]
    assert len(set(PEOPLE)) > 2


def test_one_set_is_too_few(sets):
    with pytest.raises(CloudError, match="give two or more"):
        agreements({"suit": sets["suit"]})


def test_the_page_shows_the_worst_frames_first(sets, found):
    worst = worst_frames(found)
    scores = [miou for *_, miou in worst]
    assert scores == sorted(scores)
    assert len(worst) == 6
    assert {one.a for _, one, _ in worst} == {"depth"}
    page = agreement_html(Compared(sets, found, notes=["a <b>note</b>"], facts={"command": "try <i>"}))
    assert page.index(f"{worst[0][0]} ·") < page.index(f"{worst[-1][0]} ·") < page.index("Mean recall")
    assert "a &lt;b&gt;note" in page
    assert "<b>note" not in page
    images = [attributes["alt"] for tag, attributes in Tags(page).tags if tag == "img"]
    row = ["Depth", "depth", "colour", "suit", "Differences", *(f"{name}, joints" for name in sets)]
    assert images == 6 * row
    assert agreement_html(Compared(sets, found)) == agreement_html(Compared(sets, found))


def test_the_verbs_take_label_sets_in_place_of_results(annotate_cloud, sets, tmp_path):
    paths = [labels.path for labels in sets.values()]
    done = annotate_cloud("compare", *paths, "--json")
    assert [(one["a"], one["b"]) for one in done.result["pairs"]] == [
        ("depth", "colour"),
        ("depth", "suit"),
        ("colour", "suit"),
    ]
    assert done.result["pairs"][0]["posture"] == {"frames": 6, "same": 6}
    shown = annotate_cloud("compare", *paths).out  # headings are wrapped at the terminal's width
    assert shown.count("against") == 3 and "suit" in shown
    page = tmp_path / "page.html"
    assert annotate_cloud("report", *paths, "--out", page, "--json").result["path"] == str(page)
    assert "<h2>Worst frames</h2>" in page.read_text()
    assert_refused(annotate_cloud("report", *paths, "--out", page), "already exists")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_wrong_sets_are_refused(annotate_cloud, sets, tmp_path):
    (tmp_path / "result.npz").touch()
    label_set(tmp_path / "suit", [truth_frame(i) for i in range(6)])
    label_set(tmp_path / "few", [truth_frame(0)])
    suit = sets["suit"].path
    assert annotate_cloud("compare", suit, tmp_path / "result.npz").code == 2
    assert annotate_cloud("report", suit, suit, "--out", tmp_path / "p.html", "--ceiling", suit).code == 2
    assert_refused(annotate_cloud("compare", suit, tmp_path / "suit"), "two label sets have the name 'suit'")
    assert_refused(annotate_cloud("compare", suit), "give two or more")
    refused = annotate_cloud("compare", tmp_path / "few", suit)
    assert_refused(refused, "lacks 5 of the 6 frames", remarks=refused.err.count("compare: "))
