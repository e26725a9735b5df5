"""Dressed person: a body with displaced skin, and hanging pieces."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from annotate.array_types import Float32, Float64, Int32, UInt8
from synth.body.atlas_border import regions_of_faces
from synth.body.body import Body


class Piece(Protocol):
    """Hanging piece of clothing that does not follow the skin: a skirt, a bag.

    faces: (f, 3) among the piece's v vertices, outwards, closed. face_parts: (f,) part of the body beneath.
    dark: (f,) absorbed share of infrared.
    """

    @property
    def faces(self) -> Int32: ...
    @property
    def face_parts(self) -> UInt8: ...
    @property
    def dark(self) -> Float32: ...
    def place(self, vertices_m: Float32, joints_m: Float64) -> Float32:
        """Return the vertices (v, 3) on a posed body (V, 3) with joints (J, 3), world, metres."""


@dataclass(frozen=True, eq=False)
class Dressed:
    """Dressed person.

    body: with displaced skin, to be posed and settled. faces: (F', 3), face_parts: (F',) and dark: (F',)
    absorbed share of infrared: first of the body, then of the pieces.
    """

    clothes: tuple[str, ...]
    body: Body
    pieces: tuple[Piece, ...]
    faces: Int32
    face_parts: UInt8
    dark: Float32

    @cached_property
    def face_regions(self) -> UInt8:
        """Return the region id (F',) of each face; clothes have the regions of the body beneath."""
        at_rest = self.drape(self.body.vertices_m, self.body.joints_m)
        middles = at_rest[self.faces].mean(axis=1, dtype=np.float64)
        return regions_of_faces(self.face_parts, middles, self.body.joints_m)

    def drape(self, vertices_m: Float32, joints_m: Float64) -> Float32:
        """Return the vertices (V', 3) of the posed body (V, 3), then of the pieces, world, metres."""
        if not self.pieces:
            return vertices_m
        return np.concatenate([vertices_m, *(piece.place(vertices_m, joints_m) for piece in self.pieces)])


def assembled(
    body: Body, dark: Float32, pieces: Sequence[Piece] = (), clothes: Sequence[str] = ()
) -> Dressed:
    """Return the dressed person of a displaced body and pieces. dark: (F,), absorbed share of infrared."""
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
