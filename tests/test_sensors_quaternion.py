"""Quaternions beside scipy's, and there and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sensors.rig.rig_calibration import quaternion_of, rotation_of

UNIT = st.floats(-1, 1, allow_subnormal=False)


@given(st.tuples(UNIT, UNIT, UNIT, UNIT).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_as_scipy_and_there_and_back(numbers):
    rotation = rotation_of(np.array(numbers))
    assert np.allclose(rotation, Rotation.from_quat(numbers).as_matrix(), atol=1e-12)
    quaternion = quaternion_of(rotation)
    assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-12)
    assert np.allclose(rotation_of(quaternion), rotation, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_and_no_turn(axis):
    half = np.diag(np.where(np.arange(3) == axis, 1.0, -1.0))
    assert np.allclose(np.abs(quaternion_of(half)), np.eye(4)[axis])
    assert np.allclose(quaternion_of(np.eye(3)), [0, 0, 0, 1])


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_what_is_no_rotation_is_refused(bad):
    with pytest.raises(ValueError, match="length"):
        rotation_of(np.array(bad))
