"""Make ``people.json`` of an RGB-D recording: ``python -m tools.measure.colour_people FOLDER [MODELS]``.

FOLDER: ``color/`` and ``depth/`` with the same names, colour registered to depth, camera upright. MODELS: the
wheel or a folder with MediaPipe's models; default: the user's cache (``annotate-cloud models colour``).
``--compare FILE`` prints the distance from another ``people.json`` and writes nothing.

The network never gets depth. A detector proposes a crop of each person, and a second network finds 33
landmarks in each crop. The crops of the next frame follow from the landmarks.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np

from annotate.array_types import Float64
from annotate.witness.blazepose import NAMES, BlazePose
from annotate.witness.person_crop import PersonCrop
from annotate.witness.pose_network import people_in
from sensors.errors import CalibrationError, CloudError, ExistsError, FormatError
from sensors.files.atomic import write_bytes
from sensors.files.natural_order import paths_in_order
from tools.measure.people_file import PEOPLE_FILE, read_people

SURE = 0.7  # least visibility of compared landmarks, as in the recordings' score.py
BODY = slice(11, len(NAMES))  # landmarks without the face
COLOURS = (".jpg", ".jpeg", ".png")
Landmarks: TypeAlias = dict[str, list[list[list[float]]]]
"""Landmarks (33, 3) of each person by image, as ``people.json`` holds them."""


def distance(a: Float64, b: Float64) -> float:
    """Return the median distance of two persons' landmarks (33, 3) in pixels."""
    return float(np.median(np.hypot(*(a - b)[:, :2].T)))


def make_people(folder: Path, network: BlazePose) -> Landmarks:
    """Return the landmarks of each frame's people.

    Raises FormatError for a missing image, CalibrationError for colour of another size than depth.
    """
    people: Landmarks = {}
    crops: list[PersonCrop] = []
    for depth in paths_in_order((folder / "depth").glob("*.png")):
        names = [folder / "color" / f"{depth.stem}{ending}" for ending in COLOURS]
        image = next((found for name in names if (found := cv2.imread(str(name))) is not None), None)
        if image is None:
            raise FormatError(f"{names[0].with_suffix('')} has no image; put colour beside each depth image")
        shape = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).shape[:2]
        if image.shape[:2] != shape:
            raise CalibrationError(f"{names[0].parent} has another size than depth; register colour to depth")
        found = people_in(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), network, crops)
        crops = [person.crop for person in found]
        people[depth.stem] = [
            [[round(u, 1), round(v, 1), round(sure, 3)] for u, v, sure in person.landmarks.tolist()]
            for person in found
        ]
    return people


def compare(made: Landmarks, given: Mapping[str, Sequence[Float64]]) -> str:
    """Return the distance of made landmarks from given visible ones as text."""
    off, body, found, extra = [], [], 0, 0
    for frame, persons in given.items():
        own = [np.array(person) for person in made.get(frame, [])]
        extra += max(0, len(own) - len(persons))
        for person in persons if own else ():
            nearest = min(own, key=lambda one: distance(one, person))
            px, sure = np.hypot(*(nearest - person)[:, :2].T), person[:, 2] >= SURE
            off.append(px[sure])
            body.append(px[BODY][sure[BODY]])
            found += 1
    lines = [f"people: {found} of {sum(map(len, given.values()))} found, {extra} more"]
    for name, parts in (("all landmarks", off), ("without the face", body)):
        px = np.concatenate([*parts, np.zeros(0)])
        lines.append(f"{name}: {len(px)}, median {np.median(px):.2f} px, within 5 px {np.mean(px <= 5):.3f}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("models", type=Path, nargs="?")
    parser.add_argument("--compare", type=Path, metavar="FILE")
    options = parser.parse_args()
    made = options.folder / PEOPLE_FILE
    try:
        if made.exists() and not options.compare:
            raise ExistsError(f"{made} already exists; move it away first")
        people = make_people(options.folder, BlazePose(options.models))
        if options.compare:
            print(compare(people, read_people(options.compare, people)))
            return
    except CloudError as error:
        parser.error(str(error))
    write_bytes(made, json.dumps(people).encode())
    print(f"{made}: {sum(map(len, people.values()))} people in {len(people)} frames")


if __name__ == "__main__":
    main()
