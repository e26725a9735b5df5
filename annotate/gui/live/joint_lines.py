"""The joints and bones of a person within the cloud."""

import numpy as np
import pyvista as pv
from pyvistaqt import QtInteractor

from annotate.live.live_frame import BodyPose

WIDTH_PX = 4.0
"""Width of a bone in logical pixels. Untuned."""
IN_FRONT = -66_000.0
"""Offset of the lines' depth, in the depth buffer's least steps: before all else in 16 bits and more."""


class PoseLines:
    """One VTK actor of lines, drawn before the body that they lie in."""

    def __init__(self, plotter: QtInteractor) -> None:
        self.actor = plotter.add_mesh(
            pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1]),
            color="white",
            line_width=WIDTH_PX,
            lighting=False,
            render=False,
        )
        self.actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
        self.actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, IN_FRONT)
        self.actor.SetVisibility(False)

    def show(self, body_pose: BodyPose | None) -> None:
        """Show how the person is now, or nobody."""
        self.actor.SetVisibility(body_pose is not None)
        if body_pose is not None:
            lines = np.array([(2, a, b) for a, b in body_pose.bones]).ravel()
            self.actor.mapper.dataset = pv.PolyData(body_pose.joints_m, lines=lines)
