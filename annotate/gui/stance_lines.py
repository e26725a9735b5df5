"""The joints and bones of a person within the cloud."""

import numpy as np
import pyvista as pv
from pyvistaqt import QtInteractor

from annotate.live.live_frame import Stance

WIDTH_PX = 4.0
"""Width of a bone in logical pixels. Chosen by eye."""
NEARER = 0.9
"""Share of its distance at which a joint is drawn, so that it lies before the surface: 20 cm at 2 m, more
than the deepest joint lies in a body. Chosen by eye."""


class StanceLines:
    """One VTK actor of lines, drawn before the body that they lie in."""

    def __init__(self, plotter: QtInteractor) -> None:
        self.actor = plotter.add_mesh(
            pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1]),
            color="white",
            line_width=WIDTH_PX,
            lighting=False,
            render=False,
        )
        self.actor.SetVisibility(False)

    def show(self, stance: Stance | None) -> None:
        """Show how the person is now, or nobody."""
        self.actor.SetVisibility(stance is not None)
        if stance is not None:
            lines = np.array([(2, a, b) for a, b in stance.bones]).ravel()
            self.actor.mapper.dataset = pv.PolyData(NEARER * stance.joints_m, lines=lines)
