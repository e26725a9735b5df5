"""Small recordings of markers: C3D, TRC and BVH."""

import warnings
from pathlib import Path

import c3d
import numpy as np

NAMES = tuple(
    f"Anna:{name}" for name in ("LASI", "RASI", "LPSI", "RPSI", "LKNE", "RKNE", "LANK", "RANK", "C7", "CLAV")
)


def positions(frames: int = 5) -> np.ndarray:
    rng = np.random.default_rng(3)
    result = rng.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 1.5], (frames, len(NAMES), 3))
    result[1, 2] = np.nan
    return result


def write_trc(path: Path, points: np.ndarray, unit: str = "m", frames: int | None = None) -> None:
    markers = points.shape[1]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"100\t100\t{frames or len(points)}\t{markers}\t{unit}\t100\t0\t{len(points)}",
        "Frame#\tTime\t" + "\t\t\t".join(NAMES[:markers]) + "\t\t",
        "\t\t" + "\t".join(f"{a}{m + 1}" for m in range(markers) for a in "XYZ"),
        "",
    ]
    for f, row in enumerate(points):
        cells = ["" if np.isnan(v) else f"{v:.6f}" for v in row.ravel()]
        lines.append(f"{f + 1}\t{f / 100}\t" + "\t".join(cells))
    path.write_text("\n".join(lines) + "\n")


def write_c3d(path: Path, points: np.ndarray) -> None:
    writer = c3d.Writer(point_rate=100, point_scale=-1.0, point_units="mm ")
    for row in points:
        frame = np.zeros((len(row), 5), np.float32)
        seen = np.isfinite(row).all(axis=1)
        frame[seen, :3] = 1000 * row[seen]
        frame[~seen, 3:] = -1
        writer.add_frames([(frame, np.zeros((0, 1)))])
    writer.set_point_labels(list(NAMES[: points.shape[1]]))
    with path.open("wb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        writer.write(file)
