"""People of random crowded rooms that the finder detects: ``python -m tools.measure.crowds SEED [ROOMS]``.

SEED: of the rooms. ROOMS: 10 each, default 20. ``--cast judge`` draws the judging cast. A person counts with
30 % of the silhouette in view and a height or width of more than 60 pixels. The person is found if one
detection covers most of these pixels and shows no other person more. Joined: that detection shows another
person more. Split: a second detection has a tenth of the person or more. Phantom: a detection with less than
a fifth of its pixels on people.
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from annotate.array_types import UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.extract import PersonDetection
from eval.training.rooms.scenes import Scene, room_scenes
from sensors.rig.rig_calibration import RigCalibration
from synth.data_files import CASTS, TRAINING, Cast
from tools.figures.pages import markdown

LEAST_IN_VIEW, LEAST_PX = 0.3, 60
COVERS, SECOND, ON_PEOPLE = 0.5, 0.1, 0.2  # shares of a person; share of a detection
COLUMNS = (
    "images",
    "people",
    "found",
    "joined",
    "split",
    "phantoms an image",
    "empty images",
    "with phantoms",
)


def detected(scene: Scene) -> UInt8:
    """Return the detected persons (h, w) of a scene, 0 = none, without temperatures."""
    cloud = Fuser(RigCalibration(scene.camera)).fuse(scene.depth_mm)
    return PersonDetection(CoarseCloud.of(cloud), everybody=True).person().persons


class Match(NamedTuple):
    """Detection of a person: its number, 0 = none covers the person; whether it shows another person more;
    whether a second one has a share of the person.
    """

    detection: int
    is_joined: bool = False
    is_split: bool = False

    @property
    def is_found(self) -> bool:
        return self.detection > 0 and not self.is_joined


def matched(scene: Scene, found: UInt8) -> tuple[dict[int, Match], list[int]]:
    """Return the match of each person of a scene who counts, and the numbers of phantoms.

    found: detected persons (h, w), 0 = none.
    """
    shared = np.zeros((int(scene.persons.max()) + 1, int(found.max()) + 1), np.int64)
    np.add.at(shared, (scene.persons, found), 1)
    mine = shared[1:, 1:]
    detected_px = shared[:, 1:].sum(axis=0)
    phantoms = np.flatnonzero((mine.sum(axis=0) < ON_PEOPLE * detected_px) & (detected_px > 0)) + 1
    matches = {}
    for number, pixels in enumerate(shared[1:].sum(axis=1), start=1):
        if _counts(scene, number, int(pixels)):
            own = mine[number - 1] / pixels
            best = int(own.argmax()) if own.size else 0
            covered = own.size and own[best] >= COVERS
            is_joined = bool(covered and mine[:, best].argmax() != number - 1)
            matches[number] = Match(best + 1 if covered else 0, is_joined, int((own >= SECOND).sum()) > 1)
    return matches, phantoms.tolist()


def tally(scene: Scene, found: UInt8) -> Counter[str]:
    """Return the counts of a scene with detected persons (h, w)."""
    matches, phantoms = matched(scene, found)
    counts = Counter(images=1, phantoms=len(phantoms))
    if not scene.persons.any():
        return counts + Counter(empty=1, haunted=int(bool(phantoms)))
    for match in matches.values():
        counts += Counter(
            people=1, found=int(match.is_found), joined=int(match.is_joined), split=int(match.is_split)
        )
    return counts


def _counts(scene: Scene, number: int, pixels: int) -> bool:
    if pixels < LEAST_IN_VIEW * scene.whole_px[number - 1]:
        return False
    *_, width, height = cv2.boundingRect((scene.persons == number).astype(np.uint8))
    return max(width, height) > LEAST_PX


def measure(seed: int, rooms: int, cast: Cast = TRAINING) -> dict[str, Counter[str]]:
    """Return the counts by sensor and of all images."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for scene in _scenes(seed, rooms, cast):
        one = tally(scene, detected(scene))
        counts[scene.sensor] += one
        counts["all"] += one
    return counts


def _scenes(seed: int, rooms: int, cast: Cast) -> Iterator[Scene]:
    for number in range(rooms):
        yield from room_scenes(seed + number, cast)


def row(counts: Counter[str]) -> list[str]:
    """Return the cells of ``COLUMNS``."""
    shares = [f"{counts[name] / max(counts['people'], 1):.3f}" for name in ("found", "joined", "split")]
    phantoms = f"{counts['phantoms'] / max(counts['images'], 1):.3f}"
    return [
        *(str(counts[name]) for name in ("images", "people")),
        *shares,
        phantoms,
        *(str(counts[name]) for name in ("empty", "haunted")),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed", type=int)
    parser.add_argument("rooms", type=int, nargs="?", default=20, help="times 10 images")
    parser.add_argument("--cast", choices=CASTS, default=TRAINING)
    options = parser.parse_args()
    counts = measure(options.seed, options.rooms, options.cast)
    print(markdown(["", *COLUMNS], [[name, *row(one)] for name, one in sorted(counts.items())]))


if __name__ == "__main__":
    main()
