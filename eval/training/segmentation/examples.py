"""Examples for the suit network: its input and the true parts of frames; files of examples."""

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
from annotate.labelset.cast_note import cast_note, check_trainable
from annotate.labelset.label_set import LabelSet
from annotate.scheme.scheme import BACKGROUND
from annotate.segmentation.input_channels import with_likelihoods
from annotate.segmentation.segment import coarse_pass
from annotate.segmentation.suit_network import SuitNetwork, other_person, shipped_suit_network
from annotate.suit.color_model import fit_illuminant
from annotate.suit.palette import Suit, load_suit, suit_to_toml
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import replacing
from sensors.files.npz import array_sizes
from sensors.importers.open_source import Source, open_source

ROUGH_EVERY = 3  # every third frame has the illuminant of all colours, as in a first pass; untuned
OPEN_FILES = 256  # held open at once; a process may have about a thousand


class Example(NamedTuple):
    """Frame to train on, cropped around its subject.

    planes: uint8 (n, h, w), channels of every pixel (`annotate.segmentation.input_channels`). target: uint8
    (h, w), the class of the true part in the labels' scheme, its ``other_person``, 255 for unknown. meta:
    float64, focal length in pixels and the subject's distance in metres.
    """

    planes: UInt8
    target: UInt8
    meta: Float64

    @property
    def pixel_m(self) -> float:
        """Return the distance of two neighbouring pixels at the subject, in metres."""
        return float(self.meta[1] / self.meta[0])


def example_of(
    cloud: ThermalCloud, truth: FrameLabels, before: FrameLabels | None, suit: Suit, *, rough: bool
) -> Example | None:
    """Return the training example of a frame as labelling processes it; None where labelling skips the frame.

    rough: fit the illuminant to all colours, as labelling does first, not to the parts.
    """
    network = None if rough else shipped_suit_network()
    return detected_example(SuitLabeller(suit).detect(cloud), truth, before, suit, network)


def detected_example(
    detection: SuitDetection,
    truth: FrameLabels,
    before: FrameLabels | None,
    suit: Suit,
    network: SuitNetwork | None,
) -> Example | None:
    """Return the training example of a frame after person detection; None where labelling skips the frame.

    network: its parts give the illuminant; None = use all colours.
    """
    cloud, person = detection.cloud, detection.persons.person(before)
    view = detection.view(person) if person.trusted else None
    if view is None:
        return None
    scheme, found = truth.scheme, view
    view = found.after(before, suit, scheme)
    target = scheme.class_table[truth.parts[view.where]]
    if truth.persons is not None:
        target[(truth.persons[view.where] > 1) & (target == BACKGROUND)] = other_person(scheme)
    if network:
        light = coarse_pass(found.after(before, suit, network.own), suit, network)[1]
    else:
        light = fit_illuminant(suit, view.colors)
    planes = with_likelihoods(view.planes, view.rgb, light, scheme=scheme)
    distance_m = np.median(cloud.points_m[..., 2][person.mask & cloud.valid])
    return Example(planes, target, np.array([cloud.camera.fx, distance_m]))


@dataclass(frozen=True, eq=False)
class Recording:
    """Recording of people in a suit, with its labels and palette.

    frame_ids: frames whose labels are not automatic.
    """

    source: Source
    labels: LabelSet
    suit: Suit
    frame_ids: frozenset[str]

    @classmethod
    def open(cls, path: Path, labels: Path, suit: Path) -> "Recording":
        """Open a recording, its label set and the palette file of its suit.

        Raises CloudError if the labels or the palette are unreadable, if all labels are automatic, or for the
        judging cast.
        """
        known = LabelSet.open(labels)
        frame_ids = frozenset(i for i in known.frame_ids if known.status(i) != "auto")
        if not frame_ids:
            raise CloudError(f"{labels} holds automatic labels only; correct some frames, or give the truth")
        source = open_source(path)
        check_trainable(path, cast_note(source.cast))
        return cls(source, known, load_suit(suit), frame_ids)

    def examples(self) -> Iterator[Example | None]:
        """Yield the example of every frame in turn; None for automatic labels and unusable frames.

        The previous frame's labels come from the label set, corrected or not. Raises CloudError for the
        labels of another recording.
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
        """Return the SHA-256 of the palette and all labels that are used, depth images included."""
        digest = hashlib.sha256(suit_to_toml(self.suit).encode())
        for frame_id in sorted(self.frame_ids):
            labels = self.labels.read(frame_id)
            digest.update(frame_id.encode() + labels.depth_mm.tobytes() + labels.parts.tobytes())
        return digest.hexdigest()


def store_examples(examples: Iterable[Example], path: Path) -> None:
    """Write examples as arrays ``NUMBER.FIELD`` of an .npz file, atomically: about 3 MB each."""
    with replacing(path) as unfinished, ZipFile(unfinished, "w") as archive:
        for number, example in enumerate(examples):
            for name, array in example._asdict().items():
                with archive.open(f"{number:06d}.{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)


class ExampleFiles:
    """Examples in files, loaded one by one. Raises CloudError without any, FormatError for damaged files."""

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
            raise FormatError(
                f"{path} cannot be read ({error}); remove that file and run the same command again"
            ) from error
        return Example(planes, target, meta)

    def spread(self, most: int) -> list[int]:
        """Return indices of at most ``most`` examples, evenly spread over all."""
        return [int(i) for i in np.linspace(0, len(self) - 1, min(len(self), most))]
