"""Smooth in time: a stream of postures, each settled for itself, as one motion without jerks.

Moments glide, but a contact begins or a limb changes the side it passes another on from one frame to the
next. A Gaussian over a few frames bounds the acceleration that can follow: a jump of d metres becomes at most
0.25 d / sigma^2. Limits are a box, so that means of angles within them are within them.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain, islice, repeat

import numpy as np
from scipy.spatial.transform import Rotation

from synth.body.skeleton import Float64, Posture

SIGMA_S = 0.08
"""Width of the Gaussian, seconds; it is cut at two and a half of it."""


def perform(postures: Iterable[Posture], frames_per_second: float) -> Iterator[Posture]:
    """Yield as many postures as come in, smoothed over their neighbours in time; ends are held."""
    reach = int(np.ceil(2.5 * SIGMA_S * frames_per_second))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (SIGMA_S * frames_per_second)) ** 2)
    stream = iter(postures)
    first = next(stream, None)
    if first is None:
        return
    window: deque[Posture] = deque(repeat(first, reach), maxlen=2 * reach + 1)
    window.extend(ahead := [first, *islice(stream, reach)])
    window.extend(repeat(ahead[-1], reach + 1 - len(ahead)))
    held = repeat(None, len(ahead) - 1)
    yield _mean(window, weights)
    for posture in chain(stream, held):
        window.append(posture or window[-1])
        yield _mean(window, weights)


def _mean(window: deque[Posture], weights: Float64) -> Posture:
    share = weights / weights.sum()
    angles = np.einsum("i,ija->ja", share, [p.angles_rad for p in window])
    # The pelvis has no limits and turns freely: its mean is one of rotations.
    turns = Rotation.from_euler("XYZ", [p.angles_rad[0] for p in window])
    angles[0] = turns.mean(share).as_euler("XYZ")
    return Posture(angles, np.einsum("i,ia->a", share, [p.pelvis_m for p in window]))
