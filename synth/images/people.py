"""People of synthetic images: bodies and their clothes."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Float32
from sensors.errors import CloudError
from synth.body.body import Body, blend, hair_faces, shipped_bodies
from synth.body.crowd import crowd
from synth.clothes.dress import dress, put_down
from synth.clothes.dressed import Dressed, assembled
from synth.clothes.makehuman_garments import Garment, choose, read_garments, wear

GARMENT_SHARE = 0.5
"""Of the people of a wardrobe, those in its garments. No source: chosen by eye."""


@dataclass(frozen=True, eq=False)
class Person:
    """Somebody to be seen. subject: the name of the body that is seen most of. notes: for frames' notes."""

    who: Dressed
    subject: str
    notes: dict[str, Any]

    @cached_property
    def without_bag(self) -> "Person":
        """The same person, who has put down their bag."""
        who = put_down(self.who)
        if who is self.who:
            return self
        return Person(who, self.subject, self.notes | {"clothes": list(who.clothes)})


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
    return _described(body, dress(body, rng))


@dataclass(frozen=True)
class Wardrobe:
    """A casting of the crowd, of whom ``GARMENT_SHARE`` wear garments of a folder; the others as ever.

    sha256: of the folder's garments; workers whose own differ refuse to go on.
    """

    folder: Path
    sha256: str

    @staticmethod
    def of(folder: Path) -> "Wardrobe":
        """The wardrobe of a folder of ``.mhclo`` files. Raises CloudError where it has none."""
        return Wardrobe(folder, _garments(folder)[1])

    def __call__(self, rng: np.random.Generator) -> Person:
        """Draw a person. Raises CloudError where the folder is no longer the same."""
        garments, found = _garments(self.folder)
        if found != self.sha256:
            raise CloudError(f"{self.folder} holds other garments than the order's; copy the same everywhere")
        body, _ = _between(crowd(), rng)
        if rng.random() < GARMENT_SHARE:
            return _described(body, wear(body, choose(garments, body, rng)))
        return _described(body, dress(body, rng))


@cache
def _garments(folder: Path) -> tuple[tuple[Garment, ...], str]:
    garments = read_garments(folder)
    digest = hashlib.sha256()
    for garment in garments:
        for array in (
            garment.corners,
            garment.shares,
            garment.offsets,
            garment.spans,
            garment.faces,
            garment.hidden,
        ):
            digest.update(np.ascontiguousarray(array).tobytes())
    return garments, digest.hexdigest()


def _described(body: Body, who: Dressed) -> Person:
    bmi = body.weight_kg / (body.height_cm / 100) ** 2
    build = {"height_cm": round(body.height_cm, 1), "bmi": round(bmi, 1)}
    return Person(who, body.name, {"body": build, "clothes": list(who.clothes)})


def _between(bodies: tuple[Body, ...], rng: np.random.Generator) -> tuple[Body, int]:
    """A blend of two bodies, and the index of the nearer one, whose name and parts it has."""
    i, j = rng.choice(len(bodies), 2, replace=False)
    return blend(bodies[i], bodies[j], float(rng.beta(0.6, 0.6)) / 2), int(i)
