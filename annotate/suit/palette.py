"""Palette of the colour-coded suit: the colours of each part of a scheme, as a TOML file.

The file's table ``[colors]`` lists every part's colours as "#rrggbb", except bare skin. ``scheme`` is the
name of a shipped scheme, the path of a scheme file, or a table with the fields of one; a file without it is
of ``paper``.
"""

import json
import re
import tomllib
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme import Part, Scheme
from annotate.scheme.scheme_file import (
    SHIPPED,
    load_scheme,
    scheme_from_fields,
    scheme_to_toml,
)
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_toml

MAX_TOML_BYTES = 300_000  # a scheme of 254 parts and their colours
MAX_SWATCHES = 200  # memory of labelling grows with it
MIN_CHROMA_DISTANCE = 0.06  # below it two swatches look alike in a shaded image; untuned
MAY_BE_BARE = frozenset(
    Region[f"{side}_{end}"] for side in ("LEFT", "RIGHT") for end in ("HAND", "FINGERS", "FOOT", "TOES")
)
"""Regions that a suit may leave without a swatch, if they are parts of their own."""


@dataclass(frozen=True)
class Suit:
    """Palette of K swatches. colors_rgb: uint8 (K, 3), sRGB; parts: uint8 (K,), part id of each in
    ``scheme``.

    Raises CloudError when a part of the body has no colour; a hand or foot that is a part may be bare.
    """

    name: str
    colors_rgb: UInt8
    parts: UInt8
    scheme: Scheme = PAPER

    def __post_init__(self) -> None:
        for part in body_parts(self.scheme):
            if part.id not in self.parts and not may_be_bare(part):
                raise CloudError(f"suit {self.name!r} has no colour for {part.name}; add it under [colors]")

    def swatches_of(self, part: int) -> UInt8:
        """Return the swatches (k, 3) of a part by id, the main one first; k is 0 for a bare part."""
        return np.asarray(self.colors_rgb[self.parts == part])

    @cached_property
    def regions_worn(self) -> Bool:
        """Return bool (K, 24): the regions whose part each swatch belongs to."""
        return np.asarray(self.scheme.table[1 : N_REGIONS + 1] == self.parts[:, None])

    @cached_property
    def look_alikes(self) -> tuple[tuple[int, int], ...]:
        """Return pairs of part ids, low id first, where each colour of one part resembles a colour of the
        other.
        """
        chroma = chromaticity(self.colors_rgb)
        near = np.linalg.norm(chroma[:, None] - chroma[None], axis=2) < MIN_CHROMA_DISTANCE
        worn = set(self.parts.tolist())
        ids = [part.id for part in self.scheme.parts if part.id in worn]
        return tuple((a, b) for a in ids for b in ids if a < b and self._covers(near, a, b))

    def _covers(self, near: Bool, a: int, b: int) -> bool:
        """Return whether each swatch of one part is near a swatch of the other. near: bool (K, K)."""
        both = near[np.ix_(self.parts == a, self.parts == b)]
        return bool(both.any(axis=1).all() or both.any(axis=0).all())

    @property
    def notes(self) -> tuple[str, ...]:
        """Return warnings about parts that look alike."""
        names = {part.id: part.name for part in self.scheme.parts}
        return tuple(
            f"suit {self.name!r}: {names[a]} and {names[b]} differ only in brightness; "
            "choose another hue for one of them"
            for a, b in self.look_alikes
        )


def body_parts(scheme: Scheme) -> tuple[Part, ...]:
    """Return the parts of a scheme that a suit covers: all but things."""
    return tuple(part for part in scheme.parts if not part.is_free)


def may_be_bare(part: Part) -> bool:
    """Return whether a suit may leave a part of the body without a colour: a hand or a foot."""
    return part.regions <= MAY_BE_BARE


def divides(suit: Suit, scheme: Scheme) -> bool:
    """Return whether parts of a suit that lie in one part of a scheme all differ in colour."""
    alike = set(suit.look_alikes)
    for part in body_parts(scheme):
        within = suit.scheme.ids_of(part.regions)
        if len(within) > 1 and (not np.isin(within, suit.parts).all() or alike & {*combinations(within, 2)}):
            return False
    return True


def chromaticity(rgb: NDArray[Any]) -> Float64:
    """Return the chromaticity (..., 2) of sRGB colours (..., 3), 8-bit values, independent of brightness.

    Shares of red and green in linear light: x = R / (R + G + B), y = G / (R + G + B). Gamma: IEC 61966-2-1,
    approximated by 2.2.
    """
    light = _linear(np.arange(256)).take if rgb.dtype == np.uint8 else _linear
    red, green, blue = (light(rgb[..., i]) for i in range(3))
    total = red + green + blue
    return np.stack([red / total, green / total], axis=-1)


