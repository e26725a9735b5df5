"""Whether a dataset's people are as varied as real ones: ranges of figures, side by side.

    python -m tools.measure.people.variety DATASET [FRAMES] [--page]

FRAMES: a folder that `import` understands, persons cut out, with ``joints.json``: by image the places of 20
joints of a Kinect v1's tracker, ``uv`` in pixels and ``z_mm``. Default: ../shared/data/real_people/frames.
A row is inside when its 10th to 90th percentile over FRAMES lies within the dataset's 2nd to 98th.
--page: the dataset's page is drawn again with these figures. Tune the causes, never to a recording.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from annotate.array_types import Float64
from annotate.labelset.dataset import Dataset, read_shard
from sensors.importers.folder import ImageFolder
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.images.comparison import Range, profile, ranges
from synth.images.dataset_page import write_page
from synth.images.distributions import Distributions, figures_of, figures_of_labels

REAL = Path(__file__).resolve().parents[4] / "shared" / "data" / "real_people" / "frames"
TRACKED = (
    *("head", "neck", "spine_middle", "pelvis"),
    *(f"{side}_{kind}" for side in ("left", "right") for kind in ("shoulder", "elbow", "wrist", "hand")),
    *(f"{side}_{kind}" for side in ("left", "right") for kind in ("hip", "knee", "ankle", "foot")),
)
"""Joints of the tracker in its order, by the names of the skeleton where that has them."""


def joints_mm(entry: dict[str, list[float]], camera: Intrinsics) -> Float64:
    """Joints (J, 3) of the skeleton in the camera's frame, NaN where the tracker has none."""
    uv, z = np.array(entry["uv"]), np.array(entry["z_mm"])
    tracked = np.column_stack([(uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy) * z[:, None], z])
    joints = np.full((N_JOINTS, 3), np.nan)
    for name, place in zip(TRACKED, tracked, strict=True):
        if name in JOINT_ID:
            joints[JOINT_ID[name]] = place
    return joints


def real_people(folder: Path) -> Distributions:
    """Distributions of recorded people with the joints that a tracker gave."""
    source, entries = ImageFolder(folder), json.loads((folder / "joints.json").read_text())
    camera = source.calibration.depth
    # Both are in the order of the names.
    people = (
        figures_of(frame.depth_mm > 0, joints_mm(entries[name], camera))
        for frame, name in zip(source, sorted(entries), strict=True)
    )
    return Distributions.of(folder.resolve().name, people)


def dataset_people(dataset: Dataset) -> Distributions:
    """Distributions of all images of a dataset."""
    paths = [dataset.path / name for name, _ in dataset.shards]
    return Distributions.of(
        dataset.path.name, (figures_of_labels(frame) for path in paths for frame in read_shard(path))
    )


def line(row: Range) -> str:
    """A row of the table."""
    low, middle, high = (f"{value:.{row.figure.decimals}f}" for value in row.own)
    text = f"| {row.figure.title} | {row.figure.unit} | {low} | {middle} | {high} |"
    if row.real is None:
        return f"{text} | | | |"
    real = " | ".join(f"{value:.{row.figure.decimals}f}" for value in row.real)
    return f"{text} {real} | {'yes' if row.inside else '**no**'} |"


def main() -> None:
    """Print the table, as Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("frames", type=Path, nargs="?", default=REAL)
    parser.add_argument("--page", action="store_true")
    chosen = parser.parse_args()
    dataset, real = Dataset.open(chosen.dataset), real_people(chosen.frames)
    own = dataset_people(dataset)
    rows = ranges(own, real) + profile(own, real)
    print(f"{own.frames} images of {dataset.info['preset']}, {real.frames} real ones\n")
    print("| figure | unit | 2 % | 50 % | 98 % | real 10 % | 50 % | 90 % | inside |\n" + "|---" * 9 + "|")
    print("\n".join(map(line, rows)))
    if chosen.page:
        write_page(dataset, replace(real, name="real people"))


if __name__ == "__main__":
    main()
