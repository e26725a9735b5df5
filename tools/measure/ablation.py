"""Scores of the suit network without each input: ``python -m tools.measure.ablation SESSION.mcap...``.

Prints a Markdown table for each simulated session: scores without the input and an annotator's seconds a
frame. Brackets hold the paired 95 % interval of the change to all inputs (Student's t over people).

An input is cut from all its consumers:

- suit: likelihood channels, border refinement, the illuminant and its note, the choice of the subject.
- color: these, and the channels shade, red, green, room, the flag of readable colours, the gate on them.
- temperature: person network, window, cold frames, thermal alignment, channels share and celsius, their flag.
- planes: channel off_plane; the points off planes that give window, warm points and share.
- before: channel before, kept illuminant, choice of the subject, track ids.

A channel is cut from the suit network alone, because it has no other consumer. Depth and the coarse outline
that give channels stay. The simulated annotator uses depth and labels, no colour and no temperature.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.correction import Correction
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run, SuitDetection, run
from annotate.labelset.label_set import LabelSet
from annotate.person.extract import PersonDetection, PersonMask
from annotate.person.planes import Plane
from annotate.person.warmth import WINDOW_C
from annotate.scheme.scheme import Scheme
from annotate.segmentation.input_channels import CHANNELS, OTHER, SEEN, SUBJECT, Rectangle
from annotate.segmentation.segment import SuitSegmenter, view_of
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
from annotate.suit.palette import Suit, load_suit
from eval.compare.compare import Comparison, compare_sets
from eval.compare.difference import difference
from eval.compare.results import Result
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import DEFAULT, PredictOptions
from eval.network.predict_source import predict_source
from eval.network.refine import shipped_refinement_network
from eval.scores.intervals import quantile
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

SHOWN = {
    "person_iou": ("person IoU", 3),
    "mean_recall": ("mean recall", 3),
    "boundary_f": ("boundary F, 2 px", 3),
}
# Heading and digits of the scores shown.
SECONDS = "annotator, s"
MIDDLE = 127  # neutral byte of a scaled channel: middle of its range
GREY = 128  # constant colour of all pixels without the colour image
Input: TypeAlias = Literal["suit", "color", "temperature", "planes", "before"]


@dataclass(frozen=True)
class Silence:
    """Channels set to the middle of their range everywhere, and bits of the flags set to 0."""

    channels: tuple[str, ...] = ()
    flags: int = 0

    def over(self, planes: UInt8) -> UInt8:
        """Return channels (24, h, w) without the silenced ones."""
        silent = planes.copy()
        silent[0] &= np.uint8(255 - self.flags)
        silent[[CHANNELS.index(name) for name in self.channels]] = MIDDLE
        return silent


class SilencedNetwork(SuitNetwork):
    """Shipped suit network without some channels."""

    def __init__(self, silence: Silence) -> None:
        self.__setstate__(shipped_suit_network().__getstate__())
        self._silence = silence

    def probabilities(self, planes: UInt8, step: int, near: Rectangle | None = None) -> Float32:
        """Return the part probabilities from the channels that are not cut."""
        return super().probabilities(self._silence.over(planes), step, near)


class DetectionWithoutPlanes(PersonDetection):
    """Persons of a frame whose room has no planes."""

    @property
    def planes(self) -> tuple[Plane, ...]:
        """Return no plane."""
        return ()


@dataclass(frozen=True)
class Cut:
    """Inputs cut from all their consumers, channels cut from the suit network.

    window_c: constant temperature window instead of each frame's own, in degrees Celsius; None = own.
    """

    inputs: tuple[Input, ...] = ()
    silence: Silence = Silence()
    window_c: tuple[float, float] | None = None

    def cloud(self, cloud: ThermalCloud) -> ThermalCloud:
        """Return a frame's cloud without the cut images."""
        if "color" in self.inputs:
            grey = np.full_like(cloud.color_rgb, GREY)
            cloud = replace(cloud, color_rgb=grey, color_valid=np.ones_like(cloud.color_valid))
        if "temperature" in self.inputs:
            cloud = replace(cloud, temperature_c=np.full_like(cloud.temperature_c, np.nan))
        return cloud


