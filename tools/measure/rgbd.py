"""Labels and joints on RGB-D recordings: ``python -m tools.measure.rgbd [FOLDER ...] [--models PATH]``.

FOLDER: a recording as ``import`` reads it, or a folder of recordings; ../shared/data/rgbd by default. Its
``people.json`` holds, for each depth image by name, 33 landmarks (column, row, visibility) of each person by
MediaPipe Pose, as ``tools.measure.colour_people`` writes them. A recording without the file shows nobody.
PATH: models for ``colour_people``; they add a row of the colour network with the depth looked up.

The judge is a colour network: it gives pixels, and no depth. Shares are of its visible joints. A joint is
right if the labels within 2 px have a part that meets there. Distances across the line of sight are in
trunks (shoulders to hips, in the image), and in millimetres by the depth at the judge's pixel. The measures
are those of the recordings' score.py.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from annotate.array_types import Float64, UInt8, UInt16
from annotate.labelset.label_set import LabelSet
from annotate.parts import N_CLASSES, PART_ID, TWIN_PARTS
from eval.network.body_state import BodyState, body_state_notes, joint_row
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.predict import PredictOptions
from eval.network.predict_source import predict_source
from eval.network.refine import shipped_refinement_network
from eval.scores.intervals import FEW
from eval.scores.joints import JOINT, N_JOINTS
from sensors.files.natural_order import paths_in_order
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics, project, undistort
from synth.body.skeleton import JOINT_ID
from synth.images.standing_statistics import facing_deg
from tools.figures.figure import Figure, Rows, average, median, of_values, ratio
from tools.figures.pages import markdown
from tools.measure.colour_people import ColourNetwork, make_people
from tools.measure.real_people import NEAR_DEG

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data" / "rgbd"
MODELS = Path(__file__).resolve().parents[2] / "build" / "colour"
"""Folder of the wheel with the colour network's models; not in the repository."""
SURE = 0.7  # least visibility of a judged joint
AROUND_PX, FAR_PX = 2, 5  # half windows: of a joint's labels, and of labels of its own side
LABELLED = 3  # least pixels with a part about a labelled joint
LOST = 0.6  # a person with a larger share of unlabelled joints is lost
NEAR, WIDE = 0.1, 0.2  # trunks
MEETING = {
    0: ("head", ("head",)),
    **{
        first + right: (f"{side}_{joint}", tuple(part.replace("SIDE", side) for part in parts))
        for first, joint, parts in (
            (11, "shoulder", ("torso", "SIDE_upper_arm")),
            (13, "elbow", ("SIDE_upper_arm", "SIDE_forearm")),
            (15, "wrist", ("SIDE_forearm",)),
            (23, "hip", ("torso", "hip", "SIDE_upper_leg")),
            (25, "knee", ("SIDE_upper_leg", "SIDE_lower_leg")),
            (27, "ankle", ("SIDE_lower_leg",)),
        )
        for right, side in enumerate(("left", "right"))
    },
}
"""Joint of ``predict`` and the parts that meet there, by landmark."""
JUDGED = np.array(list(MEETING))
AS_JOINTS = np.array([JOINT[joint] for joint, _ in MEETING.values()])
PARTS_AT = [np.array([PART_ID[part] for part in parts], np.uint8) for _, parts in MEETING.values()]
TRUNK = np.array([11, 12, 23, 24])  # landmarks: shoulders, hips
READINGS = {
    "`predict`": lambda: PredictOptions(room_refiner=shipped_refinement_network()),
    "`predict --no-again`": PredictOptions,
    "`predict --everybody`": lambda: PredictOptions(everybody=True),
}
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
}
"""Counts that give a column: numerator and denominator."""
ABOUT = (
    "The judge is a colour network: visible joints in pixels. A joint is right if labels within 2 px have a "
    "part that meets there; tenth, fifth: of the trunk's length in the image. Millimetres are medians by the "
    "depth at the judge's pixel: across the line of sight, and behind the surface. Phantoms: people beyond "
    "the judge's. Frames of a recording show the same people, so intervals need four recordings."
)
OF_LABELS = ("parts right", "other side", "missing", "posture standing", "posture sitting")
"""Columns that the colour network lacks."""
PHANTOMS, ACROSS, BEHIND = "phantoms a frame", "across, mm", "behind, mm"
COLUMNS = {"frames": ".0f", **dict.fromkeys(SHARES, ".3f"), PHANTOMS: ".2f", ACROSS: ".0f", BEHIND: ".0f"}
SHOWN = {name: spec for name, spec in COLUMNS.items() if name not in ("posture standing", BEHIND)}
"""Columns of ``table``."""


class Found(NamedTuple):
    """Person that was found. at: float64 (15, 3), column, row, depth in millimetres; NaN for no joint."""

    at: Float64
    facing_deg: float = float("nan")
    posture: str = ""


class Seen(NamedTuple):
    """Frame with its labels. depth_mm, parts: (h, w); parts: None for a network without labels."""

    depth_mm: UInt16
    parts: UInt8 | None
    found: list[Found]


