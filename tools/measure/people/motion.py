"""Motions on bodies: ``python -m tools.measure.people.motion LIBRARY OUT.jsonl [EVERY]``; run again to go on.

LIBRARY is a motion, or a folder of them; every EVERY-th (10th) frame drives three bodies: small and heavy,
tall and thin, and of the paper. One line of OUT a motion and body: how far feet that stand in the motion are
from the floor, how far the lowest point of what is in the air is from its height, the deepest
self-penetration, and that into a seat, in millimetres. At the end their quantiles over all.
"""

import json
import sys
from pathlib import Path

import numpy as np

from synth.body.body import Body, shipped_bodies
from synth.body.crowd import crowd
from synth.markers.person_fit import leg_length_m, zero_bones
from synth.motion.grounded import Grounded, ground
from synth.motion.library import motion_files, read_motions
from synth.motion.placed import hovering, stand, take_seat
from synth.surface.furniture import FLOOR, Chair
from tests.helpers.penetration import furniture_penetration_m, self_penetration_m

BODIES = (crowd()[2], crowd()[13], shipped_bodies()[4])
MEASURES = ("feet_mm", "air_mm", "self_mm", "seat_mm")


def foot_vertices(body: Body) -> list[np.ndarray]:
    """Vertices that follow the left, and the right foot."""
    from synth.body.skeleton import JOINT_ID

    return [np.flatnonzero(body.strongest_joints == JOINT_ID[f"{side}_ankle"]) for side in ("left", "right")]


def measure(body: Body, grounded: Grounded, every: int) -> dict[str, list[float]]:
    """Values of every measure over the frames, millimetres."""
    feet, found = foot_vertices(body), {name: [] for name in MEASURES}
    scale = leg_length_m(zero_bones(body.joints_m)) / grounded.leg_m
    for f in np.flatnonzero(grounded.sound)[::every]:
        if grounded.sits[f]:
            (vertices, joints), seat = take_seat(body, grounded, f, Chair())
            solids = [FLOOR, *seat.solids()]
        else:
            (vertices, joints), solids = stand(body, grounded, f), [FLOOR]
        for foot, clear in zip(feet, grounded.clear_m[f], strict=False):
            if clear == 0:
                found["feet_mm"].append(1000 * float(vertices[foot, 2].min()))
        air = scale * hovering(grounded.clear_m[f]).min()
        if air > 0:
            found["air_mm"].append(1000 * float(vertices[:, 2].min() - air))
        found["self_mm"].append(1000 * self_penetration_m(body, vertices, joints))
        if grounded.sits[f]:
            found["seat_mm"].append(1000 * furniture_penetration_m(vertices, solids))
    return {name: np.round(values, 1).tolist() for name, values in found.items()}


def main(library: Path, out: Path, every: int) -> None:
    done = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    known = {(row["motion"], row["body"]) for row in done}
    with out.open("a") as file:
        for path in motion_files(library):
            for name, motion in read_motions(path).items():
                if len({(name, body.name) for body in BODIES} - known) == 0:
                    continue
                grounded = ground(motion)
                for body in BODIES:
                    if (name, body.name) not in known:
                        row = {"motion": name, "body": body.name, **measure(body, grounded, every)}
                        done.append(row)
                        file.write(json.dumps(row) + "\n")
                        file.flush()
    for measured in MEASURES:
        values = np.concatenate([row[measured] for row in done])
        if len(values):
            shown = " ".join(f"{value:.1f}" for value in np.percentile(values, [0, 50, 99, 100]))
            print(f"{measured}: {len(values)} values; least, median, 99 %, most: {shown}")
    for row in sorted(done, key=lambda row: -max(row["self_mm"], default=0))[:5]:
        print(row["motion"], row["body"], "self", max(row["self_mm"], default=0))
    for row in sorted(done, key=lambda row: -np.abs(row["feet_mm"]).max(initial=0))[:5]:
        print(row["motion"], row["body"], "feet", row["feet_mm"][int(np.abs(row["feet_mm"]).argmax())])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int([*sys.argv[3:4], "10"][0]))
