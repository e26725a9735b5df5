"""Published precision at 10 cm on ITOP's test images, per cent; all methods were trained on ITOP."""

from typing import NamedTuple

KINDS = ("head", "neck", "shoulder", "elbow", "hand", "torso", "hip", "knee", "foot")
"""Joints of the papers' tables, left and right averaged."""


class Published(NamedTuple):
    """Published precision of a method. side, top: means of the views; None = not published. joints: of the
    side view, by ``KINDS``.
    """

    method: str
    paper: str
    side: float | None
    top: float | None = None
    joints: tuple[float, ...] = ()


V2V = "Moon et al., CVPR 2018, arXiv:1711.07399, table of ITOP"
A2J = "Xiong et al., ICCV 2019, arXiv:1908.09999, table of ITOP"
PUBLISHED = (
    Published("SPiKE", "Ballester et al. 2024, arXiv:2409.01879, abstract", 89.2),
    Published("V2V-PoseNet", V2V, 88.7, 83.4, (98.3, 99.1, 97.2, 80.4, 67.3, 98.7, 93.2, 91.8, 87.6)),
    Published("A2J", A2J, 88.0, 80.5, (98.5, 99.2, 96.2, 78.9, 68.4, 98.5, 90.8, 90.7, 86.9)),
    Published("REN", f"Guo et al. 2017, in {V2V}", 84.9),
    Published("Viewpoint invariant", "Haque et al., ECCV 2016, arXiv:1603.07076, table of ITOP", 77.4),
    Published("Random forest", "Shotton et al. 2011, in Haque et al. 2016", 65.8),
)
"""The joints of A2J are computed from its published predictions."""
