"""Track ids of people who walk past one another: ``python -m tools.tracks.crossings SEED [RECORDINGS]``.

SEED: of the recordings (`eval.training.rooms.walkers`). RECORDINGS: number, default 20. ``--cast judge``
draws the judging cast. Crossing: two people change their order from left to right. The id of each is kept if
it is the same, most of the time, in the second before and in the two seconds after. Return: a person is found
again after 0.3 to 2 seconds; the id is kept if it is the same. Flash, phantom: false detections of one frame,
and of more.
"""

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from annotate.array_types import Bool, Float64, Int64, UInt8
from annotate.cloud.coarse import CoarseCloud, CoarseFuser
from annotate.frame_labels import FrameLabels
from annotate.person.extract import PersonDetection
from eval.training.rooms.scenes import Scene
from eval.training.rooms.walkers import FRAMES_PER_SECOND, walking_scenes
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from synth.data_files import CASTS, TRAINING, Cast
from tools.figures.pages import markdown
from tools.measure.crowds import matched

BEFORE, AFTER = FRAMES_PER_SECOND, 2 * FRAMES_PER_SECOND  # frames compared about a crossing
SHORTEST_GAP = 3  # frames without a person before a return
COLUMNS = (
    "people",
    "found",
    "crossings",
    "kept",
    "returns",
    "kept again",
    "ids a person",
    "flashes",
    "phantoms",
)


@dataclass
class Paths:
    """People of a recording by frame (F, N): column in the image, NaN = out of view; id, 0 = not found.

    counted: flags (F, N) of people whom `tools.measure.crowds` counts. false_ids: frames of each false id.
    """

    columns: Float64
    ids: Int64
    counted: Bool
    false_ids: Counter[int] = field(default_factory=Counter)


def followed(scenes: Iterable[Scene]) -> Iterator[UInt8]:
    """Yield the persons (h, w) by track id of each frame of a recording, from depth alone."""
    before = None
    for index, scene in enumerate(scenes):
        frame = RigFrame(index, round(index * 1e9 / FRAMES_PER_SECOND), scene.depth_mm)
        cloud: CoarseCloud = CoarseFuser(RigCalibration(scene.camera)).fuse_frame(frame)
        found = PersonDetection(cloud, everybody=True).person(before)
        notes = {"people": found.tracks.note()} if found.tracks else {}
        nothing = np.zeros(cloud.depth_mm.shape, np.uint8)
        before = FrameLabels("", cloud.depth_mm, nothing, notes=notes, persons=found.persons)
        yield found.persons


def paths_of(scenes: list[Scene], found: Iterable[UInt8]) -> Paths:
    """Return the paths of a recording. found: persons (h, w) of each frame by id."""
    shape = len(scenes), len(scenes[0].whole_px)
    paths = Paths(np.full(shape, np.nan), np.zeros(shape, np.int64), np.zeros(shape, np.bool_))
    for f, (scene, persons) in enumerate(zip(scenes, found, strict=True)):
        matches, phantoms = matched(scene, persons)
        paths.false_ids.update(phantoms)
        for i in range(shape[1]):
            u = np.nonzero(scene.persons == i + 1)[1]
            paths.columns[f, i] = u.mean() if len(u) else np.nan
        for number, match in matches.items():
            paths.counted[f, number - 1] = True
            paths.ids[f, number - 1] = match.detection if match.is_found else 0
    return paths


def tally(paths: Paths) -> Counter[str]:
    """Return the counts of a recording by ``COLUMNS``; ids and people counted are sums."""
    counts = Counter(
        people=paths.ids.shape[1], seen=int(paths.counted.sum()), found=int((paths.ids > 0).sum())
    )
    for f, i in crossings(paths.columns):
        before, after = paths.ids[max(f - BEFORE, 0) : f, i], paths.ids[f : f + AFTER, i]
        if before.any() and paths.counted[f : f + AFTER, i].any():
            counts += Counter(crossings=1, kept=int(_usual(before) == _usual(after)))
    for ids in paths.ids.T:
        at = np.flatnonzero(ids)
        gaps = np.diff(at)
        back = np.flatnonzero((gaps > SHORTEST_GAP) & (gaps <= AFTER))
        counts += Counter(returns=len(back), again=int((ids[at[back]] == ids[at[back + 1]]).sum()))
        counts += Counter(ids=len(np.unique(ids[at])), met=int(len(at) > 0))
    lives = paths.false_ids.values()
    return counts + Counter(flashes=sum(n == 1 for n in lives), phantoms=sum(n > 1 for n in lives))


def crossings(columns: Float64) -> list[tuple[int, int]]:
    """Return frame and person of each crossing. columns: (F, N), NaN = out of view."""
    frames = np.arange(len(columns))
    places = np.full(columns.shape, np.nan)
    for i, column in enumerate(columns.T):
        at = np.flatnonzero(np.isfinite(column))
        if len(at):
            places[at[0] : at[-1] + 1, i] = np.interp(frames[at[0] : at[-1] + 1], at, column[at])
    found = []
    for i, j in combinations(range(columns.shape[1]), 2):
        both, right = np.isfinite(places[:, i] + places[:, j]), places[:, i] > places[:, j]
        crossed = (right[1:] != right[:-1]) & both[1:] & both[:-1]
        found += [(int(f) + 1, k) for f in np.flatnonzero(crossed) for k in (i, j)]
    return found


def _usual(ids: Int64) -> int:
    """Return the most frequent id, 0 without any."""
    return int(np.bincount(ids[ids > 0]).argmax()) if ids.any() else 0


def row(counts: Counter[str]) -> list[str]:
    """Return the cells of ``COLUMNS``."""
    return [
        str(counts["people"]),
        f"{counts['found'] / max(counts['seen'], 1):.3f}",
        str(counts["crossings"]),
        f"{counts['kept'] / max(counts['crossings'], 1):.3f}",
        str(counts["returns"]),
        f"{counts['again'] / max(counts['returns'], 1):.3f}",
        f"{counts['ids'] / max(counts['met'], 1):.2f}",
        str(counts["flashes"]),
        str(counts["phantoms"]),
    ]


def measure(seed: int, recordings: int, cast: Cast = TRAINING) -> Counter[str]:
    """Return the counts of recordings."""
    counts: Counter[str] = Counter()
    for number in range(recordings):
        scenes = list(walking_scenes(seed + number, cast))
        counts += tally(paths_of(scenes, followed(scenes)))
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed", type=int)
    parser.add_argument("recordings", type=int, nargs="?", default=20, help="8 seconds each")
    parser.add_argument("--cast", choices=CASTS, default=TRAINING)
    options = parser.parse_args()
    print(markdown(COLUMNS, [row(measure(options.seed, options.recordings, options.cast))]))


if __name__ == "__main__":
    main()
