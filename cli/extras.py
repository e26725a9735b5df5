"""Optional packages (extras): pip install 'annotate-cloud[NAME]'."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from sensors.errors import CloudError

COSTS = {
    "gui": "no windows (fix, live)",
    "synth": "no virtual rig (simulate, synth film, virtual devices), no datasets (synth generate)",
    "bodies": "no new bodies (synth bodies); the shipped ones work",
    "report": "no report page (report); evaluate and compare work",
    "rig": "no calibration (calibrate)",
    "clouds": "no clouds for Open3D (ThermalCloud.to_open3d)",
    "exchange": "no ROS 2 bags, LAS, LAZ or Parquet",
    "foxglove": "no stream for Foxglove (live --serve); export --format foxglove works",
    "train": "no training (train, train-labels, learn); predict works",
    "smp": "no training of networks from segmentation-models-pytorch (train --network smp)",
    "benchmark": "no ITOP (benchmark itop); benchmark joints works",
    "colour": "no labels by a colour network (label --by colour)",
    "cluster": "no work on several machines (synth generate, label, predict, evaluate with --scheduler)",
    "kinect": "no Azure Kinect as a device; its recordings can be imported",
    "realsense": "no RealSense cameras as devices; their recordings can be imported",
    "orbbec": "no Orbbec cameras as devices",
    "docs": "no documentation pages (make docs)",
}
"""Missing features by extra that is not installed."""


@contextmanager
def needing(*extras: str) -> Iterator[None]:
    """Return a context for imports of packages that belong to extras.

    Raises CloudError that names the extras if an import fails.
    """
    try:
        yield
    except ImportError as error:
        missing = error.name or str(error)
        raise CloudError(
            f"{missing} is not installed; pip install 'annotate-cloud[{','.join(extras)}]'"
        ) from error


def check_extra(extra: str, *modules: str) -> None:
    """Check that an extra's modules are installed, without importing them. Raises CloudError as
    ``needing``.
    """
    with needing(extra):
        for name in modules:
            if find_spec(name) is None:
                raise ModuleNotFoundError(name=name)


def check_window() -> None:
    """Check that a window can be shown. Raises CloudError where its libraries or a screen are missing."""
    check_extra("gui", "PySide6", "pyvista", "pyvistaqt")
    from annotate.gui.display import displays

    displays()
