"""The text of a BVH file: bones, channels and the rows of its motion, also as sloppy programs write them.

Names may hold blanks (3ds Max Biped: "Bip01 L Thigh") and be in Latin-1; numbers may have decimal commas; the
stated number of frames may be wrong, which Blender ignores (``io_anim_bvh/import_bvh.py``).
"""

import re
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64
from sensors.errors import FormatError

FARTHEST = 1e9
"""Number beyond which none is a place or an angle."""
_BEGIN = re.compile(r"^[ \t]*HIERARCHY\b", re.IGNORECASE | re.MULTILINE)
_MIDDLE = re.compile(r"\bMOTION\s+(?=Frames\s*:)", re.IGNORECASE)
_CHANNEL = re.compile("[xyz](position|rotation)")


class Bone(NamedTuple):
    """One joint of a BVH: parent (-1 root), offset in the file's unit, channels and their first column."""

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    column: int


class BvhText(NamedTuple):
    """Bones of a BVH, values (F, C) of their channels, seconds a frame, and a line on each assumption."""

    bones: list[Bone]
    rows: Float64
    seconds: float
    assumed: list[str]


def parse_bvh(data: bytes) -> BvhText:
    """Return what a BVH's bytes hold. Raises FormatError, ValueError or IndexError when they are damaged."""
    assumed: list[str] = []
    text = _decoded(data, assumed).rstrip("\0\x1a \t\r\n")
    begin, middle = _BEGIN.search(text), _MIDDLE.search(text)
    if begin is None:
        raise FormatError("no HIERARCHY; give a BVH file")
    hierarchy, motion = text[begin.end() :], ""
    if middle is not None:
        hierarchy, motion = text[begin.end() : middle.start()], text[middle.end() :]
    bones = _hierarchy(hierarchy.split())
    rows, seconds = _motion(motion.replace(",", "."), sum(len(bone.channels) for bone in bones), assumed)
    return BvhText(bones, rows, seconds, assumed)


def _decoded(data: bytes, assumed: list[str]) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        assumed.append("names are not in UTF-8 and are read as Latin-1")
        return data.decode("latin-1")


def _hierarchy(tokens: list[str]) -> list[Bone]:
    bones: list[Bone] = []
    open_bones: list[int] = []
    at, columns, name = 0, 0, ""
    while at < len(tokens):
        word = tokens[at].upper()
        if word in ("ROOT", "JOINT", "END"):
            brace = tokens.index("{", at)
            name = " ".join(tokens[at + 1 : brace]) if word != "END" else f"{bones[open_bones[-1]].name}_end"
            at = brace
        elif word == "{":
            bone, at = _bone(tokens, at + 1, name, columns, open_bones[-1] if open_bones else -1)
            bones.append(bone)
            open_bones.append(len(bones) - 1)
            columns += len(bone.channels)
        elif word == "}":
            open_bones.pop()
            at += 1
        else:
            raise FormatError(f"{tokens[at][:40]!r} is not a BVH keyword; export it again")
    if open_bones or not columns:
        raise FormatError("the hierarchy is cut short; copy it again")
    return bones


def _bone(tokens: list[str], at: int, name: str, column: int, parent: int) -> tuple[Bone, int]:
    """Return the bone whose OFFSET is the token ``at``, and the place behind its channels."""
    if tokens[at].upper() != "OFFSET":
        raise FormatError(f"joint {name[:40]!r} has no OFFSET; export it again")
    x, y, z = (float(v.replace(",", ".")) for v in tokens[at + 1 : at + 4])
    if not max(abs(x), abs(y), abs(z)) < FARTHEST:
        raise FormatError(f"joint {name[:40]!r} has the OFFSET {x:g} {y:g} {z:g}; export it again")
    at += 4
    channels: tuple[str, ...] = ()
    if tokens[at].upper() == "CHANNELS":
        count = int(tokens[at + 1])
        channels = tuple(c.lower() for c in tokens[at + 2 : at + 2 + count])
        if len(channels) != count or not all(map(_CHANNEL.fullmatch, channels)):
            raise FormatError(f"joint {name[:40]!r} has channels {' '.join(channels)[:60]}; export it again")
        at += 2 + count
    return Bone(name, parent, (x, y, z), channels, column), at


def _motion(text: str, columns: int, assumed: list[str]) -> tuple[Float64, float]:
    """Return the channels (F, C) of all frames, and seconds a frame."""
    head = re.match(r"\s*Frames\s*:\s*(\d+)\s+Frame\s+Time\s*:\s*(\S+)", text, re.IGNORECASE)
    if head is None:
        raise FormatError("no number of frames and frame time; copy it again")
    stated, seconds = int(head[1]), float(head[2])
    if not 1e-4 <= seconds <= 1:
        raise FormatError(f"frame time {seconds}; give seconds from 0.0001 to 1")
    body = text[head.end() :]
    numbers = np.fromstring(body, sep=" ")
    whole = stated if numbers.size == stated * columns else _whole_rows(body, numbers.size, columns)
    if not whole or not (np.abs(numbers) < FARTHEST).all():
        held = f"claims {stated} frames of {columns} finite numbers and holds {numbers.size}"
        raise FormatError(f"{held}; copy it again")
    if rest := numbers.size - whole * columns:
        assumed.append(f"the last frame is cut off after {rest} of {columns} numbers and was left out")
    if whole != stated:
        assumed.append(f"frames: the file states {stated} and holds {whole}")
    return numbers[: whole * columns].reshape(whole, columns), seconds


def _whole_rows(body: str, numbers: int, columns: int) -> int:
    """Return how many lines are frames, of which the last may be cut off; 0 where others are none."""
    lengths = [len(line.split()) for line in body.splitlines() if line.strip()]
    alike = all(length == columns for length in lengths[:-1]) and sum(lengths) == numbers
    return numbers // columns if lengths and alike and lengths[-1] <= columns else 0
