"""Phantoms in rooms without people: ``python -m tools.finder.empty_rooms SEED [FRAMES]``.

SEED: of the rooms. FRAMES: for each kind of room and sensor, default 100. ``--cast judge`` draws the judging
cast's furniture. Close rooms have walls and things within a metre or so of a low camera. A phantom is a
person that `detected` finds in a single frame.
"""

import argparse
from functools import partial
from itertools import product

import numpy as np

from annotate.array_types import Int64
from eval.training.rooms.empty_rooms import ROOMS, empty_rooms
from synth.cameras.random_sensor import KINDS
from synth.data_files import CASTS, TRAINING, Cast
from synth.images.workers import processes
from tools.figures.pages import markdown
from tools.measure.crowds import detected

COLUMNS = ("room", "sensor", "frames", "with phantoms", "phantoms per 1,000 frames", "standard error")


def phantoms(seed: int, frames: int, cast: Cast, kind_and_sensor: tuple[str, str]) -> Int64:
    """Return the number of phantoms of each frame (n,)."""
    scenes = zip(range(frames), empty_rooms(*kind_and_sensor, seed, cast), strict=False)
    found = [np.unique(persons[persons > 0]).size for persons in (detected(scene) for _, scene in scenes)]
    return np.array(found, np.int64)


def row(room_kind: str, sensor: str, counts: Int64) -> list[str]:
    """Return the cells of ``COLUMNS`` for the phantoms of frames (n,)."""
    per_thousand = (1000 * counts.mean(), 1000 * counts.std() / np.sqrt(len(counts)))
    whole = (len(counts), np.count_nonzero(counts), *per_thousand)
    return [room_kind, sensor, *(f"{value:.0f}" for value in whole)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed", type=int)
    parser.add_argument("frames", type=int, nargs="?", default=100)
    parser.add_argument("--cast", choices=CASTS, default=TRAINING)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args()
    pairs = list(product(ROOMS, KINDS))
    with processes(options.workers) as pool:
        work = partial(phantoms, options.seed, options.frames, options.cast)
        counts = dict(zip(pairs, pool.executor.map(work, pairs), strict=True))
    rows = [row(*pair, found) for pair, found in counts.items()]
    rows += [row(kind, "all", np.concatenate([counts[kind, sensor] for sensor in KINDS])) for kind in ROOMS]
    print(markdown(list(COLUMNS), rows))


if __name__ == "__main__":
    main()
