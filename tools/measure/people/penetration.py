"""Measure penetration over sampled poses: ``python -m tools.measure.people.penetration [POSES] [SEED]``.

Prints, in millimetres, the median and the 99th percentile of the deepest self-penetration and of the deepest
penetration into furniture beyond its give, by family and over all, and what goes into what.
"""

import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from annotate.parts import PARTS
from synth.body.body import Body, shipped_bodies
from synth.pose.postures import FALLEN, IN_BED, SITTING, UPRIGHT, lie, rise, sit
from synth.surface.furniture import FLOOR, Bed, Chair, Ground, Sofa, Solid
from tests.helpers.penetration import furniture_penetration_m, penetrations_m

Posed = tuple[str, list[Solid], NDArray[np.float32], NDArray[np.float64]]


def sitting(body: Body, rng: np.random.Generator) -> Posed:
    activity = str(rng.choice(list(SITTING.activities)))
    seat = Sofa.sample(rng) if rng.random() < 0.8 else Chair.sample(rng)
    return activity, [FLOOR, *seat.solids()], *sit(body, seat, SITTING.draw(activity, rng))


def in_bed(body: Body, rng: np.random.Generator) -> Posed:
    activity = str(rng.choice(list(IN_BED.activities)))
    bed = Bed.sample(rng)
    return activity, [FLOOR, *bed.solids()], *lie(body, bed, IN_BED.draw(activity, rng))


def fallen(body: Body, rng: np.random.Generator) -> Posed:
    activity = str(rng.choice(list(FALLEN.activities)))
    return activity, [FLOOR], *lie(body, Ground(), FALLEN.draw(activity, rng))


def upright(body: Body, rng: np.random.Generator) -> Posed:
    activity = str(rng.choice(list(UPRIGHT.activities)))
    seat = Sofa.sample(rng) if rng.random() < 0.3 else None
    solids = [FLOOR, *(seat.solids() if seat else [])]
    return activity, solids, *rise(body, seat, UPRIGHT.draw(activity, rng))


FAMILIES: dict[str, Callable[[Body, np.random.Generator], Posed]] = {
    "sitting": sitting,
    "in bed": in_bed,
    "fallen": fallen,
    "upright": upright,
}


def blended_body(rng: np.random.Generator) -> Body:
    """A build between two of the shipped bodies."""
    i, j = rng.choice(8, 2, replace=False)
    a, b, share = shipped_bodies()[i], shipped_bodies()[j], rng.random()
    return replace(
        a,
        vertices_m=((1 - share) * a.vertices_m + share * b.vertices_m).astype(np.float32),
        joints_m=(1 - share) * a.joints_m + share * b.joints_m,
    )


def main(poses: int, seed: int) -> None:
    deepest: dict[str, list[float]] = defaultdict(list)
    sunk: dict[str, list[float]] = defaultdict(list)
    worst: dict[str, list[tuple[float, str]]] = defaultdict(list)
    seconds = 0.0
    for i in range(poses):
        rng = np.random.default_rng((seed, i))
        family = list(FAMILIES)[i % len(FAMILIES)]
        body = blended_body(rng)
        started = process_time()
        activity, solids, vertices, joints = FAMILIES[family](body, rng)
        seconds += process_time() - started
        found = penetrations_m(body, vertices, joints)
        pair = max(found, key=lambda key: found[key], default=(0, 0))
        deepest[family].append(1000 * found.get(pair, 0.0))
        sunk[family].append(1000 * furniture_penetration_m(vertices, solids))
        worst[family].append(
            (deepest[family][-1], f"{activity}: {PARTS[pair[0]].name} > {PARTS[pair[1]].name}")
        )
        worst[family + " furniture"].append((sunk[family][-1], activity))
    print(f"{poses} poses, seed {seed}, {1000 * seconds / poses:.2f} ms of CPU a pose, a new body each time")
    for family in (*FAMILIES, "all"):
        own, furniture = (
            np.concatenate(list(d.values())) if family == "all" else np.array(d[family])
            for d in (deepest, sunk)
        )
        line = " ".join(
            f"{np.median(v):6.1f} {np.percentile(v, 99):6.1f} {v.max():6.1f}" for v in (own, furniture)
        )
        print(f"{family:8s} self, furniture (median p99 max mm): {line}")
    for family, entries in worst.items():
        print(
            family,
            Counter(name for depth, name in entries if depth > 15).most_common(7),
            sorted(entries)[-4:],
        )


if __name__ == "__main__":
    main(*(int(a) for a in (*sys.argv[1:3], *("1000", "0")[len(sys.argv) - 1 :])))
