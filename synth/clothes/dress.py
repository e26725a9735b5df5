"""Dressing: what is worn becomes displaced skin and hanging pieces."""

from dataclasses import replace

import numpy as np

from synth.body.body import Body, hair_faces
from synth.clothes.attire import BAGS, Attire, draw_attire
from synth.clothes.bags import Bag, backpack, shoulder_bag
from synth.clothes.dressed import Dressed, Piece, assembled
from synth.clothes.hair import put_on_hair
from synth.clothes.shoes import put_on_shoes
from synth.clothes.skirt import hang_skirt
from synth.clothes.tops_trousers import Fitting, put_on_top, put_on_trousers

TUCKED = 0.08
"""How far a top reaches under a skirt's waist: share of the trunk."""
LONG = 1.5
"""Sleeves and trousers that end beyond the middle of forearm and shank are a suit's."""
HAIR_LOSS = 1.0
"""Share of infrared that hair loses, as the naked presets take it."""


def naked(body: Body) -> Dressed:
    """The body as it is; its hair is dark."""
    return assembled(body, HAIR_LOSS * hair_faces(body).astype(np.float32))


def dress(body: Body, rng: np.random.Generator) -> Dressed:
    """A body in clothes drawn at random, from bare skin and thin clothes to coats and skirts."""
    return dress_in(body, draw_attire(rng), rng)


def put_down(who: Dressed) -> Dressed:
    """The same person without their bag, for sitting or lying; unchanged if there is no bag."""
    pieces = [piece for piece in who.pieces if not isinstance(piece, Bag)]
    if len(pieces) == len(who.pieces):
        return who
    clothes = [name for name in who.clothes if name not in BAGS]
    return assembled(who.body, who.dark[: len(who.body.faces)], pieces, clothes)


def cut_loose(body: Body, rng: np.random.Generator) -> Body:
    """A body whose skin is a long top and long trousers drawn at random; nothing hangs about it."""
    attire = draw_attire(rng, bags=False)
    while not (attire.top and attire.top.sleeve > LONG and attire.trousers and attire.trousers.hem > LONG):
        attire = draw_attire(rng, bags=False)
    return dress_in(body, replace(attire, skirt=None), rng).body


def dress_in(body: Body, attire: Attire, rng: np.random.Generator) -> Dressed:
    """A body in these clothes; their folds are drawn at random."""
    fitting = Fitting.of(body, rng)
    if attire.trousers:
        put_on_trousers(fitting, attire.trousers)
    if attire.top:
        # What hangs begins under the top's hem, or over a top that is tucked in.
        hem = attire.skirt.waist - TUCKED if attire.skirt else attire.top.hem
        put_on_top(fitting, replace(attire.top, hem=hem))
    if attire.shoes:
        put_on_shoes(fitting, attire.shoes)
    put_on_hair(fitting, attire.hair)
    pieces: list[Piece] = []
    worn = fitting.dressed_body()
    if attire.skirt:
        pieces.append(hang_skirt(body, worn, fitting.places, attire.skirt, rng))
    if attire.bag:
        kind = {"backpack": backpack, "shoulder_bag": shoulder_bag}[attire.bag]
        pieces.append(kind(body, worn, fitting.places, rng.uniform(0, 0.5), rng))
    return assembled(worn, fitting.dark[body.faces].mean(axis=1), pieces, attire.names)