@dataclass(eq=False)
class Tally:
    """Counts by frame, and distances of joints in millimetres.

    across_mm: distance across the line of sight. behind_mm: depth behind the surface at the judge's pixel.
    """

    camera: Intrinsics
    counts: list[Counter[str]] = field(default_factory=list)
    across_mm: list[float] = field(default_factory=list)
    behind_mm: list[float] = field(default_factory=list)

    def add(self, persons: Sequence[Float64], seen: Seen) -> None:
        """Count a frame. persons: judged (33, 3)."""
        labels = Counter() if seen.parts is None else count_labels(persons, seen.parts)
        self.counts.append(labels + self._of_people(persons, seen))

    def _of_people(self, persons: Sequence[Float64], seen: Seen) -> Counter[str]:
        """Count near joints, facings, postures and phantoms of a frame, and add its distances.

        The nearest found person is the judged one if the median joint is within a trunk.
        """
        n: Counter[str] = Counter(frames=1)
        used = set()
        for person in persons:
            sure, at = person[JUDGED, 2] >= SURE, person[JUDGED, :2]
            trunk = float(np.linalg.norm(person[TRUNK[:2], :2].mean(0) - person[TRUNK[2:], :2].mean(0)))
            facing = judged_facing_deg(person, seen.depth_mm, self.camera)
            n["seen"] += int(sure.sum())
            n["faced"] += not np.isnan(facing)
            off = [np.linalg.norm(at - one.at[AS_JOINTS, :2], axis=1)[sure] for one in seen.found]
            far = [float(np.median(px[np.isfinite(px)])) if np.isfinite(px).any() else np.inf for px in off]
            if min(far, default=np.inf) >= trunk:
                continue
            best = int(np.argmin(far))
            used.add(best)
            one = seen.found[best]
            n["near"] += int((off[best] / trunk < NEAR).sum())
            n["wide"] += int((off[best] / trunk < WIDE).sum())
            n["facing"] += bool(abs((one.facing_deg - facing + 180) % 360 - 180) <= NEAR_DEG)
            n["matched"] += 1
            n[one.posture] += 1
            self._add_distances(at[sure], one.at[AS_JOINTS][sure], seen.depth_mm)
        n["phantoms"] += len(seen.found) - len(used)
        return n

    def _add_distances(self, at_px: Float64, found: Float64, depth_mm: UInt16) -> None:
        """Add the distances of found joints (n, 3) from judged pixels (n, 2)."""
        z = looked_up_mm(depth_mm, at_px)
        across = np.linalg.norm((found[:, :2] - at_px) / (self.camera.fx, self.camera.fy), axis=1) * z
        for kept, mm in ((self.across_mm, across), (self.behind_mm, found[:, 2] - z)):
            kept += mm[np.isfinite(mm)].tolist()


def count_labels(persons: Sequence[Float64], parts: UInt8) -> Counter[str]:
    """Count right, missing and exchanged labels (h, w) at the visible joints of judged people (33, 3)."""
    n: Counter[str] = Counter(people=len(persons))
    height, width = parts.shape
    for person in persons:
        seen, empty = 0, 0
        for own, (x, y, sure) in zip(PARTS_AT, person[JUDGED], strict=True):
            u, v = round(x), round(y)
            if sure < SURE or not (2 <= u < width - 2 and 2 <= v < height - 2):
                continue
            seen += 1
            counted = np.bincount(window(parts, u, v, AROUND_PX).ravel(), minlength=256)[1:N_CLASSES]
            if counted.sum() < LABELLED:
                empty += 1
                continue
            part = int(counted.argmax()) + 1
            swapped = part not in own and TWIN_PARTS[part] in own
            n["right"] += part in own
            n["other_side"] += swapped
            n["other_side_far"] += swapped and not np.isin(window(parts, u, v, FAR_PX), own).any()
        n["joints"] += seen
        n["unlabelled"] += empty
        n["lost"] += seen > 0 and empty > LOST * seen
    return n


def window(image: UInt8 | UInt16, u: int, v: int, half: int) -> UInt8 | UInt16:
    """Return the pixels within half pixels of a pixel, each way."""
    return image[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]


def looked_up_mm(depth_mm: UInt16, at_px: Float64) -> Float64:
    """Return the depth (n,) of the surface about pixels (n, 2), millimetres; NaN without a reading."""
    found = np.full(len(at_px), np.nan)
    for k, (u, v) in enumerate(np.rint(at_px).astype(int)):
        if 0 <= v < depth_mm.shape[0] and 0 <= u < depth_mm.shape[1]:
            near = window(depth_mm, u, v, AROUND_PX)
            found[k] = np.median(near[near > 0]) if near.any() else np.nan
    return found


