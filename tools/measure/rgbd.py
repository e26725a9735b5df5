"""Labels and joints on RGB-D recordings: ``python -m tools.measure.rgbd [FOLDER ...] [--models PATH]``.

FOLDER: a recording as ``import`` reads it, or a folder of recordings; ../shared/data/rgbd by default. Its
``people.json`` holds, for each depth image by name, 33 landmarks (column, row, visibility) of each person by
MediaPipe Pose, as ``tools.measure.colour_people`` writes them. A recording without the file has no people.
PATH: models for ``colour_people``, by default those in the user's cache; they add a row of the colour
network with the depth looked up.

The judge is a colour network: it gives pixels, and no depth. Shares are of its visible joints. A joint is
right if the labels within 2 px have a part that meets there. Distances across the line of sight are in
trunks (shoulders to hips, in the image), and in millimetres by the depth at the judge's pixel. The measures
agree with the recordings' score.py.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from annotate.array_types import Float64
from annotate.labelset.label_set import LabelSet
from annotate.witness.blazepose import BlazePose
from eval.network.body_state import BodyState, body_state_notes, joint_row
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions
from eval.network.predict_source import predict_source
from eval.network.refine import shipped_refinement_network
from eval.scores.intervals import FEW
from eval.scores.joints import N_JOINTS
from sensors.errors import CloudError, FormatError
from sensors.files.natural_order import paths_in_order
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics, project, undistort
from tools.figures.figure import Figure, Rows, Statistic, average, median, of_values, ratio
from tools.figures.pages import markdown
from tools.figures.worst_frames import Sheets
from tools.measure.colour_people import make_people
from tools.measure.people_file import PEOPLE_FILE, read_people
from tools.measure.rgbd_tally import AS_JOINTS, JUDGED, Found, Seen, Tally, judged_facing_deg, looked_up_mm

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data" / "rgbd"
READINGS = {
    "`predict`": lambda: PredictOptions(room_refiner=shipped_refinement_network()),
    "`predict --no-again`": PredictOptions,
    "`predict --everybody`": lambda: PredictOptions(everybody=True),
}
RESAMPLES = 200  # of recordings; a tenth of evaluate's, because a median sorts every joint
COLOUR = "colour network, depth looked up"
SHARES = {
    "parts right": ("right", "joints"),
    "other side": ("other_side", "joints"),
    "missing": ("unlabelled", "joints"),
    "within a tenth": ("near", "seen"),
    "within a fifth": ("wide", "seen"),
    "facing to 30 degrees": ("facing", "faced"),
    "posture standing": ("standing", "matched"),
    "posture sitting": ("sitting", "matched"),
    "posture unclear": ("unclear", "matched"),
}
"""Counts that give a column: numerator and denominator."""
ABOUT = (
    "The judge is a colour network: visible joints in pixels. A joint is right if labels within 2 px have a "
    "part that meets there; a hand in front of a knee counts as wrong. Tenth, fifth: of the trunk's length "
    "in the image. Millimetres are medians by the depth at the judge's pixel: across the line of sight, and "
    "behind the surface. Phantoms: people beyond the judge's. Frames of a recording show the same people, so "
    "intervals need four recordings."
)
OF_LABELS = ("parts right", "other side", "missing", "posture standing", "posture sitting", "posture unclear")
"""Columns that the colour network lacks."""
PHANTOMS, ACROSS, BEHIND = "phantoms a frame", "across, mm", "behind, mm"
COLUMNS = {"frames": ".0f", **dict.fromkeys(SHARES, ".3f"), PHANTOMS: ".2f", ACROSS: ".0f", BEHIND: ".0f"}
SHOWN = {
    name: spec
    for name, spec in COLUMNS.items()
    if name not in ("posture standing", "posture unclear", BEHIND)
}
"""Columns of ``table``."""


def found_by_network(labels: LabelSet, frames: int) -> Iterator[Seen]:
    """Yield the frames of a label set by index; a frame that was left out has no depth and no labels."""
    camera, held = labels.whole_image, {int(frame_id): frame_id for frame_id in labels.frame_ids}
    nothing = np.zeros(camera.shape, np.uint16), np.zeros(camera.shape, np.uint8)
    for index in range(frames):
        if index not in held:
            yield Seen(*nothing, [])
            continue
        frame = labels.read(held[index], persons=False)
        found = []
        for note in body_state_notes(frame.notes).values():
            if state := BodyState.from_note(note):
                mm = np.array(list(joint_row(state.joints_mm(camera)).values()))  # as predict --joints
                at = np.column_stack([project(camera, mm), mm[:, 2]])
                found.append(Found(at, state.facing_deg, state.name))
        yield Seen(frame.depth_mm, frame.parts, found)


def found_by_colour(people: Sequence[Sequence[Float64]], labels: LabelSet) -> Iterator[Seen]:
    """Yield the frames of a label set with a colour network's people (33, 3), their depth looked up."""
    for persons, (depth_mm, *_) in zip(people, found_by_network(labels, len(people)), strict=True):
        found = []
        for person in persons:
            at = np.full((N_JOINTS, 3), np.nan)
            z = looked_up_mm(depth_mm, person[JUDGED, :2])
            at[AS_JOINTS] = np.column_stack([np.where(np.isnan(z)[:, None], np.nan, person[JUDGED, :2]), z])
            found.append(Found(at, judged_facing_deg(person, depth_mm, labels.whole_image)))
        yield Seen(depth_mm, None, found)


