"""HTML page of a dataset: sample images as in the paper's Figs. 4 and 13, and statistics."""

import base64
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from numpy.typing import NDArray

from annotate.array_types import Float64, Int64, UInt8
from annotate.crop import SIZE, normalize
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import Dataset, read_shard
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from sensors.files.atomic import write_bytes
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.images.comparison import charts, profile, ranges
from synth.images.distributions import Distributions, figures_of_labels

PAGE = "index.html"
SHEET_COLUMNS, SHEET_ROWS = 8, 3
COUNTED_SHARDS = 4  # a thousand images, evenly spread, suffice for statistics
DOTS = 150  # frames whose joints are drawn
DRAWN = {
    "head": Region.HEAD,
    "left_wrist": Region.LEFT_FOREARM,
    "right_wrist": Region.RIGHT_FOREARM,
    "left_knee": Region.LEFT_UPPER_LEG,
    "right_knee": Region.RIGHT_UPPER_LEG,
    "left_ankle": Region.LEFT_LOWER_LEG,
    "right_ankle": Region.RIGHT_LOWER_LEG,
}
"""Drawn joints, and the regions whose part gives the colour."""
DEPTH_EDGES_MM = np.arange(500, 4501, 100)
AZIMUTH_EDGES_DEG = np.arange(-180, 181, 15)
HEIGHT_EDGES_M = np.arange(0.0, 3.01, 0.1)
_PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


@dataclass(frozen=True)
class Statistics:
    """Statistics of some frames; arrays by part id of the scheme, [0] for the background or the whole person.

    pixels: of each part. shown: share of frames that show the part. depth: histogram of the person's pixels
    over DEPTH_EDGES_MM. visible: mean share not hidden by furniture or occluders, nor cut by holes in the
    person's mask; only [0] for a converted dataset. azimuth, height: histograms of frames over the camera's
    azimuth (AZIMUTH_EDGES_DEG) and height (HEIGHT_EDGES_M). joints_mm: (n, J, 3), camera frame, relative to
    the pelvis. activities, sensors, clothes: number of frames by name, most frequent first. occluded, cut:
    share of frames with occluders, and with holes in the mask.
    """

    frames: int
    pixels: Int64
    shown: Float64
    depth: Int64
    visible: Float64
    azimuth: Int64
    height: Int64
    joints_mm: Float64
    activities: dict[str, int]
    sensors: dict[str, int]
    clothes: dict[str, int]
    occluded: float
    cut: float
    people: Distributions

    @property
    def spread_mm(self) -> Float64:
        """Return the RMS distance (J,) of every joint from its mean position relative to the pelvis."""
        away = self.joints_mm - self.joints_mm.mean(axis=0)
        return np.asarray(np.sqrt(np.square(away).sum(axis=2).mean(axis=0)))


def write_page(dataset: Dataset, beside: Distributions | None = None) -> None:
    """Write ``index.html`` into the dataset's folder; beside: distributions of real people."""
    write_bytes(dataset.path / PAGE, render(dataset, beside).encode())


