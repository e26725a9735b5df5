"""A dressed person: a body whose skin stands off by its clothes, and pieces that hang about it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from annotate.array_types import Float32, Float64, Int32, UInt8
from synth.body.body import Body


class Piece(Protocol):
    """What hangs about a body rather than follows its skin: a skirt, a bag.

    faces: int32 (f, 3) among the piece's own v vertices, outwards, closed. face_parts: uint8 (f,) part of the
    body beneath. dark: float32 (f,) share of infrared that is lost.
    """

    @property
    def faces(self) -> Int32: ...
    @property
    def face_parts(self) -> UInt8: ...
    @property
    def dark(self) -> Float32: ...
    def place(self, vertices_m: Float32, joints_m: Float64) -> Float32:
        """Vertices float32 (v, 3) about a posed body's vertices (V, 3) and joints (J, 3), world, metres."""


@dataclass(frozen=True, eq=False)
class Dressed:
    """A dressed person, ready to be posed, settled, draped and seen.

    clothes: names of what is worn. body: displaced skin, topology, joints and parts as the naked body's;
    this is posed and settled. pieces: what hangs. faces: int32 (F', 3), face_parts: uint8 (F',) part of the
    body beneath, dark: float32 (F',) share of infrared that is lost (hair, dark cloth): the body's faces
    first, then those of the pieces.
    """

    clothes: tuple[str, ...]
    body: Body
    pieces: tuple[Piece, ...]
    faces: Int32
    face_parts: UInt8
    dark: Float32

    def drape(self, vertices_m: Float32, joints_m: Float64) -> Float32:
        """Vertices float32 (V', 3): the posed body's (V, 3), then the hanging pieces' about it.

        joints_m: (J, 3); all world, metres, as ``pose`` and ``settle`` leave them.
        """
        if not self.pieces:
            return vertices_m
        return np.concatenate([vertices_m, *(piece.place(vertices_m, joints_m) for piece in self.pieces)])


def assembled(
    body: Body, dark: Float32, pieces: Sequence[Piece] = (), clothes: Sequence[str] = ()
) -> Dressed:
    """A displaced body, the darkness (F,) of its faces, the pieces about it, names of what is worn."""
    faces, first = [body.faces], len(body.vertices_m)
    for piece in pieces:
        faces.append(piece.faces + np.int32(first))
        first += int(piece.faces.max()) + 1
    return Dressed(
        tuple(clothes),
        body,
        tuple(pieces),
        np.concatenate(faces),
        np.concatenate([body.face_parts, *(piece.face_parts for piece in pieces)]),
        np.concatenate([dark.astype(np.float32), *(piece.dark for piece in pieces)]),
    )
