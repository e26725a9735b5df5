"""Second look: labels and mask decided anew by a small network over the supervoxels of a read frame.

The first reading rests on rules for every suit and body. Its errors are much the same from person to person:
a hand on a thigh has no colour of its own, a blanket that covers the legs looks like cloth. The network,
trained on many such frames of the virtual rig, corrects these.
"""

from dataclasses import replace

import numpy as np

from annotate.array_types import Bool, Float64
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS
from annotate.person.clothed_mask import MOST_PERSON_ODDS, PatchClues, interpolated
from annotate.person.extract import PersonMask
from annotate.second_look.descriptors import descriptors, neighbour_pairs
from annotate.second_look.network import GraphNetwork
from annotate.segmentation.part_clues import SuitReading
from annotate.segmentation.segment import Segmentation, labelled
from annotate.suit.color_model import readable
from sensors.rig.nearest import Nearest

LEAST = 1e-4
"""Least probability of a class. Chosen by eye."""


def look_again(
    cloud: ThermalCloud, person: PersonMask, first: Segmentation, before: FrameLabels | None, engine: Engine
) -> tuple[Segmentation, PersonMask]:
    """Better labels and a better mask; the given ones where the suit was not read or no temperature is known.

    person, first: mask and labels of the first reading. before: labels of the previous frame.
    """
    reading, candidates = first.reading, person.candidates
    if reading is None or candidates is None:
        return first, person
    clues, groups = candidates.clues, candidates.clues.groups
    pairs = neighbour_pairs(groups.centroids_m(cloud.points_m[clues.compared]))
    rows = descriptors(cloud, person.mask, candidates, first, before)
    chance = GraphNetwork(**engine.weights.network)(rows, pairs, clues.patches.ids, groups.sizes)
    person_odds = np.log(1 - chance[:, 0] + LEAST) - np.log(chance[:, 0] + LEAST)
    person_odds = np.clip(person_odds, -MOST_PERSON_ODDS, MOST_PERSON_ODDS)
    mask = candidates.mask(interpolated(person_odds[groups.ids], clues.compared)) & ~person.others
    if not mask.any():
        return first, person
    belief = chance[:, 1:] / np.maximum(chance[:, 1:].sum(axis=1, keepdims=True), 1e-12)
    reread = _second_reading(cloud, mask, clues, belief, person_odds, reading)
    return labelled(cloud, reread, engine, first.notes), replace(person, mask=mask)


def _second_reading(
    cloud: ThermalCloud, mask: Bool, clues: PatchClues, belief: Float64, odds: Float64, first: SuitReading
) -> SuitReading:
    """Reading of the points of a mask (h, w) by the network's belief (G, 11) and log odds (G,)."""
    nearest = Nearest(cloud.points_m[clues.compared]).query(cloud.points_m[mask])[1]
    used, ids = np.unique(clues.groups.ids[nearest], return_inverse=True)
    renumbered = np.full(clues.groups.count, -1, np.int32)
    renumbered[used] = np.arange(len(used))
    edges = renumbered[clues.groups.edges]
    groups = Supervoxels(ids.astype(np.int32), len(used), edges[(edges >= 0).all(axis=1)])
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    evidence = np.zeros((len(rgb), len(BODY_PARTS)))
    evidence[usable] = first.model.evidence(rgb[usable])
    return SuitReading(first.suit, mask, groups, belief[used], odds[used], usable, evidence, first.model)