def judged_facing_deg(person: Float64, depth_mm: UInt16, camera: Intrinsics) -> float:
    """Return the facing by a judged person's (33, 3) shoulders and hips on the surface; NaN if not seen."""
    (u, v), z = person[TRUNK, :2].T, looked_up_mm(depth_mm, person[TRUNK, :2])
    if (person[TRUNK, 2] < SURE).any() or np.isnan(z).any():
        return float("nan")
    mm = np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    placed = np.full((len(JOINT_ID), 3), np.nan)
    names = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    placed[[JOINT_ID[name] for name in (*names, "neck", "pelvis")]] = *mm, mm[:2].mean(0), mm[2:].mean(0)
    return facing_deg(placed)


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


def measure_recording(folder: Path, network: OnnxNetwork, colour: ColourNetwork | None) -> dict[str, Tally]:
    """Measure a recording by reading; colour: None leaves its row out."""
    names = [path.stem for path in paths_in_order((folder / "depth").glob("*.png"))]
    truth = folder / "people.json"
    given = json.loads(truth.read_text()) if truth.is_file() else {}
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


def undistorted(camera: Intrinsics, person: Sequence[Sequence[float]]) -> Float64:
    """Return landmarks (33, 3) in the image without the lens's distortion."""
    moved = np.array(person, np.float64)
    if any(camera.distortion):
        focal, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
        moved[:, :2] = undistort(camera, (moved[:, :2] - centre) / focal) * focal + centre
    return moved


def recordings(folder: Path) -> list[Path]:
    """Return a folder that is a recording, or the recordings in a folder."""
    if (folder / "depth").is_dir():
        return [folder]
    return [path for path in sorted(folder.iterdir()) if (path / "depth").is_dir()]


def figures(tallies: dict[str, Tally], reading: str) -> dict[str, Figure]:
    """Return the figures of a reading over recordings by name."""
    counts = [(name, n) for name, tally in tallies.items() for n in tally.counts]
    row = {"frames": Figure(len(counts))}
    for column, (part, whole) in SHARES.items():
        counted = [] if reading == COLOUR and column in OF_LABELS else counts
        pairs = [(name, (n[part], n[whole])) for name, n in counted if n[whole]]
        row[column] = over_recordings(pairs, lambda found: float(ratio(found.sum(0))))
    row[PHANTOMS] = over_recordings([(name, n["phantoms"]) for name, n in counts], average)
    for column, kept in ((ACROSS, "across_mm"), (BEHIND, "behind_mm")):
        mm = [(name, value) for name, tally in tallies.items() for value in getattr(tally, kept)]
        row[column] = over_recordings(mm, median)
    return row


def over_recordings(values: list[tuple[str, Any]], statistic: Callable[[Float64], float]) -> Figure:
    """Return a statistic of values by recording, with its interval over ``FEW`` recordings or more."""
    if not values:
        return Figure(float("nan"))
    names, numbers = zip(*values, strict=True)
    several = len(set(names)) >= FEW
    return (
        of_values(numbers, names, statistic)
        if several
        else Figure(statistic(np.asarray(numbers, np.float64)))
    )


def measure(folders: Sequence[Path], models: Path | None) -> Rows:
    """Return the figures of recordings by reading, each, and ``FEW`` or more together."""
    network = OnnxNetwork(SHIPPED_WEIGHTS)
    colour = ColourNetwork.of(models) if models else None
    if not colour:
        print(f"models of the {COLOUR} are missing; put MediaPipe's wheel in {MODELS}", file=sys.stderr)
    ordered = sorted(folders, key=lambda folder: not (folder / "people.json").is_file())
    measured = {folder.name: measure_recording(folder, network, colour) for folder in ordered}
    rows = {}
    for name, tallies in measured.items():
        rows |= {f"`{name}`, {reading}": figures({name: t}, reading) for reading, t in tallies.items()}
    if len(measured) >= FEW:
        for reading in (*READINGS, *([COLOUR] if colour else [])):
            own = {name: tallies[reading] for name, tallies in measured.items()}
            rows[f"all, {reading}"] = figures(own, reading)
    return rows


def table(seed: int) -> Rows:
    """Return the figures of ``RECORDINGS`` by the columns of ``SHOWN``; the seed is not used."""
    rows = measure(recordings(RECORDINGS), wheel_in(MODELS))
    return {name: {column: row[column] for column in SHOWN} for name, row in rows.items()}


def wheel_in(folder: Path) -> Path | None:
    """Return the first wheel with the colour network's models in a folder, if any."""
    return next(iter(sorted(folder.glob("mediapipe*.whl"))), None)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="*", default=[RECORDINGS])
    parser.add_argument("--models", type=Path, default=wheel_in(MODELS))
    options = parser.parse_args()
    folders = [path for folder in options.folders for path in recordings(folder)]
    rows = measure(folders, options.models)
    cells = [[row[c].text(spec) for c, spec in COLUMNS.items()] for row in rows.values()]
    print(markdown(["", *COLUMNS], [[name, *line] for name, line in zip(rows, cells, strict=True)]))
    print(f"\nRecordings of real people: {ABOUT}")


if __name__ == "__main__":
    main()
