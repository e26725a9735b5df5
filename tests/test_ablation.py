"""The ablation's rows: each takes out a step that labelling makes, and labels come out all the same."""

from contextlib import ExitStack
from unittest.mock import Mock, patch

import numpy as np
import pytest

from annotate.label_source import label_source
from annotate.labelset.store import LabelSet
from annotate.suit.palette import DEFAULT_SUIT
from eval.compare.compare import compare_sets
from sensors.session.reader import Session
from synth.rig.simulate import truth_path
from tools.measure_labels import WITHOUT

SURE = 0.5
"""Mean recall that is left of a clean recording without any one step."""


@pytest.mark.parametrize("step", [step for step, instead in WITHOUT.items() if instead])
def test_each_row_takes_a_step_out_that_is_made(step, rig_session, tmp_path):
    with ExitStack() as stack:
        called = [
            stack.enter_context(patch(function, Mock(side_effect=stand_in)))
            for function, stand_in in WITHOUT[step].items()
        ]
        session = Session(rig_session)
        labels = label_source(session, DEFAULT_SUIT, tmp_path / "labels", lambda n: None).labels
    assert all(stand_in.called for stand_in in called)
    scores = compare_sets(labels, LabelSet.open(truth_path(rig_session))).scores
    assert float(np.nan_to_num(scores["mean_recall"])) > SURE
