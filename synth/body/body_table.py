"""Tables of bodies: measures read from CSV, and measures of fitted bodies."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sensors.errors import CloudError, fault_of

if TYPE_CHECKING:
    from synth.body.body import Body

MEASURES = ("height_cm", "weight_kg", "waist_breadth_cm")
MOST_BODIES = 1000  # bodies of one command
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True)
class BodySize:
    """Requested measures of a body; its name becomes a file name. Raises CloudError for impossible values."""

    name: str
    height_cm: float
    weight_kg: float
    waist_breadth_cm: float

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise CloudError(
                f"body name {self.name[:64]!r} is not a file name; give up to 64 letters, digits, _ . or -"
            )
        for value, low, high, what in (
            (self.height_cm, 80, 230, "height_cm"),
            (self.weight_kg, 10, 250, "weight_kg"),
            (self.waist_breadth_cm, 12, 70, "waist_breadth_cm"),
        ):
            if not low <= value <= high:
                raise CloudError(f"body {self.name}: {what} {value} is impossible; give {low} to {high}")


# Nishi & Miura 2017, table 1
PAPER_BODIES = tuple(
    BodySize(f"body_{i}", *row)
    for i, row in enumerate(
        (
            (149.2, 36.6, 22.7),
            (155.3, 45.0, 24.2),
            (172.6, 51.9, 23.7),
            (171.4, 56.8, 25.2),
            (169.6, 61.7, 26.6),
            (167.7, 66.6, 27.7),
            (166.1, 71.5, 29.0),
            (182.8, 78.4, 28.8),
        )
    )
)


def read_sizes(path: Path) -> tuple[BodySize, ...]:
    """Read a CSV with columns name, height_cm, weight_kg, waist_breadth_cm.

    Raises CloudError for another file, for two bodies of one name, and for none or more than ``MOST_BODIES``.
    """
    columns = ",".join(("name", *MEASURES))
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            sizes: list[BodySize] = []
            for row in csv.DictReader(file):
                if len(sizes) == MOST_BODIES:
                    raise CloudError(f"{path} has more than {MOST_BODIES} bodies; split it")
                sizes.append(BodySize(row["name"].strip(), *(float(row[column]) for column in MEASURES)))
    except OSError as error:
        raise CloudError(f"{path} cannot be read ({error.strerror}); give columns {columns}") from error
    except (KeyError, TypeError, ValueError, AttributeError, csv.Error) as error:
        why = fault_of(error)
        raise CloudError(f"{path} is not a table of bodies ({why}); give columns {columns}") from error
    if not sizes:
        raise CloudError(f"{path} has no bodies; give columns {columns} and a row for each")
    # File systems may hold no two names that differ in case alone.
    names = [size.name.lower() for size in sizes]
    for name in names:
        if names.count(name) > 1:
            raise CloudError(f"{path} has two bodies named {name}; give each its own name")
    return tuple(sizes)


def describe(body: "Body", size: BodySize | None) -> dict[str, str | float]:
    """Return a table row of a body's measures, and of the requested measures as ``asked_*``."""
    row: dict[str, str | float] = {"model": body.name}
    row |= {measure: round(getattr(body, measure), 2) for measure in MEASURES}
    if size is not None:
        row |= {f"asked_{measure}": getattr(size, measure) for measure in MEASURES}
    return row
