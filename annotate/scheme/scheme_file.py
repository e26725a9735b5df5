"""Scheme files: TOML with a table ``[[parts]]`` for each part; ``annotate/scheme/schemes`` has shipped ones.

Fields of a part: ``id``, ``name``, ``title``, ``color`` ("#rrggbb"), ``key``, ``regions``; a part without
regions is free. ``twins`` and ``neighbours`` are lists of pairs of names.
"""

import json
import re
import shlex
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from annotate.scheme.checks import color_faults, identity_faults, pair_faults, region_faults
from annotate.scheme.regions import Region
from annotate.scheme.scheme import MAX_PARTS, Part, Scheme, derived_neighbours, derived_twins, scheme_of
from sensors.errors import FormatError
from sensors.files.bounded import read_toml

MAX_TOML_BYTES = 200_000  # three times a file of 254 parts
SHIPPED = ("paper", "hands-and-feet", "six", "trunk-and-limbs", "smpl-24", "kinect", "atlas")
"""Names of the shipped schemes, the default first."""

_FOLDER = Path(__file__).with_name("schemes")
_SCHEME_NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)
_PART_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}", re.ASCII)
_COLOR = re.compile("#[0-9a-fA-F]{6}")
_FIELDS = ("id", "name", "title", "color", "key", "regions")
_REGIONS = {region.label: region for region in Region}
_REMEDY = "give a scheme file (TOML)"


@dataclass(frozen=True)
class Draft:
    """Scheme whose colours are not checked. uncolored: ids of parts without a colour; they are black."""

    scheme: Scheme
    uncolored: frozenset[int]


def load_scheme(name_or_path: str | Path) -> Scheme:
    """Return a shipped scheme by name, otherwise the scheme of a file. Raises FormatError with one fault."""
    if name_or_path in SHIPPED:
        return _shipped(str(name_or_path))
    path = Path(name_or_path)
    if not path.exists():
        raise FormatError(f"scheme {str(path)!r} does not exist; use {', '.join(SHIPPED)} or a file (TOML)")
    return read_scheme(path)


@cache
def _shipped(name: str) -> Scheme:
    """Read a shipped file, whose laws are a test."""
    return read_draft(_FOLDER / f"{name}.toml").scheme


def read_scheme(path: Path) -> Scheme:
    """Read and check a file. Raises FormatError with the first fault."""
    draft, faults = _checked(path)
    if draft is None or faults:
        raise FormatError(faults[0])
    return draft.scheme


def read_draft(path: Path) -> Draft:
    """Read a file and check all but its colours. Raises FormatError with the first fault."""
    draft, faults = _read(path)
    if draft is None:
        raise FormatError(faults[0])
    return draft


def faults_in(path: Path) -> list[str]:
    """Return all faults of a file, one line each. Raises FormatError for a file that is not TOML."""
    return _checked(path)[1]


def _checked(path: Path) -> tuple[Draft | None, list[str]]:
    draft, faults = _read(path)
    if draft is None:
        return None, faults
    scheme = draft.scheme
    if scheme.name in SHIPPED and scheme != _shipped(scheme.name):
        faults.append(f"{path}: the scheme has the name of a shipped one, {scheme.name!r}; give another name")
    if draft.uncolored:
        names = ", ".join(part.name for part in scheme.parts if part.id in draft.uncolored)
        remedy = f"run annotate-cloud scheme colours {shlex.quote(str(path))}"
        return draft, [*faults, f"{path}: parts without colour: {names}; {remedy}"]
    return draft, [*faults, *(f"{path}: {fault}" for fault in color_faults(scheme, str(path)))]


def _read(path: Path) -> tuple[Draft | None, list[str]]:
    """Return the content of a file, or None and the faults."""
    draft, faults = _draft(read_toml(path, MAX_TOML_BYTES, _REMEDY), path.stem)
    return draft, [f"{path}: {fault}" for fault in faults]


def _draft(fields: dict[str, Any], stem: str) -> tuple[Draft | None, list[str]]:
    """Return the scheme of a file's fields, or None and the faults. stem: name of a scheme without one."""
    try:
        name, rows = _head(fields, stem)
        parts, faults = _parts(rows)
        faults = faults or [*identity_faults(parts)]
        if faults:
            return None, faults
        ids = {part.name: part.id for part in parts}
        twins, pairs = (_pairs(fields, key, ids) for key in ("twins", "neighbours"))
    except FormatError as error:
        return None, [str(error)]
    neighbours = [frozenset(pair) for pair in pairs]
    faults = [*region_faults(parts), *pair_faults(parts, twins, neighbours)]
    if faults:
        return None, faults
    uncolored = frozenset(part.id for part, row in zip(parts, rows, strict=True) if "color" not in row)
    return Draft(scheme_of(name, parts, twins, neighbours), uncolored), []


def _head(fields: dict[str, Any], stem: str) -> tuple[str, list[dict[str, Any]]]:
    known = ("name", "parts", "twins", "neighbours")
    if unknown := [one for one in fields if one not in known]:
        raise FormatError(f"the scheme has the unknown field {unknown[0]!r}; use {', '.join(known)}")
    name, rows = fields.get("name", stem), fields.get("parts")
    check_scheme_name(name)
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise FormatError("the scheme has no parts; add a table [[parts]] for each")
    if len(rows) > MAX_PARTS:
        raise FormatError(f"the scheme has {len(rows)} parts; give at most {MAX_PARTS}")
    return str(name), rows


