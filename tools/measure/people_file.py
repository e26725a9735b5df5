"""Landmarks of people in the images of an RGB-D recording: the file ``people.json``."""

import json
from collections.abc import Collection
from pathlib import Path

import numpy as np

from annotate.array_types import Float64
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import read_bounded

PEOPLE_FILE = "people.json"
LANDMARKS = 33
MAX_BYTES = 1 << 28  # 100,000 people take 60 MB; bounds memory
REMEDY = "make it by tools.measure.colour_people"


def read_people(path: Path, names: Collection[str]) -> dict[str, list[Float64]]:
    """Return the landmarks (33, 3) of each person by image: column, row, visibility.

    names: of the depth images, without ending. Raises FormatError for a malformed file, and where the file
    and ``names`` differ.
    """
    try:
        given = json.loads(read_bounded(path, MAX_BYTES, REMEDY))
        people = {name: [np.array(one, np.float64) for one in persons] for name, persons in given.items()}
        for name, persons in people.items():
            if any(one.shape != (LANDMARKS, 3) or not np.isfinite(one).all() for one in persons):
                raise ValueError(f"image {name!r} has a person without {LANDMARKS} x 3 numbers")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path} is malformed ({fault_of(error)}); {REMEDY}") from error
    if apart := sorted(people.keys() ^ set(names)):
        where = "depth/" if apart[0] in people else path
        raise FormatError(f"{where} has no image {apart[0]!r}; name each depth image, [] without people")
    return people
