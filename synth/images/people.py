"""People of synthetic images: who is seen, in which clothes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from annotate.array_types import Float32
from synth.body.body import Body, blend, hair_faces, shipped_bodies
from synth.body.crowd import crowd
from synth.clothes.dress import dress
from synth.clothes.dressed import Dressed, assembled


@dataclass(frozen=True, eq=False)
class Person:
    """Somebody to be seen. subject: the name of the body that is seen most of. notes: for frames' notes."""

    who: Dressed
    subject: str
    notes: dict[str, Any]


Casting = Callable[[np.random.Generator], Person]
"""Draws a person."""


def paper_person(rng: np.random.Generator) -> Person:
    """A naked build between two of the paper's eight bodies."""
    body, first = _between(shipped_bodies(), rng)
    return Person(assembled(body, _hair(first)), body.name, {})


@cache
def _hair(number: int) -> Float32:
    return hair_faces(shipped_bodies()[number]).astype(np.float32)


def crowd_person(rng: np.random.Generator) -> Person:
    """A dressed build between two adults of the crowd."""
    body, _ = _between(crowd(), rng)
    bmi = body.weight_kg / (body.height_cm / 100) ** 2
    notes = {"height_cm": round(body.height_cm, 1), "bmi": round(bmi, 1)}
    return Person(dress(body, rng), body.name, {"body": notes})


def _between(bodies: tuple[Body, ...], rng: np.random.Generator) -> tuple[Body, int]:
    """A blend of two bodies, and the index of the nearer one, whose name and parts it has."""
    i, j = rng.choice(len(bodies), 2, replace=False)
    return blend(bodies[i], bodies[j], float(rng.beta(0.6, 0.6)) / 2), int(i)
