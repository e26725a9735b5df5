"""People of synthetic images: bodies and their clothes, drawn at random."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Float32
from sensors.errors import CloudError
from synth.body.body import Body, blend, hair_faces
from synth.body.crowd import crowd_of, suit_wearers
from synth.clothes.dress import dress, put_down
from synth.clothes.dressed import Dressed, assembled
from synth.clothes.makehuman_garments import Garment, choose, read_garments, wear
from synth.data_files import TRAINING, Cast

GARMENT_SHARE = 0.5  # people of a wardrobe in its garments; untuned


@dataclass(frozen=True, eq=False)
class Person:
    """Dressed person. subject: name of the body with the larger share. notes: copied to frames' notes."""

    dressed: Dressed
    subject: str
    notes: dict[str, Any]

    @cached_property
    def without_bag(self) -> "Person":
        """Return the same person without a bag."""
        dressed = put_down(self.dressed)
        if dressed is self.dressed:
            return self
        return Person(dressed, self.subject, self.notes | {"clothes": list(dressed.clothes)})


PersonSampler = Callable[[np.random.Generator], Person]


def paper_person(rng: np.random.Generator, cast: Cast = TRAINING) -> Person:
    """Draw a naked person, blended from two of the paper's eight bodies or of another cast's."""
    body, first = _between(suit_wearers(cast), rng)
    return Person(assembled(body, _hair(cast, first)), body.name, {})


@cache
def _hair(cast: Cast, number: int) -> Float32:
    return hair_faces(suit_wearers(cast)[number]).astype(np.float32)


def crowd_person(rng: np.random.Generator, cast: Cast = TRAINING) -> Person:
    """Draw a dressed person, blended from two adults of a cast."""
    body, _ = _between(crowd_of(cast), rng)
    return _described(body, dress(body, rng, cast))


@dataclass(frozen=True)
class Wardrobe:
    """Sampler of people of the crowd; a share ``GARMENT_SHARE`` wears garments of a folder. sha256: of the
    garments.
    """

    folder: Path
    sha256: str

    @staticmethod
    def of(folder: Path) -> "Wardrobe":
        """Return the wardrobe of a folder of ``.mhclo`` files. Raises CloudError for a folder without any."""
        return Wardrobe(folder, _garments(folder)[1])

    def __call__(self, rng: np.random.Generator) -> Person:
        """Draw a person. Raises CloudError if the folder has changed."""
        garments, found = _garments(self.folder)
        if found != self.sha256:
            raise CloudError(
                f"{self.folder} has other garments than at the start of the run; copy the same files to "
                "every machine"
            )
        body, _ = _between(crowd_of(TRAINING), rng)
        if rng.random() < GARMENT_SHARE:
            return _described(body, wear(body, choose(garments, body, rng)))
        return _described(body, dress(body, rng))


@cache
def _garments(folder: Path) -> tuple[tuple[Garment, ...], str]:
    garments = read_garments(folder)
    digest = hashlib.sha256()
    for garment in garments:
        for name in ("corners", "shares", "offsets", "spans", "faces", "hidden"):
            digest.update(np.ascontiguousarray(getattr(garment, name)).tobytes())
    return garments, digest.hexdigest()


def _described(body: Body, dressed: Dressed) -> Person:
    bmi = body.weight_kg / (body.height_cm / 100) ** 2
    build = {"height_cm": round(body.height_cm, 1), "bmi": round(bmi, 1)}
    return Person(dressed, body.name, {"body": build, "clothes": list(dressed.clothes)})


def _between(bodies: tuple[Body, ...], rng: np.random.Generator) -> tuple[Body, int]:
    """Return a blend of two bodies and the index of the nearer one, which gives name and parts."""
    i, j = _pair(bodies, rng)
    return blend(bodies[i], bodies[j], float(rng.beta(0.6, 0.6)) / 2), i


def _pair(bodies: tuple[Body, ...], rng: np.random.Generator) -> tuple[int, int]:
    i, j = rng.choice(len(bodies), 2, replace=False)
    return int(i), int(j)


def blended(bodies: tuple[Body, ...], rng: np.random.Generator) -> tuple[str, str]:
    """Return the names of the two bodies that ``_between`` blends with a generator in the same state."""
    i, j = _pair(bodies, rng)
    return bodies[i].name, bodies[j].name
