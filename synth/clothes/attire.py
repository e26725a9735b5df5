"""Parameters of clothes, drawn from ranges in ``clothes.toml`` of a cast (set of synthetic people)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from synth.data_files import TRAINING, Cast, table_of


@dataclass(frozen=True)
class Worn:
    """Parameters of a garment, explained in ``clothes.toml``; lengths in mm, positions of ``SkinMap``."""

    dark: float

    @classmethod
    def drawn(cls, entry: Mapping[str, Any], rng: np.random.Generator) -> Self:
        """Draw the parameters of a garment within the ranges of an entry."""
        names = [field.name for field in fields(cls) if field.name in entry]
        return cls(**{name: float(rng.uniform(*entry[name])) for name in names})


@dataclass(frozen=True)
class Top(Worn):
    """Parameters of a garment on trunk and arms."""

    hem: float
    sleeve: float
    body_mm: float
    cuff_mm: float
    give: float
    folds_mm: float
    hood_mm: float = 0.0


@dataclass(frozen=True)
class Trousers(Worn):
    """Parameters of a garment on hips and separate legs."""

    waist: float
    hem: float
    seat_mm: float
    hem_mm: float
    give: float
    folds_mm: float


@dataclass(frozen=True)
class Skirt(Worn):
    """Parameters of a garment around both legs: a skirt, or the lower half of a coat, dress or long shirt."""

    waist: float
    hem: float
    ease_mm: float
    flare: float
    folds_mm: float


@dataclass(frozen=True)
class Shoes(Worn):
    """Parameters of shoes or boots."""

    sole_mm: float
    upper_mm: float
    shaft: float
    shaft_mm: float


@dataclass(frozen=True)
class Hair(Worn):
    """Parameters of hair, a cap or a hat."""

    lift_mm: float
    fall: float
    bulge_mm: float = 0.0
    peak_mm: float = 0.0


@dataclass(frozen=True)
class Attire:
    """Clothes of a person. names: their entries in ``clothes.toml``; bag: "" for none."""

    names: tuple[str, ...]
    hair: Hair
    top: Top | None = None
    trousers: Trousers | None = None
    skirt: Skirt | None = None
    shoes: Shoes | None = None
    bag: str = ""


BAGS = ("backpack", "shoulder_bag")


def draw_attire(rng: np.random.Generator, bags: bool = True, cast: Cast = TRAINING) -> Attire:
    """Draw a person's clothes and hair and, if ``bags``, sometimes a bag."""
    known = table_of(cast, "clothes")
    style = _by_share(known["styles"], rng)
    worn = {kind: str(rng.choice(known["styles"][style][kind])) for kind in ("tops", "bottoms", "shoes")}
    top, trousers, skirt = worn["tops"], worn["bottoms"], ""
    if trousers in known["skirts"]:
        trousers, skirt = "", trousers
    if top and "below" in known["tops"][top]:
        skirt = known["tops"][top]["below"]
    hair = _by_share(known["hair"], rng)
    bag = str(rng.choice(BAGS)) if bags and top and rng.random() < known["bags"]["share"] else ""
    names = (top, trousers, skirt, worn["shoes"], hair, bag)
    return Attire(
        tuple(name for name in names if name),
        Hair.drawn(known["hair"][hair], rng),
        Top.drawn(known["tops"][top], rng) if top else None,
        Trousers.drawn(known["trousers"][trousers], rng) if trousers else None,
        Skirt.drawn(known["skirts"][skirt], rng) if skirt else None,
        Shoes.drawn(known["shoes"][worn["shoes"]], rng) if worn["shoes"] else None,
        bag,
    )


def _by_share(entries: Mapping[str, Mapping[str, Any]], rng: np.random.Generator) -> str:
    names: Sequence[str] = tuple(entries)
    shares = np.array([entries[name]["share"] for name in names])
    return str(rng.choice(names, p=shares / shares.sum()))
