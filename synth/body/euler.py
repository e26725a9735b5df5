"""Angles about x, y and z of a rotation."""

import warnings
from typing import TYPE_CHECKING

import numpy as np

from annotate.array_types import Float64

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def euler_rad(turn: "Rotation") -> Float64:
    """Return angles (..., 3) about x, y, z, in this order, of a scipy ``Rotation``.

    Where the second is a right angle (somebody who lies on the side), the first and the third are one turn;
    the third is 0 then, without scipy's warning.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(turn.as_euler("XYZ"))
