"""What stands about the subject: chosen by chance, put where there is room."""

import numpy as np

from annotate.array_types import Float32
from synth.body.body import Body
from synth.rig.blanket import bed_blanket, lap_blanket
from synth.rig.difficulty import Clutter
from synth.rig.place import Place
from synth.rig.props import Thing, laptop, mug, radiator, sunlit_patch, table, window

ASIDE_M, ASIDE_HEIGHT_M = 0.34, (0.42, 0.56)
"""A side table's middle from the furniture's side, and its height: as sold."""
LOW_TABLE_M, LOW_HEIGHT_M = (0.9, 0.45), (0.38, 0.46)
"""A couch table's size and height: as sold."""
ON_LAP = 0.6
"""Share of the laptops that are used on the lap; no source."""
FREE_M = 0.12
"""Between a couch table and the farthest foot."""


def furnish(
    place: Place, body: Body, prior: list[Float32], clutter: Clutter, rng: np.random.Generator
) -> list[Thing]:
    """Things about a subject whose earlier postures ``prior`` (V, 3) show how far it reaches."""
    has = {name: bool(rng.random() < share) for name, share in vars(clutter).items()}
    footprint = place.furniture.footprint
    side, lies = float(rng.choice((-1, 1))), place.lies
    things, stands = [], []
    if has["low_table"] and not lies:
        foot = min(float(vertices[:, 1].min()) for vertices in prior)
        middle = np.array(
            [rng.normal(0, 0.2), foot - FREE_M - LOW_TABLE_M[1] / 2, rng.uniform(*LOW_HEIGHT_M)]
        )
        things.append(table(middle, LOW_TABLE_M))
        stands += [middle + np.array([x, 0.0, 0.0]) for x in (-0.27, 0.2)]
    if (has["mug"] or has["laptop"]) and len(stands) < 2:
        x = side * (footprint.half_width_m + ASIDE_M)
        y = footprint.back_y - 0.4 if lies else rng.uniform(0.0, 0.3)
        middle = np.array([x, y, rng.uniform(*ASIDE_HEIGHT_M)])
        things.append(table(middle, (0.45, 0.45)))
        stands += [middle + np.array(off) for off in ((0.1 * side, 0.1, 0.0), (0.0, -0.08, 0.0))]
    if has["mug"]:
        things.append(mug(stands[0], body, held=not lies))
    if has["laptop"]:
        lap = bool(rng.random() < ON_LAP) and not lies
        things.append(laptop(stands[1], body, on_lap=lap))
    if has["blanket"]:
        cover = bed_blanket if lies else lap_blanket
        things.append(cover(place, body, rng))
    beside = footprint.half_width_m + rng.uniform(0.3, 0.7)
    if has["radiator"]:
        things.append(radiator(-side * beside, place.wall_y))
    if has["window"]:
        things.append(window(rng.uniform(-1.4, 1.4), place.wall_y))
    elif has["sunlit"]:
        things.append(sunlit_patch(rng.uniform(-1.2, 1.2), place.wall_y))
    return things