def check_scheme_name(name: object) -> None:
    """Raise FormatError for a name that scheme files do not allow."""
    if not isinstance(name, str) or not _SCHEME_NAME.fullmatch(name):
        raise FormatError(f"the scheme has name {name!r}; use up to 64 letters, digits and . _ -")


def _parts(rows: list[dict[str, Any]]) -> tuple[tuple[Part, ...], list[str]]:
    """Return the parts of tables, or the faults of their values."""
    parts, faults = list[Part](), list[str]()
    for number, row in enumerate(rows, 1):
        try:
            parts.append(_part(row, number))
        except FormatError as error:
            faults.append(str(error))
    return tuple(parts), faults


def _part(row: dict[str, Any], number: int) -> Part:
    name = row.get("name")
    if not isinstance(name, str) or not _PART_NAME.fullmatch(name):
        raise FormatError(f"part {number} has name {name!r}; use a to z, 0 to 9 and _, a letter first")
    if unknown := [one for one in row if one not in _FIELDS]:
        raise FormatError(f"part {name!r} has the unknown field {unknown[0]!r}; use {', '.join(_FIELDS)}")
    part_id, color, regions = row.get("id"), row.get("color", "#000000"), row.get("regions", [])
    if type(part_id) is not int:
        raise FormatError(f"part {name!r} has id {part_id!r}; give a whole number from 1 to {MAX_PARTS}")
    texts = [row.get("title", name.replace("_", " ").capitalize()), row.get("key", "")]
    for field, text, most in zip(("title", "key"), texts, (100, 20), strict=True):
        if not isinstance(text, str) or not text.isprintable() or len(text) > most:
            raise FormatError(f"part {name!r} has {field} {text!r}; give a text of at most {most} characters")
    if not isinstance(color, str) or not _COLOR.fullmatch(color):
        raise FormatError(f"part {name!r} has color {color!r}; give '#rrggbb'")
    if not isinstance(regions, list):
        raise FormatError(f"part {name!r} has regions {regions!r}; give a list of names")
    red, green, blue = bytes.fromhex(color[1:])
    return Part(part_id, name, texts[0], (red, green, blue), texts[1], _regions(name, regions))


def _regions(name: str, labels: list[Any]) -> frozenset[Region]:
    for label in labels:
        if not isinstance(label, str) or label not in _REGIONS:
            raise FormatError(f"part {name!r} has the unknown region {label!r}; use {', '.join(_REGIONS)}")
    if len(set(labels)) < len(labels):
        raise FormatError(f"part {name!r} has a region twice; name it once")
    return frozenset(_REGIONS[label] for label in labels)


def _pairs(fields: dict[str, Any], key: str, ids: dict[str, int]) -> list[tuple[int, int]]:
    """Return the pairs of ids that a file states."""
    pairs = fields.get(key, [])
    if not isinstance(pairs, list) or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise FormatError(f'{key} are not a list of pairs; write {key} = [["left_wheel", "right_wheel"]]')
    for name in (name for pair in pairs for name in pair):
        if not isinstance(name, str) or name not in ids:
            raise FormatError(f"{key} have the unknown part {name!r}; use {', '.join(ids)}")
    return [(ids[one], ids[other]) for one, other in pairs]


def scheme_to_fields(scheme: Scheme) -> dict[str, Any]:
    """Return the fields of a scheme file as JSON values; inverse of ``scheme_from_fields``."""
    fields: dict[str, Any] = {"name": scheme.name}
    names = {part.id: part.name for part in scheme.parts}
    for key, pairs in (
        ("twins", [pair for pair in scheme.twins if pair not in derived_twins(scheme.parts)]),
        ("neighbours", sorted(map(sorted, scheme.neighbours - derived_neighbours(scheme.parts)))),
    ):
        if pairs:
            fields[key] = [[names[one], names[other]] for one, other in pairs]
    fields["parts"] = [_part_fields(part) for part in scheme.parts]
    return fields


def _part_fields(part: Part) -> dict[str, Any]:
    color = "#{:02x}{:02x}{:02x}".format(*part.rgb)
    fields: dict[str, Any] = {"id": part.id, "name": part.name, "title": part.title, "color": color}
    if part.key:
        fields["key"] = part.key
    if part.regions:
        fields["regions"] = [region.label for region in sorted(part.regions)]
    return fields


def scheme_from_fields(fields: object) -> Scheme:
    """Return the scheme of the fields of a file, such as a manifest's.

    Colours are not checked, because a manifest holds colours that were checked once. Raises FormatError with
    the first fault.
    """
    if not isinstance(fields, dict):
        raise FormatError("the scheme is not a table of fields; restore it from a copy")
    draft, faults = _draft(fields, "")
    if draft is None:
        raise FormatError(faults[0])
    return draft.scheme


def scheme_to_toml(scheme: Scheme, heading: str = "") -> str:
    """Return the text of a scheme file; inverse of ``read_scheme``. heading: lines of comment."""
    fields = scheme_to_fields(scheme)
    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    lines += [f"{key} = {_text(value)}" for key, value in fields.items() if key != "parts"]
    for part in fields["parts"]:
        lines += ["", "[[parts]]", *(f"{key} = {_text(value)}" for key, value in part.items())]
    return "\n".join(lines) + "\n"


def _text(value: object) -> str:
    """Return a TOML value of printable texts and numbers."""
    return json.dumps(value, ensure_ascii=False)
