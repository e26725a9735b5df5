"""Measure dressed people: ``python -m tools.measure.people.clothes [PEOPLE] [SEED]``.

Over the postures and views of ``tools.measure.people.clothes_sheets`` prints, in percent of a person's
pixels: skin that a skirt covers at rest and that is seen all the same, through it, or (which is no fault)
past its edges, as by looking into a hem; cloth over the other side's limb; and the milliseconds of CPU to
dress and drape.
"""

import sys
from time import process_time

import cv2
import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Bool, Float32
from annotate.parts import LEFT_RIGHT
from synth.clothes.dress import dress
from synth.clothes.dressed import Dressed
from synth.clothes.rings import LINED, NODES, RING_M
from synth.clothes.skirt import HangingSkirt
from tools.measure.people.clothes_sheets import VIEWS, posed, random_person, seen

EDGE_M = LINED * RING_M
"""Skin nearer than this to a piece's edges may be seen past them."""
NEARER = 1.3
"""Cloth lies on the wrong limb where its own is that many times as far away, and 2 cm more."""
WORTH_A_LOOK = 0.5
REPEATED = 10
KINDS = ("skin through cloth", "skin seen past an edge", "on the wrong limb")


def covered(dressed: Dressed, edge_m: float = EDGE_M) -> Bool:
    """Faces (F,) of the body that lie within a skirt at rest, ``edge_m`` from its edges."""
    body, hidden = dressed.body, np.zeros(len(dressed.body.faces), bool)
    middles = body.vertices_m[body.faces].mean(axis=1)
    legs = (body.face_parts >= 7) | (body.face_parts == 2)
    first = len(body.vertices_m)
    nodes = dressed.drape(body.vertices_m, body.joints_m)[first:]
    for piece in dressed.pieces:
        own, nodes = np.split(nodes, [int(piece.faces.max()) + 1])
        if not isinstance(piece, HangingSkirt):
            continue
        edge = np.array([0, 0, edge_m])
        inside = ((middles > own.min(axis=0) + edge) & (middles < own.max(axis=0) - edge)).all(axis=1)
        hidden |= inside & legs
    return hidden


def outsides(dressed: Dressed) -> Bool:
    """Faces (F',) that are the outside of a skirt."""
    outside, first = np.zeros(len(dressed.faces), np.bool_), len(dressed.body.faces)
    for piece in dressed.pieces:
        if isinstance(piece, HangingSkirt):
            outside[first : first + 2 * NODES * (len(piece.ease_m) - 1)] = True
        first += len(piece.faces)
    return outside


def poking(bare: Bool, outside: Bool) -> Bool:
    """Pixels (h, w) of patches of ``bare`` skin that border mostly on the ``outside`` of cloth.

    What is seen by looking into a hem borders on lining and on more skin.
    """
    result, (n, patches) = np.zeros_like(bare), cv2.connectedComponents(bare.astype(np.uint8))
    for patch in range(1, n):
        own = patches == patch
        border = cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~own
        result |= own & (outside[border].mean() > 0.5)
    return result


def misplaced(dressed: Dressed, vertices_m: Float32) -> Bool:
    """Faces (F',) of hanging pieces whose label is one limb's while the twin's skin is clearly nearer."""
    wrong, body = np.zeros(len(dressed.faces), bool), dressed.body
    middles = vertices_m[dressed.faces].mean(axis=1)
    for pair in LEFT_RIGHT:
        skins = [cKDTree(vertices_m[np.unique(body.faces[body.face_parts == part])]) for part in pair]
        for own, other in ((0, 1), (1, 0)):
            cloth = np.flatnonzero(dressed.face_parts == pair[own])
            cloth = cloth[cloth >= len(body.faces)]
            away = [skin.query(middles[cloth])[0] for skin in skins]
            wrong[cloth] = NEARER * away[other] + 0.02 < away[own]
    return wrong


def main(people: int, seed: int) -> None:
    shares: dict[str, list[float]] = {kind: [] for kind in KINDS}
    dressing, draping = [], []
    for i in range(people):
        rng = np.random.default_rng((seed, i))
        body = random_person(rng)
        start = process_time()
        dressed = dress(body, rng)
        dressing.append(process_time() - start)
        outside = np.zeros(len(dressed.faces) - len(body.faces), bool)
        hidden = np.append(covered(dressed), outside)
        for name, who, vertices, joints in posed(dressed, rng):
            if not who.pieces:
                continue
            start = process_time()
            for _ in range(REPEATED):
                who.drape(vertices[: len(body.vertices_m)], joints)
            draping.append((process_time() - start) / REPEATED)
            kinds, outside = np.stack([hidden[: len(who.faces)], misplaced(who, vertices)]), outsides(who)
            for view, azimuth in VIEWS.items():
                place = (joints, azimuth, 5.0 if name == "lying" else 0.6)
                face = seen(vertices, who, *place).face
                bare, astray = np.where(face >= 0, kinds[:, face], False)
                through = poking(bare, np.where(face >= 0, outside[face], False))
                pixels = (through, bare & ~through, astray)
                found = [100 * np.count_nonzero(found) / np.count_nonzero(face >= 0) for found in pixels]
                for what, share in zip(shares, found, strict=True):
                    shares[what].append(share)
                    if share > WORTH_A_LOOK:
                        print(f"person {i} {name}, {view}: {share:.2f} % {what}")
    for what, values in shares.items():
        print(
            f"{what}: mean {np.mean(values):.3f} %, "
            f"p95 {np.percentile(values, 95):.3f}, most {max(values):.3f}"
        )
    print(
        f"median ms to dress {1000 * np.median(dressing):.2f}, "
        f"to drape what hangs {1000 * np.median(draping):.3f}"
    )


if __name__ == "__main__":
    main(*(int(a) for a in (*sys.argv[1:3], *("60", "0")[len(sys.argv) - 1 :])))
