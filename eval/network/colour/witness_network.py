"""Witness network: corrects a witnessed person's outline and parts by the shape of body and room.

It has the suit network's architecture and channels. The logarithms of the fused probabilities replace the
likelihoods of colours, and the depth network's parts replace the previous frame's. Colour and temperature
are left out.
"""

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import PAPER
from annotate.scheme.regions import N_REGIONS
from annotate.segmentation.input_channels import Rectangle, with_evidence
from annotate.segmentation.segment import SAMPLE_M, View
from annotate.segmentation.suit_network import SuitNetwork, flip_averaged, other_person
from annotate.witness.fusion import in_scheme
from eval.network.colour.witnessed_body import WitnessedBody
from eval.network.refine import depth_view

SHIPPED_WITNESS_NETWORK = Path(str(files("annotate").joinpath("witness", "witness_network.onnx")))
"""Made by ``python -m tools.fit.witness_network``."""
TRUST, FIRST = np.float32(0.8), np.float32(0.3)
"""Exponents of the network's and the fused probabilities in their product: likeliest on 64 frames of
held-out rig recordings, half of them with errors of twice the measured size."""
LEAST = np.float32(1e-6)  # of a probability before its logarithm


class Corrected(NamedTuple):
    """Person's pixels (h, w), n in all, and the probabilities of their regions (24, n)."""

    mask: Bool
    regions: Float32


@cache
def shipped_witness_network() -> SuitNetwork:
    """Return the witness network that ships with the package."""
    return SuitNetwork(SHIPPED_WITNESS_NETWORK)


def witness_view(cloud: ThermalCloud, body: WitnessedBody) -> View | None:
    """Return the network's input around a person; None without any."""
    mask, first = body.mask, np.zeros(body.mask.shape, np.uint8)
    first[body.wide] = body.by_depth
    found = depth_view(FrameLabels("", cloud.depth_mm, np.where(mask, first, np.uint8(0))), cloud.camera)
    if found is None:
        return None
    view = found[1]
    chance = in_scheme(body.regions, PAPER)[1:]
    rows = np.zeros((len(chance), *mask.shape), np.float32)
    rows[:, body.wide] = np.log(np.maximum(chance, LEAST))
    return view._replace(planes=with_evidence(view.planes, rows[:, *view.where], mask[view.where]))


def corrected(cloud: ThermalCloud, body: WitnessedBody, sure: Bool, network: SuitNetwork) -> Corrected:
    """Return a witnessed person with outline and parts corrected by the network.

    sure: (h, w), pixels that stay the person's. Other pixels of ``body.wide`` are the person's where the
    parts are likelier together than background and other people. The probability of a part of ``paper`` is
    the product of the network's and the fused one, with exponents ``TRUST`` and ``FIRST``. The fused
    probabilities divide a part among its regions.
    """
    view, regions = witness_view(cloud, body), np.maximum(body.regions, LEAST)
    if view is None:
        return Corrected(body.mask, body.regions[:, body.mask[body.wide]])
    everywhere = Rectangle(*(slice(0, side) for side in view.planes.shape[1:]))
    found = np.zeros((other_person(PAPER) + 1, *body.mask.shape), np.float32)
    found[:, *view.where] = flip_averaged(network, view.planes, view.step(SAMPLE_M), everywhere)
    parts = found[PAPER.body_classes]
    own = body.wide & cloud.valid & (sure | (parts.sum(axis=0) > found[0] + found[other_person(PAPER)]))
    regions = regions[:, own[body.wide]]
    first = in_scheme(regions, PAPER)[1:]
    parts = np.maximum(parts[:, own], LEAST) ** TRUST * first**FIRST
    share = parts / parts.sum(axis=0) / first
    part = PAPER.class_table[PAPER.table[1 : N_REGIONS + 1]] - 1
    return Corrected(own, np.asarray(regions * share[part], np.float32))
