"""Palette of the colour-coded suit: the colours of each part, as a TOML file.

The file's table ``[colors]`` lists every part's colours as "#rrggbb", except bare skin.
"""

import json
import re
import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, UInt8
from annotate.parts import BODY_PARTS, PART_ID, PARTS
from sensors.errors import CloudError
from sensors.files.bounded import read_toml

MAX_TOML_BYTES = 100_000
MAX_SWATCHES = 200  # memory of labelling grows with it
MIN_CHROMA_DISTANCE = 0.06  # below it two swatches look alike in a shaded image; untuned


@dataclass(frozen=True)
class Suit:
    """Palette of K swatches. colors_rgb: uint8 (K, 3), sRGB; parts: uint8 (K,), part id of each.

    Raises CloudError when a part has no colour.
    """

    name: str
    colors_rgb: UInt8
    parts: UInt8

    def __post_init__(self) -> None:
        for part in BODY_PARTS:
            if part.id not in self.parts:
                raise CloudError(f"suit {self.name!r} has no colour for {part.name}; add it under [colors]")

    @cached_property
    def look_alikes(self) -> tuple[tuple[int, int], ...]:
        """Return pairs of part ids, low id first, where each colour of one part resembles a colour of the
        other.
        """
        chroma = chromaticity(self.colors_rgb)
        near = np.linalg.norm(chroma[:, None] - chroma[None], axis=2) < MIN_CHROMA_DISTANCE
        ids = [part.id for part in BODY_PARTS]
        return tuple((a, b) for a in ids for b in ids if a < b and self._covers(near, a, b))

    def _covers(self, near: Bool, a: int, b: int) -> bool:
        """Return whether each swatch of one part is near a swatch of the other. near: bool (K, K)."""
        both = near[np.ix_(self.parts == a, self.parts == b)]
        return bool(both.any(axis=1).all() or both.any(axis=0).all())

    @property
    def notes(self) -> tuple[str, ...]:
        """Return warnings about parts that look alike."""
        return tuple(
            f"suit {self.name!r}: {PARTS[a].name} and {PARTS[b].name} differ only in brightness; "
            "choose another hue for one of them"
            for a, b in self.look_alikes
        )


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
    """Read a palette file. Raises CloudError naming the part or value that is wrong."""
    fields = read_toml(path, MAX_TOML_BYTES, "give a palette file (TOML)", CloudError)
    return _suit(fields, f"suit {path}", path.stem)


def suit_from_toml(text: str, what: str) -> Suit:
    """Read a palette from the text of ``suit_to_toml``. what: name of the text in errors. Raises CloudError
    as ``load_suit``.
    """
    try:
        return _suit(tomllib.loads(text), what, "suit")
    except (ValueError, RecursionError) as error:
        raise CloudError(f"{what} is not valid TOML ({error}); correct that line") from error


def _suit(fields: dict[str, Any], what: str, name: str) -> Suit:
    colors = fields.get("colors")
    if not isinstance(colors, dict):
        raise CloudError(f"{what} has no [colors] table; list the eleven parts there")
    entries = ((part, own if isinstance(own, list) else [own]) for part, own in colors.items())
    swatches = [_swatch(what, part, color) for part, own in entries for color in own]
    if len(swatches) > MAX_SWATCHES:
        raise CloudError(f"{what} has {len(swatches)} colours; give at most {MAX_SWATCHES}")
    return Suit(
        str(fields.get("name", name)),
        np.array([rgb for _, rgb in swatches], np.uint8).reshape(-1, 3),
        np.array([part for part, _ in swatches], np.uint8),
    )


def _swatch(what: str, part: str, color: object) -> tuple[int, tuple[int, ...]]:
    if part not in PART_ID or part == "background":
        raise CloudError(f"{what}: {part!r} is not a part; use {', '.join(p.name for p in BODY_PARTS)}")
    if not isinstance(color, str) or not re.fullmatch("#[0-9a-fA-F]{6}", color):
        raise CloudError(f"{what}: {part} has colour {color!r}; give '#rrggbb'")
    return PART_ID[part], tuple(int(color[i : i + 2], 16) for i in (1, 3, 5))


def suit_to_toml(suit: Suit) -> str:
    """Return a palette as TOML text; inverse of ``suit_from_toml``."""
    # A JSON string is a TOML string, except that TOML forbids DEL.
    name = json.dumps(suit.name, ensure_ascii=False).replace("\x7f", "\\u007f")
    lines = [f"name = {name}", "[colors]"]
    for part in BODY_PARTS:
        swatches = ", ".join(
            '"#{:02x}{:02x}{:02x}"'.format(*rgb) for rgb in suit.colors_rgb[suit.parts == part.id].tolist()
        )
        lines.append(f"{part.name} = [{swatches}]")
    return "\n".join(lines) + "\n"


DEFAULT_SUIT = Suit(
    "ten-colour suit with a grey hood",
    np.array([(216, 216, 216), (201, 143, 115), (230, 200, 20), (220, 30, 40), (30, 60, 210), (20, 190, 195),
              (240, 125, 10), (115, 40, 175), (30, 160, 50), (220, 40, 150), (90, 160, 240), (165, 225, 40)],
             np.uint8),
    np.array([1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11], np.uint8),
)  # fmt: skip
"""Palette of the virtual rig's people: neighbours and twins far apart in chromaticity."""
