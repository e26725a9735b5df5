"""Names of classes: a scheme's by id for exports, and others' names and ids as parts of a scheme."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from annotate.array_types import UInt8
from annotate.scheme.scheme import BACKGROUND_PART, UNDEFINED, Scheme
from sensors.errors import FormatError, Setting
from sensors.files.bounded import read_bounded, read_toml

PERSON, PERSON_ID = "person", -1
"""Name of the mask of a whole person, and its place among part ids."""
UNDEFINED_NAME = "undefined"
MAX_MAP_BYTES = 200_000  # a thousand names of the longest kind
LISTED = 20  # unknown names in a message; untuned
_REMEDY = 'give a file (.toml, .json) of lines such as "their name" = "our part"'


def mask_ids(scheme: Scheme) -> dict[str, int]:
    """Return ids by the name of a mask: parts and undefined. Pixels without a mask are background.

    Raises FormatError for a scheme with a part named as whole persons are.
    """
    names = {part.name: part.id for part in scheme.parts} | {UNDEFINED_NAME: UNDEFINED}
    if PERSON in names:
        raise FormatError(
            f"scheme {scheme.name!r} has a part {PERSON!r}, the name of masks of whole persons; "
            "rename the part, or choose a format of label images"
        )
    return names


def class_list(scheme: Scheme) -> list[str]:
    """Return the names of classes by id, from the background on; unused ids are ``unused_ID``."""
    names = [f"unused_{i}" for i in range(scheme.n_classes)]
    for part in (BACKGROUND_PART, *scheme.parts):
        names[part.id] = part.name
    return names


def color_list(scheme: Scheme) -> list[list[int]]:
    """Return the colours (red, green, blue) of classes by id, from the background on."""
    colors: list[list[int]] = scheme.palette_rgb()[: scheme.n_classes].tolist()
    return colors


def plain(name: str) -> str:
    """Return a name without letter case; spaces and hyphens are underscores."""
    return re.sub(r"[\s-]+", "_", name.strip().lower())


def read_map(path: Path) -> dict[str, str]:
    """Read a file of others' names (or ids) and ours, TOML or JSON. Raises FormatError."""
    if path.suffix.lower() == ".json":
        try:
            content = json.loads(read_bounded(path, MAX_MAP_BYTES, _REMEDY))
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path} is not JSON ({error}); {_REMEDY}") from error
    else:
        content = read_toml(path, MAX_MAP_BYTES, _REMEDY)
    if not isinstance(content, dict) or not content:
        raise FormatError(f"{path} has no names; {_REMEDY}")
    for theirs, ours in content.items():
        if not isinstance(ours, str):
            raise FormatError(f"{path}: name {theirs[:40]!r} has {str(ours)[:40]!r}; {_REMEDY}")
    by_plain = {plain(theirs): ours for theirs, ours in content.items()}
    if len(by_plain) < len(content):
        raise FormatError(
            f"{path} has a name twice (letter case, spaces and hyphens do not count); remove one"
        )
    return by_plain


def ids_by_name(scheme: Scheme, theirs: Mapping[str, str]) -> dict[str, int]:
    """Return part ids by plain name: the scheme's names, background, undefined, person, and others' names.

    theirs: our name by others' plain name. Raises FormatError where our name is unknown.
    """
    own = {PERSON: PERSON_ID, UNDEFINED_NAME: UNDEFINED, **scheme.part_id}
    found = dict(own)
    for name, ours in theirs.items():
        if plain(ours) not in own:
            raise FormatError(
                f"the map has {ours[:40]!r} for {name[:40]!r}, unknown in scheme {scheme.name!r}; "
                f"use {', '.join(own)}"
            )
        found[name] = own[plain(ours)]
    return found


def check_names(names: Iterable[str], known: Mapping[str, int], scheme: Scheme, file: Path) -> None:
    """Raise FormatError with all names of a file that are unknown."""
    unknown = sorted({name for name in names if plain(name) not in known})
    if unknown:
        more = f" and {len(unknown) - LISTED} more" if len(unknown) > LISTED else ""
        listed = ", ".join(repr(name[:40]) for name in unknown[:LISTED])
        raise FormatError(
            f"{file} has names that are unknown in scheme {scheme.name!r}: {listed}{more}; "
            'give their scheme, or a map with lines such as "their name" = "our part" or "background"; '
            f"parts are {', '.join(part.name for part in scheme.parts)}",
            Setting.SCHEME,
            Setting.MAP,
        )


def id_table(scheme: Scheme, theirs: Mapping[str, str], classes: Sequence[str] = ()) -> UInt8:
    """Return uint8 (256,): part id by others' id in label images; ids without a name stay.

    classes: others' names by id. Raises FormatError for a name of ``theirs`` that is neither an
    id nor a class.
    """
    table, known = np.arange(256, dtype=np.uint8), ids_by_name(scheme, theirs)
    places = {plain(name): i for i, name in enumerate(classes[:256])}
    for name in theirs:
        number = int(name) if name.isdecimal() and len(name) <= 3 else places.get(name, 256)
        if number > 255:
            raise FormatError(
                f"the map has the name {name[:40]!r}, but these label images hold ids without names; "
                'give lines such as "3" = "our part"'
            )
        if known[name] == PERSON_ID:
            raise FormatError(
                f"the map has {PERSON!r} for {name[:40]!r}, but label images hold parts; give a part"
            )
        table[number] = known[name]
    table[list(places.values())] = [known[name] for name in places]
    return table