@dataclass(frozen=True)
class LabellerWithout:
    """Labeller by the shipped suit network, without the inputs of a cut (``Labeller``)."""

    suit: Suit
    cut: Cut = Cut()

    @cached_property
    def network(self) -> SuitNetwork:
        """Return the suit network without the cut channels."""
        silence = self.cut.silence
        if "color" in self.cut.inputs:
            silence = replace(silence, flags=silence.flags | SEEN)
        return SilencedNetwork(silence)

    @property
    def worn(self) -> Suit | None:
        """Return the suit whose colours are used, if any."""
        return None if {"suit", "color"} & set(self.cut.inputs) else self.suit

    @property
    def scheme(self) -> Scheme:
        """Return the scheme of the labels."""
        return self.network.scheme

    def fuser(self, calibration: RigCalibration) -> Fuser:
        """Return the fusion of whole clouds."""
        return Fuser(calibration)

    def detect(self, cloud: ThermalCloud) -> SuitDetection:
        """Detect the persons of a cloud without the cut images and planes."""
        cloud = self.cut.cloud(cloud)
        detection = DetectionWithoutPlanes if "planes" in self.cut.inputs else PersonDetection
        persons = detection(CoarseCloud.of(cloud), self.cut.window_c, self.worn)
        likely = persons.person(None)
        return SuitDetection(
            cloud, persons, likely, view_of(cloud, persons, likely) if likely.trusted else None
        )

    def label(
        self, detection: SuitDetection, before: FrameLabels | None = None
    ) -> tuple[Segmentation, PersonMask]:
        """Label the subject of a frame by the remaining inputs."""
        before = None if "before" in self.cut.inputs else before
        person = detection.persons.person(before)
        if not person.trusted:
            return unlabelled(person.mask), person
        segmenter = SuitSegmenter(self.worn, self.network)
        return segmenter.segment(detection.cloud, detection.view(person), person, before)


ALL, SUIT, COLOR, DEPTH_ALONE = "all inputs", "the suit's colours", "all colour", "all colour and temperature"
TEMPERATURE, PLANES, BEFORE = "temperature", "planes of the room", "the frame before"
CUTS = {
    SUIT: Cut(("suit",)),
    COLOR: Cut(("color",)),
    TEMPERATURE: Cut(("temperature",)),
    DEPTH_ALONE: Cut(("color", "temperature")),
    PLANES: Cut(("planes",)),
    BEFORE: Cut(("before",)),
}
"""Cuts of inputs by row of the table."""
CHANNELS_CUT = {
    "temperature window of each frame": Cut(window_c=WINDOW_C),
    "channels shade and hue": Cut(silence=Silence(("shade", "red", "green"))),
    "channel of colours in the room": Cut(silence=Silence(("room",))),
    "channel of depth in the person": Cut(silence=Silence(("depth",))),
    "channel of depth in 31 pixels": Cut(silence=Silence(("local",))),
    "flags of the coarse outline": Cut(silence=Silence(flags=SUBJECT | OTHER)),
}
"""Cuts of channels by row, and the paper's temperature window."""
PREDICT, REFINED = "`predict`", "`predict`, refined"


@dataclass(frozen=True)
class Found:
    """Comparison of a session's labels.

    seconds: of an annotator, by frame id, for the last frame of each person.
    """

    scored: Comparison
    seconds: dict[str, float]

    @property
    def mean_s(self) -> float:
        """Return the annotator's mean seconds a frame."""
        return float(np.mean(list(self.seconds.values())))


Work: TypeAlias = Callable[[Session, Path], Run]
"""Function that labels a session into a folder."""


def label_without(path: Path, cut: Cut) -> Work:
    """Return the work that labels the simulated session ``path`` without the inputs of a cut."""
    labeller = LabellerWithout(load_suit(suit_path(path)), cut)
    return lambda session, out: run(session, {}, out, labeller, lambda n: None)


