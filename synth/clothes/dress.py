"""Dressing of a body: clothes become displaced skin and hanging pieces."""

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
from synth.data_files import TRAINING, Cast

TUCKED = 0.08  # reach of a top under a skirt's waist, share of the trunk
LONG = 1.5  # end of a suit's sleeves and trousers: beyond the middle of forearm and shank


def naked(body: Body) -> Dressed:
    """Return the body without clothes; the hair absorbs infrared."""
    return assembled(body, hair_faces(body).astype(np.float32))


def dress(body: Body, rng: np.random.Generator, cast: Cast = TRAINING) -> Dressed:
    """Return a body in random clothes of a cast (set of synthetic people)."""
    return dress_in(body, draw_attire(rng, cast=cast), rng)


def put_down(dressed: Dressed) -> Dressed:
    """Return the dressed person without a bag, or the same object if the person has none."""
    pieces = [piece for piece in dressed.pieces if not isinstance(piece, Bag)]
    if len(pieces) == len(dressed.pieces):
        return dressed
    clothes = [name for name in dressed.clothes if name not in BAGS]
    return assembled(dressed.body, dressed.dark[: len(dressed.body.faces)], pieces, clothes)


def cut_loose(body: Body, rng: np.random.Generator, cast: Cast = TRAINING) -> Body:
    """Return a body in a cast's random long top and trousers, as displaced skin without hanging pieces."""
    attire = draw_attire(rng, bags=False, cast=cast)
    while not (attire.top and attire.top.sleeve > LONG and attire.trousers and attire.trousers.hem > LONG):
        attire = draw_attire(rng, bags=False, cast=cast)
    return dress_in(body, replace(attire, skirt=None), rng).body


def dress_in(body: Body, attire: Attire, rng: np.random.Generator) -> Dressed:
    """Return a body in the clothes of ``attire``, with random folds."""
    fitting = Fitting.of(body, rng)
    if attire.trousers:
        put_on_trousers(fitting, attire.trousers)
    if attire.top:
        # A skirt begins under the top's hem, or over a top that is tucked in.
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