def render(dataset: Dataset, beside: Distributions | None = None) -> str:
    """Return the page as HTML. Raises FormatError for a corrupt shard."""
    scheme, step = dataset.scheme, max(1, len(dataset.shards) // COUNTED_SHARDS)
    paths = [dataset.path / name for name, _ in dataset.shards[::step][:COUNTED_SHARDS]]
    frames = (frame for path in paths for frame in read_shard(path, scheme=scheme))
    statistics = statistics_of(frames, scheme)
    step = max(1, statistics.frames // (len(paths) * SHEET_COLUMNS * SHEET_ROWS))
    first = read_shard(paths[0], scheme=scheme)
    sheet = contact_sheet(list(islice(first, 0, step * SHEET_COLUMNS * SHEET_ROWS, step)))
    rgb = scheme.palette_rgb()
    return _PAGES.get_template("dataset.html.j2").render(
        info=dataset.info,
        bytes=sum((dataset.path / name).stat().st_size for name, _ in dataset.shards),
        shards=len(dataset.shards),
        sheet=_data_uri(sheet),
        sheet_size=sheet.shape[1::-1],
        statistics=statistics,
        parts=scheme.parts,
        counted=_counted_parts(scheme),
        person=max(1, int(statistics.pixels[1:].sum())),
        depth=_bars(statistics.depth, DEPTH_EDGES_MM / 1000),
        azimuth=_bars(statistics.azimuth, AZIMUTH_EDGES_DEG),
        height=_bars(statistics.height, HEIGHT_EDGES_M),
        beside=beside,
        ranges=ranges(statistics.people, beside),
        profile=profile(statistics.people, beside),
        charts=charts(statistics.people, beside),
        dots=[
            (rgb[scheme.table[region]].tolist(), statistics.joints_mm[:DOTS, JOINT_ID[name]].tolist())
            for name, region in DRAWN.items()
        ],
        spread=list(zip(JOINT_ID, statistics.spread_mm.tolist(), strict=True))[1:],
    )


def _counted_parts(scheme: Scheme) -> str:
    """Return the number of parts, and the scheme's name unless it is the default."""
    body = sum(not part.is_free for part in scheme.parts)
    return f"{body} body parts" + ("" if scheme == PAPER else f" of scheme {scheme.name}")


def contact_sheet(frames: list[FrameLabels]) -> UInt8:
    """Return an RGB image (h, w, 3) of labels above their depth, near bright, as the paper's Fig. 4."""
    pairs = [np.vstack([frame.scheme.palette_rgb()[frame.parts], _grey(frame)]) for frame in frames]
    blank = np.zeros((2 * SIZE, SIZE, 3), np.uint8)
    pairs += [blank] * (-len(pairs) % SHEET_COLUMNS)
    rows = [np.hstack(pairs[i : i + SHEET_COLUMNS]) for i in range(0, len(pairs), SHEET_COLUMNS)]
    return np.vstack(rows)


def _grey(frame: FrameLabels) -> UInt8:
    depth = normalize(frame.depth_mm, frame.parts > 0)
    seen = depth > 0
    near, far = np.percentile(depth[seen], (1, 99)) if seen.any() else (0.0, 1.0)
    bright = 240 - 190 * np.clip((depth - near) / max(far - near, 0.05), 0, 1)
    return np.repeat(np.where(seen, bright, 0).astype(np.uint8)[..., None], 3, axis=2)


def _data_uri(image: UInt8) -> str:
    _, data = cv2.imencode(".webp", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_WEBP_QUALITY, 85])
    return f"data:image/webp;base64,{base64.b64encode(data.tobytes()).decode()}"


def _bars(counts: Int64, edges: NDArray[Any]) -> list[tuple[float, float, float]]:
    filled = np.flatnonzero(counts)
    first, last = (int(filled[0]), int(filled[-1])) if filled.size else (0, 0)
    top = max(1, int(counts.max()))
    return [(float(edges[i]), float(edges[i + 1]), counts[i] / top) for i in range(first, last + 1)]


def statistics_of(frames: Iterable[FrameLabels], scheme: Scheme = PAPER) -> Statistics:
    """Return the statistics of generated frames, at least one, with the notes of ``presets.sample``."""
    n_classes = scheme.n_classes
    pixels, shown = np.zeros(n_classes, np.int64), np.zeros(n_classes, np.int64)
    depth = np.zeros(len(DEPTH_EDGES_MM) - 1, np.int64)
    notes, persons = [], []
    for frame in frames:
        in_part = np.bincount(frame.parts.ravel(), minlength=n_classes)[:n_classes]
        pixels += in_part
        shown += in_part > 0
        depth += np.histogram(frame.depth_mm[frame.parts > 0], DEPTH_EDGES_MM)[0]
        notes.append(frame.notes)
        persons.append(figures_of_labels(frame))
    joints = np.array([n["joints_mm"] for n in notes], np.float64).reshape(-1, N_JOINTS, 3)
    return Statistics(
        len(notes),
        pixels,
        shown / len(notes),
        depth,
        np.array([n["visible"] for n in notes]).mean(axis=0),
        np.histogram([n["camera"]["azimuth_deg"] for n in notes], AZIMUTH_EDGES_DEG)[0],
        np.histogram([n["camera"]["height_m"] for n in notes], HEIGHT_EDGES_M)[0],
        joints - joints[:, JOINT_ID["pelvis"], None],
        _counted(n["activity"] for n in notes),
        _counted(f"{n['sensor']['kind']}, {n['sensor']['model']}" for n in notes if "sensor" in n),
        _counted(worn for n in notes for worn in n.get("clothes", ())),
        float(np.mean([n["occluders"] > 0 for n in notes])),
        float(np.mean([n["cut"] > 0 for n in notes])),
        Distributions.of("dataset", persons),
    )


def _counted(names: Iterable[str]) -> dict[str, int]:
    return dict(Counter(names).most_common())
