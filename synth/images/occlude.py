"""What keeps a person from being seen whole: things in front of the camera, and a failing extraction."""

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Bool, Float64
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh
from synth.surface.shapes import box

THING_M = (0.04, 0.45)
"""Edge lengths of an occluder: from a pole to a chair's back."""


def occluder(eye_m: Float64, seen_m: Float64, rng: np.random.Generator) -> Mesh:
    """A box at any angle between the camera and the point ``seen_m`` of the person, world frame.

    It stands at 50 to 85 % of the way. Random occluders help occluded and unoccluded tests alike
    (Sarandi et al. 2018).
    """
    half = np.exp(rng.uniform(np.log(THING_M[0]), np.log(THING_M[1]), 3)) / 2
    mesh = box(tuple(-half), tuple(half), Surface.TABLE)
    rotation = Rotation.random(rng=rng).as_matrix()
    centre = eye_m + rng.uniform(0.5, 0.85) * (seen_m - eye_m)
    return mesh.placed(rotation, centre)


def cut(person: Bool, rng: np.random.Generator) -> Bool:
    """Take one to three ellipses out of a person's mask (h, w), as an extraction by temperature may.

    Cold hands and feet, wet clothes and warm furniture leave such holes: Nishi & Miura 2017, Fig. 12.
    """
    v, u = np.nonzero(person)
    extent = max(np.ptp(v), np.ptp(u)) + 1
    rows, columns = np.ogrid[: person.shape[0], : person.shape[1]]
    left = person.copy()
    for _ in range(int(rng.integers(1, 4))):
        i = int(rng.integers(len(v)))
        long, short = extent * rng.uniform(0.06, 0.22), extent * rng.uniform(0.03, 0.12)
        turn = rng.uniform(0, np.pi)
        y, x = rows - v[i], columns - u[i]
        along = (np.cos(turn) * x + np.sin(turn) * y) / long
        across = (np.cos(turn) * y - np.sin(turn) * x) / short
        left &= along**2 + across**2 > 1
    return left
