"""A calibration's residuals as one picture: where and how far holes were missed, camera by camera."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sensors.calibrate.bundle import Adjusted
from sensors.files.atomic import replacing

LONGER = {"depth": 200, "color": 400, "thermal": 60}
"""How much longer than true the arrows are drawn."""


def plot_residuals(path: Path, found: Adjusted) -> None:
    """Write a PNG: above the residuals as arrows in each image, below their size by view."""
    figure = Figure(figsize=(5 * len(found.residuals), 7), layout="constrained")
    axes = figure.subplots(2, len(found.residuals), squeeze=False)
    for column, (name, seen) in enumerate(found.residuals.items()):
        camera = getattr(found.calibration, name)
        image, bars = axes[0, column], axes[1, column]
        image.quiver(
            *seen.px.T,
            *(LONGER[name] * seen.error_px).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.002,
            color="#1f6f8b",
        )
        image.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
        image.set_title(f"{name}: {seen.rms_px:.3f} px rms, arrows {LONGER[name]} times longer")
        views = np.unique(seen.view)
        square = np.square(seen.error_px).sum(axis=1)
        rms = [float(np.sqrt(square[seen.view == view].mean())) for view in views]
        bars.bar(views, rms, color="#1f6f8b")
        bars.set(xlabel="frame", ylabel="rms, px")
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)