def _linear(rgb: NDArray[Any]) -> Float64:
    return np.asarray(np.power(np.asarray(rgb, np.float64) / 255, 2.2) + 1e-6)


def load_suit(path: Path) -> Suit:
    """Read a palette file. Raises CloudError naming the part or value that is wrong.

    The path of a scheme file is relative to the palette file.
    """
    fields = read_toml(path, MAX_TOML_BYTES, "give a palette file (TOML)", CloudError)
    return _suit(fields, f"suit {path}", path)


def suit_from_toml(text: str, what: str) -> Suit:
    """Read a palette from the text of ``suit_to_toml``. what: name of the text in errors. Raises CloudError
    as ``load_suit``.
    """
    try:
        return _suit(tomllib.loads(text), what, Path("suit"))
    except (ValueError, RecursionError) as error:
        raise CloudError(f"{what} is not valid TOML ({error}); correct that line") from error


def _suit(fields: dict[str, Any], what: str, path: Path) -> Suit:
    scheme = _scheme(fields.get("scheme", PAPER.name), what, path.parent)
    ids = {part.name: part.id for part in body_parts(scheme)}
    colors = fields.get("colors")
    if not isinstance(colors, dict):
        raise CloudError(f"{what} has no [colors] table; list the {len(ids)} parts there")
    if unknown := [part for part in colors if part not in ids]:
        raise CloudError(f"{what}: {unknown[0]!r} is not a part; use {', '.join(ids)}")
    entries = ((part, own if isinstance(own, list) else [own]) for part, own in colors.items())
    swatches = [(ids[part], _color(what, part, color)) for part, own in entries for color in own]
    if len(swatches) > MAX_SWATCHES:
        raise CloudError(f"{what} has {len(swatches)} colours; give at most {MAX_SWATCHES}")
    return Suit(
        str(fields.get("name", path.stem)),
        np.array([rgb for _, rgb in swatches], np.uint8).reshape(-1, 3),
        np.array([part for part, _ in swatches], np.uint8),
        scheme,
    )


def _scheme(given: object, what: str, folder: Path) -> Scheme:
    """Return the scheme of a palette's entry: a shipped name, a path relative to ``folder``, or a table."""
    if not isinstance(given, (str, dict)):
        raise CloudError(f"{what} has scheme {given!r}; give the name of a scheme or a scheme file (TOML)")
    try:
        if isinstance(given, dict):
            return scheme_from_fields(given)
        return load_scheme(given if given in SHIPPED else folder / given)
    except FormatError as error:
        raise CloudError(f"{what}: {error}") from error


def _color(what: str, part: str, color: object) -> tuple[int, ...]:
    if not isinstance(color, str) or not re.fullmatch("#[0-9a-fA-F]{6}", color):
        raise CloudError(f"{what}: {part} has colour {color!r}; give '#rrggbb'")
    return tuple(int(color[i : i + 2], 16) for i in (1, 3, 5))


def suit_to_toml(suit: Suit) -> str:
    """Return a palette as TOML text; inverse of ``suit_from_toml``.

    A scheme that is not shipped is written out, so that the text needs no other file.
    """
    # A JSON string is a TOML string, except that TOML forbids DEL.
    name = json.dumps(suit.name, ensure_ascii=False).replace("\x7f", "\\u007f")
    scheme, lines = suit.scheme, [f"name = {name}"]
    shipped = scheme.name in SHIPPED and scheme == load_scheme(scheme.name)
    if shipped and scheme != PAPER:
        lines.append(f'scheme = "{scheme.name}"')
    lines.append("[colors]")
    for part in body_parts(scheme):
        swatches = ", ".join(
            '"#{:02x}{:02x}{:02x}"'.format(*rgb) for rgb in suit.swatches_of(part.id).tolist()
        )
        lines.append(f"{part.name} = [{swatches}]")
    text = "\n".join(lines) + "\n"
    if shipped:
        return text
    return text + "\n[scheme]\n" + scheme_to_toml(scheme).replace("[[parts]]", "[[scheme.parts]]")


DEFAULT_SUIT = Suit(
    "ten-colour suit with a grey hood",
    np.array([(216, 216, 216), (201, 143, 115), (230, 200, 20), (220, 30, 40), (30, 60, 210), (20, 190, 195),
              (240, 125, 10), (115, 40, 175), (30, 160, 50), (220, 40, 150), (90, 160, 240), (165, 225, 40)],
             np.uint8),
    np.array([PAPER.parts[0].id, *(part.id for part in PAPER.parts)], np.uint8),
)  # fmt: skip
"""Palette of the virtual rig's people: neighbours and twins far apart in chromaticity."""
