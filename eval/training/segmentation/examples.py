"""Examples for the reader: what it sees of frames whose parts are known, in every pixel; files of them."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from zipfile import ZipFile

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitDetection, SuitLabeller, calibrated
from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND
from annotate.segmentation.input_channels import with_likelihoods
from annotate.segmentation.segment import OTHER_PERSON, coarse_pass
from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
from annotate.suit.color_model import fit_illuminant
from annotate.suit.palette import Suit, load_suit, suit_to_toml
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import replacing
from sensors.files.npz import array_sizes
from sensors.importers.open_source import Source, open_source

ROUGH_EVERY = 3
"""Every so many frames are seen as labelling reads them first, in the light of all colours. Chosen by eye."""
OPEN_FILES = 256
"""Files that are held open at once; a process may have about a thousand."""


class Example(NamedTuple):
    """A frame to learn from, around its subject.

    planes: uint8 (24, h, w), channels of every pixel (`annotate.segmentation.input_channels`).
    target: uint8 (h, w), the true part, 12 for another person, 255 where it is not known.
    meta: float64, the focal length in pixels and the subject's distance in metres.
    """

    planes: UInt8
    target: UInt8
    meta: Float64

    @property
    def pixel_m(self) -> float:
        """Metres between two pixels on the subject."""
        return float(self.meta[1] / self.meta[0])


def example_of(
    cloud: ThermalCloud, truth: FrameLabels, before: FrameLabels | None, suit: Suit, *, rough: bool
) -> Example | None:
    """Example of a frame, seen as labelling sees it; None where that would not read the suit.

    rough: in the light of all colours, as labelling reads first, and not in that of the parts.
    """
    return example_in(
        SuitLabeller(suit).detect(cloud), truth, before, suit, None if rough else shipped_suit_network()
    )


def example_in(
    survey: SuitDetection,
    truth: FrameLabels,
    before: FrameLabels | None,
    suit: Suit,
    reader: SuitNetwork | None,
) -> Example | None:
    """Example of a surveyed frame as ``example_of``; reader: finds the parts' light, None = that of all
    colours."""
    cloud, person = survey.cloud, survey.persons.person(before)
    view = survey.view(person) if person.trusted else None
    if view is None:
        return None
    view = view.after(before, suit)
    target = truth.parts[view.where].copy()
    if truth.persons is not None:
        target[(truth.persons[view.where] > 1) & (target == BACKGROUND)] = OTHER_PERSON
    light = coarse_pass(view, suit, reader)[1] if reader else fit_illuminant(suit, view.colors)
    planes = with_likelihoods(view.planes, view.rgb, light)
    distance_m = np.median(cloud.points_m[..., 2][person.mask & cloud.valid])
    return Example(planes, target, np.array([cloud.camera.fx, distance_m]))


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
        frame_ids = frozenset(i for i in known.frame_ids if known.status(i) != "auto")
        if not frame_ids:
            raise CloudError(f"{labels} holds automatic labels only; correct some frames, or give the truth")
        return cls(open_source(path), known, load_suit(suit), frame_ids)

    def examples(self) -> Iterator[Example | None]:
        """Every frame in turn; None where its labels do not count or labelling would not read the suit.

        The labels before are those of the label set, checked or not. Raises CloudError where the labels are
        of another recording.
        """
        fuser, before, kept = Fuser(self.source.calibration), None, set(self.labels.frame_ids)
        for frame in self.source:
            frame_id = f"{frame.index:06d}"
            labels = self.labels.read(frame_id) if frame_id in kept else None
            if labels is None or frame_id not in self.frame_ids:
                yield None
            else:
                cloud = fuser.fuse_frame(calibrated(frame, fuser.calibration)[0])
                if not np.array_equal(labels.depth_mm, cloud.depth_mm):
                    raise CloudError(
                        f"frame {frame_id} of {self.labels.path} shows another depth image than "
                        f"{self.source.name}; give the labels of this recording"
                    )
                yield example_of(cloud, labels, before, self.suit, rough=frame.index % ROUGH_EVERY == 0)
            before = labels

    def digest(self) -> str:
        """SHA-256 of the suit and of all labels that count, depth images included."""
        digest = hashlib.sha256(suit_to_toml(self.suit).encode())
        for frame_id in sorted(self.frame_ids):
            labels = self.labels.read(frame_id)
            digest.update(frame_id.encode() + labels.depth_mm.tobytes() + labels.parts.tobytes())
        return digest.hexdigest()


def store_examples(examples: Iterable[Example], path: Path) -> None:
    """Write examples as arrays ``NUMBER.FIELD`` of an .npz file, whole or not at all: about 3 MB each."""
    with replacing(path) as unfinished, ZipFile(unfinished, "w") as archive:
        for number, example in enumerate(examples):
            for name, array in example._asdict().items():
                with archive.open(f"{number:06d}.{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)


class Stock:
    """Examples in files, read one by one.

    Raises FormatError where a file is damaged, CloudError where there are no examples.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        ending = ".planes"
        self._at = [
            (path, name.removesuffix(ending))
            for path in paths
            for name in sorted(array_sizes(path, "remove it"))
            if name.endswith(ending)
        ]
        if not self._at:
            raise CloudError(
                "no checked frame shows a person whose suit can be read; check the palette, or record more"
            )
        self._opened = lru_cache(OPEN_FILES)(np.load)

    def __len__(self) -> int:
        return len(self._at)

    def __getitem__(self, index: int) -> Example:
        path, number = self._at[index]
        try:
            archive = self._opened(path)
            planes, target, meta = (archive[f"{number}.{name}"] for name in Example._fields)
        except Exception as error:  # zipfile and numpy raise a dozen kinds at damaged bytes
            raise FormatError(f"{path} cannot be read ({error}); remove it") from error
        return Example(planes, target, meta)

    def spread(self, most: int) -> list[int]:
        """Indices of at most so many examples, evenly over all."""
        return [int(i) for i in np.linspace(0, len(self) - 1, min(len(self), most))]
