"""The engine's steps: each can be left out alone, that changes labels, and they come out all the same."""

from dataclasses import fields

import numpy as np
import pytest

from annotate.engine import Engine, Steps
from annotate.label_source import label_source
from annotate.labelset.store import LabelSet
from annotate.suit.palette import DEFAULT_SUIT
from eval.compare.compare import compare_sets
from sensors.errors import ExistsError
from sensors.session.reader import Session
from synth.rig.simulate import truth_path
from tools.measure.ablation import WITHOUT

SURE = 0.5
"""Mean recall that is left of a clean recording without any one step."""
SILENT = {"join_halves"}
"""Steps that a clean recording does not need."""


def same(a: LabelSet, b: LabelSet) -> bool:
    pairs = zip(a, b, strict=True)
    return all(
        np.array_equal(x.parts, y.parts) and np.array_equal(x.confidence, y.confidence) for x, y in pairs
    )


def test_every_step_is_left_out_in_a_row_of_the_table():
    assert {step for steps in WITHOUT.values() for step in steps.left_out()} == set(Steps().__dict__)


@pytest.mark.parametrize("step", [step.name for step in fields(Steps)])
def test_each_step_can_be_left_out(step, rig_session, rig_labels, tmp_path):
    session, engine = Session(rig_session), Engine(Steps(**{step: False}))
    labels = label_source(session, DEFAULT_SUIT, tmp_path / "l", lambda n: None, None, engine).labels
    assert same(labels, rig_labels) == (step in SILENT)
    scores = compare_sets(labels, LabelSet.open(truth_path(rig_session))).scores
    assert float(np.nan_to_num(scores["mean_recall"])) > SURE
    with pytest.raises(ExistsError):  # a run of all steps does not go on there
        label_source(session, DEFAULT_SUIT, tmp_path / "l", lambda n: None)
