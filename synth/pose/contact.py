"""A posed skin on what carries it: where a body comes to rest, and how far it has to be lifted."""

import numpy as np

from annotate.array_types import Bool, Float32
from synth.surface.furniture import Solid


def height_to_rest(vertices_m: Float32, carriers: list[Solid]) -> float:
    """Rise (m, may be negative) that puts vertices (V, 3) on the upright solids under them.

    The vertex that needs it most ends as deep in the highest solid under it as that solid gives.
    """
    top = np.full(len(vertices_m), -np.inf, np.float32)
    for solid in carriers:
        top = np.maximum(top, np.where(_over(vertices_m, solid), solid.high[2] - solid.give_m, -np.inf))
    return float((top - vertices_m[:, 2]).max())


def lift_needed(vertices_m: Float32, carriers: list[Solid]) -> float:
    """Rise (m, at least 0) after which no vertex (V, 3) is deeper below an upright solid's top than it gives.

    A vertex nearer to a side of the solid than to its top would leave by the side and does not count.
    """
    rise = 0.0
    for solid in carriers:
        below = solid.high[2] - vertices_m[:, 2]
        sunk = below > solid.give_m
        through_top = below[sunk] <= solid.depth_m(vertices_m[sunk]) + 1e-6
        if through_top.any():
            rise = max(rise, float(below[sunk][through_top].max()) - solid.give_m)
    return rise


def _over(vertices_m: Float32, solid: Solid) -> Bool:
    x, y = vertices_m[:, 0], vertices_m[:, 1]
    (x0, y0, _), (x1, y1, _) = solid.low, solid.high
    return (x > x0) & (x < x1) & (y > y0) & (y < y1)
