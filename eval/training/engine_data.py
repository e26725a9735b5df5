"""Training material of the labelling engine: recordings with known labels, and the inputs of each frame."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Index, Int32, UInt8
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine
from annotate.frame_labels import FrameLabels
from annotate.label_source import cleaned
from annotate.labelset.store import LabelSet
from annotate.parts import BODY_PARTS, UNDEFINED, swap_left_right
from annotate.person.extract import PersonMask, Survey
from annotate.second_look.descriptors import LAYOUT, WIDTHS, descriptors, neighbour_pairs
from annotate.second_look.look import look_again
from annotate.segmentation.segment import Segmentation, segment
from annotate.suit.palette import Suit, load_suit, suit_to_toml
from sensors.errors import CloudError
from sensors.files.atomic import replacing
from sensors.files.npz import load_arrays
from sensors.importers.open_source import Source, open_source

CLASSES = len(BODY_PARTS) + 1
ROWS_BYTES = 1 << 31
"""Size that a recording's rows may unpack to; an hour of frames takes a tenth."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of people in a suit, its labels, and the palette that was worn.

    frame_ids: those of the frames whose labels count: not the automatic ones.
    """

    source: Source
    labels: LabelSet
    suit: Suit
    frame_ids: frozenset[str]

    @classmethod
    def open(cls, path: Path, labels: Path, suit: Path) -> "Recording":
        """Raises CloudError where the labels or the suit cannot be read, or no frame's labels count."""
        known = LabelSet.open(labels)
        frame_ids = frozenset(frame.frame_id for frame in known if frame.status != "auto")
        if not frame_ids:
            raise CloudError(f"{labels} holds automatic labels only; correct some frames, or give the truth")
        return cls(open_source(path), known, load_suit(suit), frame_ids)

    def clouds(self) -> Iterator[tuple[ThermalCloud, UInt8 | None]]:
        """Every frame's cloud with its known parts (h, w), None where they do not count.

        Raises CloudError where the labels are of another recording.
        """
        fuser = Fuser(self.source.calibration)
        for frame in self.source:
            cloud, frame_id = fuser.fuse_frame(frame), f"{frame.index:06d}"
            labels = self.labels.read(frame_id) if frame_id in self.frame_ids else None
            if labels is not None and not np.array_equal(labels.depth_mm, cloud.depth_mm):
                raise CloudError(
                    f"frame {frame_id} of {self.labels.path} shows another depth image than "
                    f"{self.source.name}; give the labels of this recording"
                )
            yield cloud, None if labels is None else labels.parts

    def digest(self) -> str:
        """SHA-256 of the suit and of all labels that count, depth images included."""
        digest = hashlib.sha256(suit_to_toml(self.suit).encode())
        for frame_id in sorted(self.frame_ids):
            labels = self.labels.read(frame_id)
            digest.update(frame_id.encode() + labels.depth_mm.tobytes() + labels.parts.tobytes())
        return digest.hexdigest()


class Observed(NamedTuple):
    """A frame as the engine read it. truth: known parts (h, w). before: labels of the frame before it."""

    cloud: ThermalCloud
    truth: UInt8
    before: FrameLabels | None
    person: PersonMask
    found: Segmentation


def observed(recording: Recording, engine: Engine) -> Iterator[Observed | None]:
    """Every frame of a recording in turn as ``label`` reads it, before islands are given away; None for a
    frame whose labels do not count or whose suit could not be read."""
    before = None
    for cloud, truth in recording.clouds():
        person = Survey(cloud, None, recording.suit, engine).person(before)
        if not person.trusted:
            before = None
            yield None
            continue
        found = segment(cloud, person.mask, recording.suit, before, engine)
        if engine.steps.second_look:
            found, person = look_again(cloud, person, found, before, engine)
        usable = truth is not None and found.reading is not None and person.candidates is not None
        yield Observed(cloud, truth, before, person, found) if usable and truth is not None else None
        found, person = cleaned(found, person, cloud)
        persons = np.where(person.mask, 1, np.where(person.others, person.persons, 0)).astype(np.uint8)
        before = FrameLabels("x", cloud.depth_mm, found.parts, found.confidence, persons=persons)


@dataclass(frozen=True)
class Rows:
    """A frame's G supervoxels as the second look reads them.

    described: float32 (G, F), their descriptors. edges: int32 (e, 2), pairs of neighbours. patch: (G,), the
    patch of each. pixels: int32 (G, 13), how many pixels of each are of each class, the last undefined.
    """

    described: Float32
    edges: Int32
    patch: Index
    pixels: Int32

    def mirrored(self) -> "Rows":
        """The frame as a mirror shows it: left and right exchanged, x the other way."""
        parts = swap_left_right(np.arange(CLASSES, dtype=np.uint8)).astype(np.intp)
        columns, signs, at = [], [], 0
        for kind in LAYOUT.values():
            order = {"parts": parts[1:] - 1, "classes": parts}.get(kind, np.arange(WIDTHS[kind]))
            columns.append(at + order)
            signs.append(np.array([-1, 1, 1]) if kind == "xyz" else np.ones(len(order)))
            at += len(order)
        found = self.described[:, np.concatenate(columns)] * np.concatenate(signs).astype(np.float32)
        return Rows(found, self.edges, self.patch, self.pixels[:, [*parts, CLASSES]])


def rows_of(frame: Observed) -> Rows:
    """Rows of a frame that has been read by the suit's rules alone."""
    seen, cloud = frame.person.candidates, frame.cloud
    assert seen is not None
    groups, own = seen.clues.groups, seen.clues.compared
    true = np.where(frame.truth == UNDEFINED, CLASSES, frame.truth)[own].astype(np.intp)
    pixels = np.bincount(groups.ids * (CLASSES + 1) + true, minlength=groups.count * (CLASSES + 1))
    return Rows(
        descriptors(cloud, frame.person.mask, seen, frame.found, frame.before).astype(np.float32),
        neighbour_pairs(groups.centroids_m(cloud.points_m[own])),
        seen.clues.patches.ids,
        pixels.reshape(groups.count, -1).astype(np.int32),
    )


FIELDS = tuple(Rows.__dataclass_fields__)


def save_rows(rows: list[Rows], path: Path) -> None:
    """Write a recording's rows as arrays named ``NUMBER.FIELD``."""
    arrays = {f"{i}.{name}": getattr(frame, name) for i, frame in enumerate(rows) for name in FIELDS}
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_rows(path: Path) -> list[Rows]:
    """What ``save_rows`` wrote. Raises FormatError where it is damaged."""
    arrays = load_arrays(path, ROWS_BYTES, "remove it")
    return [Rows(*(arrays[f"{i}.{name}"] for name in FIELDS)) for i in range(len(arrays) // len(FIELDS))]
