"""The parts of the package that are installed on demand: pip install 'annotate-cloud[NAME]'."""

from collections.abc import Iterator
from contextlib import contextmanager

from sensors.errors import CloudError

COSTS = {
    "gui": "no correction window (fix)",
    "synth": "no virtual rig (simulate, virtual devices), no datasets (synth generate), no markers (solve)",
    "bodies": "no bodies of your own (synth bodies); the shipped ones work",
    "network": "no labels from a network (predict)",
    "report": "no intervals and no report (evaluate, compare, report); diff works",
    "rig": "no calibrating (calibrate) and no learning of palettes (suit learn)",
    "clouds": "no PCD and PLY clouds",
    "exchange": "no ROS 2 bags, LAS, LAZ or Parquet",
    "train": "no training (train); predict needs network only",
    "smp": "no training of other people's architectures (train --network smp)",
    "cluster": "no generating on several machines (synth generate --scheduler)",
    "kinect": "no Azure Kinect as a device; its recordings can be imported",
    "orbbec": "no Orbbec cameras as devices",
    "v4l2": "an Optris camera without the kernel's frame numbers",
    "docs": "no building of these pages (make docs)",
}
"""Every extra, and what does not work without it."""


@contextmanager
def needing(*extras: str) -> Iterator[None]:
    """Around imports that these extras bring. Raises CloudError naming them where one is absent."""
    try:
        yield
    except ImportError as error:
        missing = error.name or str(error)
        raise CloudError(
            f"{missing} is not installed; pip install 'annotate-cloud[{','.join(extras)}]'"
        ) from error
