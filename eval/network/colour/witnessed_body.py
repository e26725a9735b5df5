"""Person by a depth network and a witness together."""

from dataclasses import dataclass

from annotate.array_types import Bool, Float32, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import nearest_seen, network_crop, normalize
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from annotate.witness.fusion import fused, head_by_depth, shipped_spreads
from annotate.witness.person_outline import Outline
from annotate.witness.skeleton import Skeleton
from eval.network.body_state import BodyState
from eval.network.onnx_network import OnnxNetwork


@dataclass(frozen=True, eq=False)
class WitnessedBody:
    """Person by depth and witness.

    mask: (h, w), the person's pixels. wide: (h, w), the mask and pixels beside it, n in all. regions: float32
    (24, n), fused probabilities. by_depth: uint8 (n,), parts of ``paper`` by depth alone. skeleton: of the
    witness, hidden joints by depth. state: by depth, of networks that give it.
    """

    mask: Bool
    wide: Bool
    regions: Float32
    by_depth: UInt8
    skeleton: Skeleton
    state: BodyState | None


def witnessed_body(cloud: ThermalCloud, outline: Outline, wide: Bool, network: OnnxNetwork) -> WitnessedBody:
    """Return a person by its outline and skeleton, also at the pixels of ``wide`` (h, w) beside the mask."""
    wide = wide | outline.mask
    planes, state = _by_depth(cloud, outline.mask, wide, network)
    points_m, own, skeleton = cloud.points_m[wide], network.own, outline.skeleton
    head = planes[own.class_table[own.table[Region.HEAD]]]
    inside = outline.mask[wide]
    skeleton = head_by_depth(skeleton, points_m[inside], head[inside])
    if state is not None:
        skeleton = skeleton.completed(state.joints_mm(cloud.camera) / 1000)
    parts = network.in_scheme(PAPER).merged(planes)[1:].argmax(axis=0)
    regions = fused(planes, own, points_m, skeleton, shipped_spreads())
    return WitnessedBody(outline.mask, wide, regions, PAPER.class_ids[parts + 1], skeleton, state)


def _by_depth(
    cloud: ThermalCloud, mask: Bool, wide: Bool, network: OnnxNetwork
) -> tuple[Float32, BodyState | None]:
    """Return the network's probabilities (k, n) at the pixels of ``wide`` (h, w), in its own scheme, and its
    state. A pixel beside the mask has the probabilities of the mask's nearest pixel.
    """
    crop = network_crop(mask)
    depth = normalize(crop.cut(cloud.depth_mm, 0), crop.cut(mask, False))
    planes, *body = network.outputs(depth[None])
    at = crop.paste(nearest_seen(depth > 0), (mask.shape[0], mask.shape[1]), 0)[wide]
    outputs, image = [one[0] for one in body], (cloud.depth_mm, mask)
    state = network.body_state(crop, image, outputs, planes[0], cloud.camera) if body else None
    return planes[0].reshape(len(planes[0]), -1)[:, at], state