def predict(options: PredictOptions) -> Work:
    """Return the work that labels a session by the depth network of ``predict``."""
    return lambda session, out: predict_source(session, OnnxNetwork(), out, lambda n: None, options)


def labelled(path: Path, work: Work) -> Found:
    """Label a simulated session and measure the labels."""
    with tempfile.TemporaryDirectory() as folder:
        truth, done = LabelSet.open(truth_path(path)), work(Session(path), Path(folder) / "l")
        for frame_id, why in done.failed:
            print(f"frame {frame_id}: {why}", file=sys.stderr)
        scored, annotator = compare_sets(done.labels, truth, workers=1), Annotator()
        last = sorted(dict(zip(scored.subjects, scored.frame_ids, strict=True)).values())
        with Correction.open(done.labels.path, WHO, clock=annotator.clock) as correction:
            efforts = list(correct_set(correction, truth, annotator, lambda frame_id: None, last))
    return Found(scored, {one.corrected.frame_id: one.seconds for one in efforts})


def more_s(whole: Found, without: Found) -> tuple[float, float, float]:
    """Return the annotator's additional seconds a frame, with the 95 % interval over people."""
    both = whole.seconds.keys() & without.seconds.keys()
    more = np.array([without.seconds[frame_id] - whole.seconds[frame_id] for frame_id in sorted(both)])
    error = more.std(ddof=1) / np.sqrt(len(more)) if len(more) > 1 else np.nan
    half, mean = float(error * quantile(len(more) - 1)), float(more.mean())
    return mean, mean - half, mean + half


def changes(whole: Found, without: Found) -> dict[str, tuple[float, float, float]]:
    """Return each column's change from ``whole`` to ``without``, with its paired 95 % interval."""
    lost = difference(Result("without", without.scored), Result(ALL, whole.scored))
    found = {SECONDS: more_s(whole, without)}
    for score, (heading, _) in SHOWN.items():
        low, high = map(float, lost.ci95[score])
        found[heading] = float(lost.scores[score]), low, high
    return found


def row(name: str, whole: Found, without: Found) -> str:
    """Return a Markdown row: scores without an input, each with the interval of its change."""
    cells, changed = [name], changes(whole, without)
    for score, (heading, digits) in SHOWN.items():
        _, low, high = changed[heading]
        value = float(without.scored.scores[score])
        cells.append(f"{value:.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]")
    _, low, high = changed[SECONDS]
    cells.append(f"{without.mean_s:.1f} [{low:+.1f}, {high:+.1f}]")
    return f"| {' | '.join(cells)} |"


def measured(path: Path, cuts: Mapping[str, Cut] = CUTS) -> Iterator[tuple[str, Found]]:
    """Yield name and measurement of each row, with all inputs first and ``predict`` last."""
    yield ALL, labelled(path, label_without(path, Cut()))
    for name, cut in cuts.items():
        yield name, labelled(path, label_without(path, cut))
    yield PREDICT, labelled(path, predict(DEFAULT))
    yield REFINED, labelled(path, predict(PredictOptions(room_refiner=shipped_refinement_network())))


def print_table(path: Path) -> None:
    """Print a session's table."""
    rows = measured(path, CUTS | CHANNELS_CUT)
    _, whole = next(rows)
    print(f"{path.stem}: {len(whole.scored.frame_ids)} frames of {whole.scored.n_subjects} people\n")
    print(f"| without | {' | '.join(heading for heading, _ in SHOWN.values())} | {SECONDS} |")
    print("|---|" + "---:|" * (len(SHOWN) + 1))
    scores = (f"{float(whole.scored.scores[name]):.{digits}f}" for name, (_, digits) in SHOWN.items())
    print(f"| {ALL} | {' | '.join(scores)} | {whole.mean_s:.1f} |", flush=True)
    for name, without in rows:
        print(row(name, whole, without), flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print_table(Path(name))
