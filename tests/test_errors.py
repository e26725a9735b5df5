"""Reasons in messages name fields and versions, never Python's types."""

import json

import pytest

from sensors.errors import CalibrationError, fault_of
from sensors.rig.camera import Intrinsics
from sensors.versions import different

CAMERA = {"width": 4, "height": 3, "fx": 5.0, "fy": 5.0, "cx": 1.5, "cy": 1.0}


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (lambda: {}["frames"], "field 'frames' is missing"),
        (lambda: Intrinsics(**{**CAMERA, "skew": 1}), "field 'skew' is unknown"),
        (lambda: Intrinsics(4, 3, 5.0, 5.0), "missing fields: 'cx' and 'cy'"),
        (lambda: [][0], "it holds too few values"),
        (lambda: float([]), "a value has the wrong type"),
        (lambda: [].items(), "a value has the wrong type"),
        (lambda: int(float("inf")), "a number is too large"),
        (lambda: json.loads("[" * 100_000), "it is nested too deeply"),
        (lambda: float("x"), "could not convert string to float: 'x'"),
    ],
)
def test_a_fault_names_the_field(read, fault):
    with pytest.raises(
        (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError)
    ) as one:
        read()
    assert fault_of(one.value) == fault


def test_a_message_of_ours_is_kept():
    assert fault_of(CalibrationError("fx is 0; give pixels")) == "fx is 0; give pixels"


def test_only_different_versions_are_listed():
    here, wanted = {"numpy": "2.1", "code": "a"}, {"numpy": "2.2", "code": "a"}
    assert different(here, wanted) == "numpy 2.1 instead of 2.2" and different(here, here) == ""
