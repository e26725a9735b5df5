"""Room: floor, walls and what stands at them. Constants are untuned."""

from dataclasses import dataclass

import numpy as np

from synth.data_files import JUDGE, Cast, table_of
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box, merge, sheet

SHELVES_FROM_M = 1.0  # least distance of shelves and pillars from the middle of the back wall


@dataclass(frozen=True)
class Room:
    """Room about a place, world frame, metres.

    left_x, right_x: side walls, as the robot sees the place. front_y: wall behind the robot. height: of the
    ceiling. shelves, pillar: (x, width, depth, height) of a bookcase and a pillar at the back wall, if any.
    """

    left_x: float = -3.0
    right_x: float = 3.0
    front_y: float = -3.6
    height: float = 2.5
    shelves: tuple[float, float, float, float] | None = None
    pillar: tuple[float, float, float, float] | None = None

    def mesh(self, back_y: float) -> Mesh:
        """Return floor, walls and fixtures. back_y: y of the wall behind the person."""
        depth = np.array([0, back_y - self.front_y, 0])
        width, up = np.array([self.right_x - self.left_x, 0, 0]), np.array([0, 0, self.height])
        corner = np.array([self.left_x, self.front_y, 0])
        sheets = [
            sheet(corner, width, depth, Surface.FLOOR),
            sheet(corner + depth, width, up, Surface.WALL),
            sheet(corner, width, up, Surface.WALL),
            sheet(corner, depth, up, Surface.WALL),
            sheet(corner + width, depth, up, Surface.WALL),
        ]
        return merge(sheets + self._fixtures(back_y))

    def _fixtures(self, back_y: float) -> list[Mesh]:
        meshes = []
        if self.pillar is not None:
            x, wide, deep, _ = self.pillar
            meshes.append(box((x, back_y - deep, 0), (x + wide, back_y, self.height), Surface.WALL))
        if self.shelves is not None:
            x, wide, deep, high = self.shelves
            board = 0.02
            for left in (x, x + wide - board):
                meshes.append(box((left, back_y - deep, 0), (left + board, back_y, high), Surface.TABLE))
            for z in np.arange(0.0, high, 0.36):
                meshes.append(box((x, back_y - deep, z), (x + wide, back_y, z + board), Surface.TABLE))
        return meshes


PLAIN_ROOM = Room()


def draw_room(cast: Cast, rng: np.random.Generator) -> Room:
    """Return the training cast's room, or draw a room of the judging cast: other sizes, shelves, a pillar."""
    if cast != JUDGE:
        return PLAIN_ROOM
    data = table_of(cast, "rooms")
    sides = [float(rng.uniform(*data["sides"][int(rng.integers(len(data["sides"])))])) for _ in range(2)]
    front, height = (float(rng.uniform(*data[name])) for name in ("front", "height"))
    shelves, pillar = (_fixture(data[name], rng) for name in ("shelves", "pillar"))
    return Room(-sides[0], sides[1], -front, height, shelves, pillar)


def _fixture(
    entry: dict[str, list[float]], rng: np.random.Generator
) -> tuple[float, float, float, float] | None:
    """Draw (x, width, depth, height) of something at the back wall, left or right of the middle."""
    spans = (entry[name] for name in ("width", "depth", "height"))
    wide, deep, high = (float(rng.uniform(low, high)) for low, high in spans)
    x, left = float(rng.uniform(SHELVES_FROM_M, SHELVES_FROM_M + 0.6)), bool(rng.random() < 0.5)
    return (-x - wide if left else x, wide, deep, high) if rng.random() < entry["share"][0] else None