def measure_recording(folder: Path, network: OnnxNetwork, colour: BlazePose | None) -> dict[str, Tally]:
    """Measure a recording by reading; colour: None leaves its row out."""
    names = [path.stem for path in paths_in_order((folder / "depth").glob("*.png"))]
    truth = folder / PEOPLE_FILE
    given = read_people(truth, names) if truth.is_file() else {}
    source = open_source(folder)
    people = [[undistorted(source.calibration.depth, p) for p in given.get(name, [])] for name in names]
    tallies = {}
    with tempfile.TemporaryDirectory() as out:
        for number, (reading, options) in enumerate(READINGS.items()):
            path = Path(out) / str(number)
            labels = predict_source(source, network, path, lambda n: None, options()).labels
            found = found_by_network(labels, len(names))
            tallies[reading] = tally_of(labels.whole_image, people, found)
        if colour:
            made = make_people(folder, colour)
            moved = [[undistorted(source.calibration.depth, p) for p in made[name]] for name in names]
            tallies[COLOUR] = tally_of(labels.whole_image, people, found_by_colour(moved, labels))
    return tallies


def tally_of(camera: Intrinsics, people: Sequence[Sequence[Float64]], frames: Iterable[Seen]) -> Tally:
    """Return the counts of frames. people: judged (33, 3) of each frame."""
    tally = Tally(camera)
    for persons, seen in zip(people, frames, strict=True):
        tally.add(persons, seen)
    return tally


def undistorted(camera: Intrinsics, person: ArrayLike) -> Float64:
    """Return landmarks (33, 3) in the image without the lens's distortion."""
    moved = np.array(person, np.float64)
    if any(camera.distortion):
        focal, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
        moved[:, :2] = undistort(camera, (moved[:, :2] - centre) / focal) * focal + centre
    return moved


def recordings(folder: Path) -> list[Path]:
    """Return a folder that is a recording, or the recordings in a folder. Raises FormatError without any."""
    found = [path for path in (folder, *sorted(folder.glob("*"))) if (path / "depth").is_dir()]
    if not found:
        raise FormatError(f"{folder} has no recording; give a folder with depth/")
    return found[:1] if found[0] == folder else found


