"""Errors of the joints that users get: on real people, on the virtual rig and on synthetic images."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from annotate.array_types import Float64, Int64
from eval.scores import intervals
from eval.scores.joint_scores import GROUPS, INSIDE, JointErrors, estimates, scores_of_joints
from eval.scores.joint_visibility import VISIBILITIES, VISIBLE
from eval.scores.joints import JOINT_NAMES
from eval.scores.traits import Traits
from tools.figures import network, rig
from tools.figures.figure import Figure, Rows, without_each
from tools.measure.real_people import People

SHARES = {"within 100 mm": "pck_100mm", "within 50 mm": "pck_50mm"}
TRAITS: dict[str, Callable[[Traits], str]] = {
    "posture": lambda traits: traits.posture,
    "facing": lambda traits: traits.facing,
    "sensor": lambda traits: traits.sensor,
}
LEAST = 50  # images of a group that gets a row


def by_set(seed: int) -> Rows:
    """Measure the network's joints on each set: real people, recordings of the rig, and presets."""
    folders = list(network.people().values())
    people = sum(folders[1:], folders[0])
    rows = {"real people, raw": of_people(people)}
    rows["real people, one offset a joint removed"] = of_people(people.without_offsets())
    for recording, found in rig.measured_recordings(seed).items():
        rows[f"rig: {recording.name}"] = row(found.joints)
    for name, found in network.judged(seed).items():
        if joints := found.compared.joints:
            rows[f"`{name}`"] = row(joints)
    return rows


def by_group(seed: int) -> Rows:
    """Measure the network's joints on all images and recordings of ``by_set``, by visibility and by joint.

    The synthetic images are also measured by posture, facing and sensor.
    """
    recordings = [found.joints for found in rig.measured_recordings(seed).values()]
    images = [found.compared for found in network.judged(seed).values()]
    rows: dict[str, dict[str, Figure]] = {}
    sets = {"images": [one.joints for one in images if one.joints], "rig": recordings}
    for name, found in sets.items():
        together = joined(found)
        groups = (INSIDE, *VISIBILITIES, *(kind for kind in JOINT_NAMES if not kind.startswith("right_")))
        rows |= {
            f"{name}: {group.removeprefix('left_')}": scores(together, both_sides(group)) for group in groups
        }
    for kind, value_of in TRAITS.items():
        own = defaultdict[str, list[JointErrors]](list)
        for one in images:
            values = np.array([value_of(traits) for traits in one.traits])
            for value in np.unique(values[values != ""]).tolist():
                if found_joints := one.only(np.flatnonzero(values == value)).joints:
                    own[value].append(found_joints)
        for value, parts in sorted(own.items()):
            if sum(len(part.subjects) for part in parts) >= LEAST:
                rows[f"images: {kind} {value}"] = scores(joined(parts), (INSIDE,))
    return rows


def joined(parts: Iterable[JointErrors]) -> JointErrors:
    """Return the errors of several sets as one; equal names are one person."""
    parts = list(parts)
    return JointErrors(
        np.concatenate([one.errors_mm for one in parts]),
        np.concatenate([one.visibility for one in parts]),
        tuple(name for one in parts for name in one.subjects),
    )


def both_sides(group: str) -> tuple[str, ...]:
    """Return a group's names: both sides of a joint."""
    return (group, group.replace("left_", "right_")) if group.startswith("left_") else (group,)


def of_people(people: People) -> dict[str, Figure]:
    """Return the row of real people. Their joints have no visibility, because a tracker does not give it."""
    errors_mm = np.linalg.norm(people.apart_mm, axis=-1)
    found = row(JointErrors(errors_mm, np.full(errors_mm.shape, VISIBLE, np.uint8), people.subjects))
    return {name: figure for name, figure in found.items() if not name.startswith(VISIBILITIES)}


def row(found: JointErrors) -> dict[str, Figure]:
    """Return the scores of joints inside the image, and the mean errors by visibility."""
    by = {f"{seen}, mm": scores(found, (seen,))["error, mm"] for seen in ("visible", "hidden", "outside")}
    return scores(found, (INSIDE,)) | by


def scores(found: JointErrors, groups: tuple[str, ...]) -> dict[str, Figure]:
    """Return the scores of the joints of some of ``GROUPS`` together, with intervals over people."""
    counts = found.counts()[:, [GROUPS.index(group) for group in groups]].sum(axis=1)
    sums = intervals.cluster_sums(counts, intervals.clusters_of(found.subjects))
    several, estimated = len(set(found.subjects)) > 1, estimates(sums)

    def figure(name: str) -> Figure:
        ends = map(float, estimated.ci95[name]) if several else (math.nan, math.nan)
        without = without_each(sums, partial(_score, name)) if several else ()
        return Figure(float(estimated.scores[name]), *ends, without)

    images = int((counts[:, 0] > 0).sum())
    shares = {column: figure(name) for column, name in SHARES.items()}
    return {"images": Figure(images), "error, mm": figure("mpjpe_mm"), **shares}


def _score(name: str, counts: Int64) -> Float64:
    return scores_of_joints(counts)[name]
