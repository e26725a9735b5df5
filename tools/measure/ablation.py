"""What each step of labelling gives: simulated sessions labelled without one step after the other.

python -m tools.measure.ablation SESSION.mcap...

Prints a Markdown table a session: scores without the step, and in brackets the 95 % interval of what they
lose by that (Student's t over the people, the same frames on both sides; `eval.compare.paired`).
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from annotate.engine import Engine, Steps
from annotate.label_source import label_source
from annotate.labelset.store import LabelSet
from annotate.person.pixel_odds import WINDOW_C
from annotate.suit.palette import load_suit
from eval.compare.compare import Comparison, compare_sets
from eval.compare.paired import difference
from eval.compare.results import Result
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

SHOWN = {
    "person_iou": ("person IoU", 1, 3),
    "mean_recall": ("mean recall", 1, 3),
    "boundary_f": ("boundary F, 2 px", 1, 3),
    "left_right_swap_rate": ("exchanged, %", 100, 2),
}
"""Scores shown: heading, factor, digits."""
ALL, WINDOW = "nothing: all steps", "the window found by itself (25 to 35 °C)"
WITHOUT = {
    "the second look": Steps(second_look=False),
    "islands given away": Steps(tidying=False),
    "colours fitted to the light": Steps(color_refit=False, joint_reading=False),
    "patches read as one body": Steps(joint_reading=False),
    "patches' second opinion": Steps(patch_belief=False),
    "supervoxels": Steps(supervoxels=False),
    "the part tree": Steps(part_tree=False),
    "warmth of bare skin": Steps(skin_warmth=False),
    "the sleeve that skin grows out of": Steps(sleeves=False),
    "parts of the frame before": Steps(frame_before=False),
    "refined borders": Steps(fine_borders=False),
    "the suit in finding the person": Steps(suit_for_person=False),
    "halves joined": Steps(join_halves=False),
    "planes of the room": Steps(room_planes=False),
    "colours of the room": Steps(room_colors=False),
}
"""The table's rows, and the steps that run in them."""


def labelled(path: Path, engine: Engine, window_c: tuple[float, float] | None = None) -> Comparison:
    """Labels of a simulated session against its truth."""
    with tempfile.TemporaryDirectory() as folder:
        suit = load_suit(suit_path(path))
        run = label_source(Session(path), suit, Path(folder) / "l", lambda n: None, window_c, engine)
        for frame_id, why in run.failed:
            print(f"frame {frame_id}: {why}", file=sys.stderr)
        return compare_sets(run.labels, LabelSet.open(truth_path(path)))


def row(name: str, whole: Comparison, without: Comparison) -> str:
    """A line of the table."""
    lost = difference(Result(ALL, whole), Result(name, without))
    cells = [name]
    for score, (_, factor, digits) in SHOWN.items():
        low, high = factor * lost.ci95[score]
        value = factor * without.scores[score]
        cells.append(f"{value:.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]")
    return f"| {' | '.join(cells)} |"


def measured(path: Path) -> Iterator[tuple[str, Comparison]]:
    """Name of a row and the scores in it, the whole engine's first."""
    yield ALL, labelled(path, Engine())
    for name, steps in WITHOUT.items():
        yield name, labelled(path, Engine(steps))
    yield WINDOW, labelled(path, Engine(), WINDOW_C)


def print_table(path: Path) -> None:
    """The engine's scores, then those without each step."""
    rows = measured(path)
    _, whole = next(rows)
    print(f"{path.stem}: {len(whole.frame_ids)} frames of {whole.n_subjects} people\n")
    print(f"| without | {' | '.join(heading for heading, _, _ in SHOWN.values())} |")
    print("|---|" + "---:|" * len(SHOWN))
    scores = (f"{f * whole.scores[name]:.{digits}f}" for name, (_, f, digits) in SHOWN.items())
    print(f"| {ALL} | {' | '.join(scores)} |", flush=True)
    for name, without in rows:
        print(row(name, whole, without), flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print_table(Path(name))