def figures(tallies: dict[str, Tally], reading: str) -> dict[str, Figure]:
    """Return the figures of a reading over recordings by name."""
    counts = [(name, n) for name, tally in tallies.items() for n in tally.counts]
    row = {"frames": Figure(len(counts))}
    for column, (part, whole) in SHARES.items():
        counted = [] if reading == COLOUR and column in OF_LABELS else counts
        pairs = [(name, (n[part], n[whole])) for name, n in counted if n[whole]]
        row[column] = over_recordings(pairs, lambda found, copies: ratio(copies @ found))
    row[PHANTOMS] = over_recordings([(name, n["phantoms"]) for name, n in counts], average)
    for column, kept in ((ACROSS, "across_mm"), (BEHIND, "behind_mm")):
        mm = [(name, value) for name, tally in tallies.items() for value in getattr(tally, kept)]
        row[column] = over_recordings(mm, median)
    return row


def over_recordings(values: list[tuple[str, Any]], statistic: Statistic) -> Figure:
    """Return a statistic of values by recording, with its interval over ``FEW`` recordings or more."""
    if not values:
        return Figure(float("nan"))
    names, numbers = zip(*values, strict=True)
    several = len(set(names)) >= FEW
    return of_values(numbers, names if several else ["one"] * len(names), statistic, RESAMPLES)


def tallied(folders: Sequence[Path], models: Path | None) -> dict[str, dict[str, Tally]]:
    """Measure recordings; return the counts by recording and reading."""
    network = OnnxNetwork()
    colour = colour_network(models)
    ordered = sorted(folders, key=lambda folder: not (folder / PEOPLE_FILE).is_file())
    return {folder.name: measure_recording(folder, network, colour) for folder in ordered}


def measure(folders: Sequence[Path], models: Path | None) -> Rows:
    """Return the figures of recordings by reading, each, and ``FEW`` or more together."""
    return rows_of(tallied(folders, models))


def rows_of(measured: dict[str, dict[str, Tally]]) -> Rows:
    """Return the figures of tallied recordings, as ``measure`` does."""
    rows: dict[str, dict[str, Figure]] = {}
    for name, tallies in measured.items():
        rows |= {f"`{name}`, {reading}": figures({name: t}, reading) for reading, t in tallies.items()}
    if len(measured) >= FEW:
        for reading in next(iter(measured.values())):
            own = {name: tallies[reading] for name, tallies in measured.items()}
            rows[f"all, {reading}"] = figures(own, reading)
    return rows


def table(seed: int) -> Rows:
    """Return the figures of ``RECORDINGS`` by the columns of ``SHOWN``; the seed is not used."""
    return {name: {column: row[column] for column in SHOWN} for name, row in rows_of(_shipped()).items()}


def sheets(seed: int) -> Sheets:
    """Return the worst frames of each of ``RECORDINGS`` by ``predict``; the seed is not used."""
    return {f"rgbd-{name}": next(iter(found.values())).tiles for name, found in _shipped().items()}


@lru_cache(maxsize=1)
def _shipped() -> dict[str, dict[str, Tally]]:
    return tallied(recordings(RECORDINGS), None)


def colour_network(models: Path | None) -> BlazePose | None:
    """Return the colour network; print a line and return None without its models or the extra."""
    try:
        return BlazePose(models)
    except CloudError as error:
        print(f"{COLOUR}: {error}", file=sys.stderr)
        return None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="*", default=[RECORDINGS])
    parser.add_argument("--models", type=Path)
    options = parser.parse_args()
    try:
        rows = measure([path for one in options.folders for path in recordings(one)], options.models)
    except CloudError as error:
        sys.exit(f"error: {error}")
    cells = [[row[c].text(spec) for c, spec in COLUMNS.items()] for row in rows.values()]
    print(markdown(["", *COLUMNS], [[name, *line] for name, line in zip(rows, cells, strict=True)]))
    print(f"\nRecordings of real people: {ABOUT}")


if __name__ == "__main__":
    main()
