"""Contact sheets of dressed people: ``python -m tools.measure.people.clothes_sheets FOLDER [PEOPLE] [SEED]``.

Writes ``sheet_N.png``, six people each: a row a person, who stands, strides, crouches, sits and lies, seen
from the front, the side and behind; shaded depth above, parts below.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.parts import palette_rgb
from sensors.rig.camera import Intrinsics
from synth.body.body import Body, blend
from synth.body.crowd import crowd
from synth.clothes.dress import dress, put_down
from synth.clothes.dressed import Dressed
from synth.pose.postures import FALLEN, SITTING, UPRIGHT, lie, rise, sit
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing
from synth.surface.furniture import Bed, Sofa
from synth.surface.rasterize import ZBuffer, beside, look_at, rasterize

PEOPLE_A_SHEET = 6
TILE = (240, 150)
AWAY_M, SPAN_M = 8.0, 2.1
VIEWS = {"front": 0.0, "side": 90.0, "back": 180.0}
CARRYING = ("standing", "striding")
STRIDE = {"left_hip": 28.0, "right_hip": -14.0, "left_knee": 14.0, "right_knee": 24.0, "pitch": 4.0}


def random_person(rng: np.random.Generator) -> Body:
    """A build between two of the crowd."""
    i, j = rng.choice(len(crowd()), 2, replace=False)
    return blend(crowd()[i], crowd()[j], float(rng.random()) / 2)


def posed(dressed: Dressed, rng: np.random.Generator) -> Iterator[tuple[str, Dressed, Float32, Float64]]:
    """The person in each posture: its name, what is worn in it, draped vertices, joints."""
    standing = UPRIGHT.draw("standing", rng)
    moments = {
        "standing": stand(dressed.body, draw_standing(rng))[:2],
        "striding": rise(dressed.body, None, {**standing, **STRIDE}),
        "crouching": rise(dressed.body, None, UPRIGHT.draw("crouching", rng)),
        "sitting": sit(dressed.body, Sofa.sample(rng), SITTING.single(rng)[1]),
        "lying": lie(dressed.body, Bed.sample(rng), FALLEN.single(rng)[1]),
    }
    for name, (vertices, joints) in moments.items():
        who = dressed if name in CARRYING else put_down(dressed)
        yield name, who, who.drape(vertices, joints), joints


def seen(
    vertices_m: Float32, dressed: Dressed, joints_m: Float64, azimuth_deg: float, height_m: float
) -> ZBuffer:
    """The person alone, from so far away that all of it is in view."""
    middle = (vertices_m.min(axis=0) + vertices_m.max(axis=0)).astype(np.float64) / 2
    pose = look_at(beside(middle, np.radians(azimuth_deg), AWAY_M, middle[2] + height_m), middle)
    points = (vertices_m @ pose.rotation.T + pose.translation_m).astype(np.float32)
    f = TILE[0] / SPAN_M * AWAY_M
    camera = Intrinsics(width=TILE[1], height=TILE[0], fx=f, fy=f, cx=TILE[1] / 2, cy=TILE[0] / 2)
    return rasterize(camera, points, dressed.faces, closed=True)


def shaded(depth_m: Float32) -> UInt8:
    """Grey (h, w, 3) lit from the upper left."""
    filled = np.where(np.isnan(depth_m), np.nanmax(depth_m) + 0.3, depth_m)
    y, x = np.gradient(cv2.GaussianBlur(filled, (0, 0), 0.5) * TILE[0] / SPAN_M)
    light = np.clip((1 - 0.5 * x - 0.5 * y) / np.sqrt(1 + x * x + y * y) / 1.2, 0, 1)
    grey = np.where(np.isnan(depth_m), 255, 40 + 200 * light).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def row(body: Body, rng: np.random.Generator) -> UInt8:
    """All looks at one person, side by side."""
    dressed, tiles = dress(body, rng), []
    colours = palette_rgb()
    colours[255] = 255
    for name, who, vertices, joints in posed(dressed, rng):
        parts = np.append(who.face_parts, np.uint8(255))
        for azimuth in VIEWS.values():
            turn = azimuth + (35 if name == "lying" else 0)
            z = seen(vertices, who, joints, turn, 5.0 if name == "lying" else 0.6)
            tiles.append(np.vstack([shaded(z.depth_m), colours[parts[z.face]]]))
    return np.hstack(tiles)


def main(folder: Path, people: int, seed: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for sheet in range(-(-people // PEOPLE_A_SHEET)):
        numbers = range(sheet * PEOPLE_A_SHEET, min(people, (sheet + 1) * PEOPLE_A_SHEET))
        rngs = [np.random.default_rng((seed, i)) for i in numbers]
        image = np.vstack([row(random_person(rng), rng) for rng in rngs])
        cv2.imwrite(str(folder / f"sheet_{sheet}.png"), image[..., ::-1])


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(a) for a in (*sys.argv[2:4], *("60", "0")[len(sys.argv) - 2 :])))
