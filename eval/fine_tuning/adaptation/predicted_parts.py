"""Parts that ``predict`` gives images of recordings, refined by the room or not."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from annotate.array_types import Int64
from annotate.frame_labels import FrameLabels
from annotate.person.planes import Plane
from annotate.scheme.scheme import Scheme
from eval.fine_tuning.adaptation.labelled_people import PersonImage
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import Networks, PredictOptions, fits
from eval.network.refine import planes_in, shipped_refinement_network
from eval.scores.confusion import confusion_matrix


def refinable(network: OnnxNetwork, scheme: Scheme) -> bool:
    """Return True if ``predict`` can refine a network's labels of a scheme by the room."""
    return fits(_options(scheme, again=True), network)


def predicted_parts(
    networks: Sequence[OnnxNetwork],
    images: Iterable[PersonImage],
    scheme: Scheme,
    advance: Callable[[int], None],
) -> Int64:
    """Return the confusion of the parts (2, s, n, k, k): unrefined and refined, by network, by image.

    advance: called with the number of labelled images.
    """
    chains = [[_options(scheme, again).chained(one) for one in networks] for again in (False, True)]
    found = []
    for image in images:
        planes = planes_in(image.camera, image.depth_mm)
        found.append([[_confusion(one, image, planes) for one in each] for each in chains])
        advance(len(networks))
    return np.moveaxis(np.array(found), 0, 2)


def _options(scheme: Scheme, again: bool) -> PredictOptions:
    return PredictOptions(room_refiner=shipped_refinement_network() if again else None, scheme=scheme)


def _confusion(networks: Networks, image: PersonImage, planes: tuple[Plane, ...]) -> Int64:
    """Return the confusion (k, k) of the labels that networks give an image."""
    seen = networks.first.segment(image.depth_mm, image.mask)
    first = FrameLabels("", image.depth_mm, seen.parts, seen.confidence, scheme=seen.scheme)
    found = networks.refined_by_room(image.camera, first, image.mask, planes)
    return confusion_matrix(image.parts, found.parts, networks.scheme)
