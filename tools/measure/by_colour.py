"""Measure ``label --by colour``: ``python -m tools.measure.by_colour PATH ... [--step N]``.

PATH: an RGB-D recording with ``people.json``, or a session of ``simulate`` with its truth. Every Nth frame.

Recordings: share of the judge's visible joints whose parts are right (``rgbd_tally``), for all joints and for
withheld joints. A third of the joints, drawn at random, is withheld from the labels with landmarks nearby.
Sessions: a simulated witness with errors of the measured size and of twice the size
(``tools.fit.witness_errors``). The line has the mean recall of the parts, the IoU of the person, and the mean
confidence less the share of right pixels.
"""

import argparse
import json
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from annotate.array_types import UInt8
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import PAPER
from annotate.witness.blazepose import NAMES, BlazePose
from annotate.witness.coloured_cloud import ColourFuser
from annotate.witness.person_crop import PersonCrop
from annotate.witness.pose_network import LEAST, PosedPerson, PoseNetwork
from eval.network.colour.colour_labeller import ColourLabeller
from eval.network.onnx_network import OnnxNetwork
from eval.scores.confusion import confusion_matrix, mean_recall, person_iou
from sensors.errors import CloudError
from sensors.importers.open_source import open_source
from sensors.rig.frame import FrameSource
from tools.fit import witness_errors
from tools.fit.witness_errors import WitnessErrors, mask_with_errors
from tools.measure.rgbd_tally import JUDGED, count_labels

THIRD = 4  # of the 13 judged joints
ABOUT = {
    0: range(11),
    **{15 + side: (15 + side, 17 + side, 19 + side, 21 + side) for side in (0, 1)},
    **{27 + side: (27 + side, 29 + side, 31 + side) for side in (0, 1)},
}
"""Landmarks that are withheld with a judged one: face, hands, feet."""


def withheld(image: UInt8) -> list[int]:
    """Return the judged landmarks that are withheld from an image's labels, the same at each call."""
    rng = np.random.default_rng(zlib.crc32(image))
    return sorted(rng.choice(JUDGED, THIRD, replace=False).tolist())


class Withholding(BlazePose):
    """Witness whose withheld landmarks have no visibility."""

    def landmark(self, image: UInt8, crop: PersonCrop, least: float = LEAST) -> PosedPerson | None:
        """Return the person in a crop without the withheld landmarks."""
        person = super().landmark(image, crop, least)
        if person is not None:
            for one in withheld(image):
                person.landmarks[list(ABOUT.get(one, (one,))), 2] = 0
        return person


@dataclass(frozen=True)
class SimulatedWitness:
    """Witness of a session's subjects. people: by the checksum of each colour image."""

    people: dict[int, PosedPerson]
    names = witness_errors.NAMES
    sha256 = "simulated"

    def detect(self, image: UInt8) -> list[PersonCrop]:
        """Return the crop of the image's person."""
        return [person.crop for person in self._found(image)]

    def landmark(self, image: UInt8, crop: PersonCrop, least: float = LEAST) -> PosedPerson | None:
        """Return the image's person, wherever the crop is."""
        return next(iter(self._found(image)), None)

    def _found(self, image: UInt8) -> list[PosedPerson]:
        key = zlib.crc32(image)
        return [self.people[key]] if key in self.people else []


def labelled(
    source: FrameSource, witness: PoseNetwork, step: int
) -> Iterator[tuple[int, UInt8, FrameLabels]]:
    """Yield the index, colour image and labels of every ``step``-th frame of a source."""
    labeller = ColourLabeller(witness, OnnxNetwork(), PAPER)
    fuser = labeller.fuser(source.calibration)
    for frame in islice(source, 0, None, step):
        cloud = fuser.fuse_frame(frame)
        if cloud.rgb is not None:
            labels, person = labeller.label(labeller.detect(cloud), None)
            images = cloud.depth_mm, labels.parts, labels.confidence
            yield frame.index, cloud.rgb, FrameLabels(f"{frame.index:06d}", *images, persons=person.persons)


def of_recording(folder: Path, step: int) -> str:
    """Return the shares of right joints of a recording as a line."""
    source, given = open_source(folder), json.loads((folder / "people.json").read_text())
    texts = [folder.name]
    for name, witness in (("all", BlazePose()), ("withheld", Withholding())):
        n: Counter[str] = Counter()
        for index, rgb, labels in labelled(source, witness, step):
            people = np.array(given[f"{index:06d}"], np.float64).reshape(-1, len(NAMES), 3)
            if name == "withheld":
                hidden = np.setdiff1d(np.arange(len(NAMES)), withheld(rgb))
                people[:, hidden, 2] = 0
            n += count_labels(list(people), labels.parts)
        shares = {key: n[key] / max(n["joints"], 1) for key in ("right", "other_side", "unlabelled")}
        texts.append(f"{name}: " + ", ".join(f"{key} {share:.4f}" for key, share in shares.items()))
        texts[-1] += f" of {n['joints']}"
    return "; ".join(texts)


def simulated(session: Path, errors: WitnessErrors, step: int, size: float) -> SimulatedWitness:
    """Return a witness of a session's subjects. size: factor of the mask's error."""
    source, truth = open_source(session), LabelSet.open(session.with_suffix(".truth"))
    color, pose = source.calibration.color, source.calibration.color_from_depth
    if color is None or pose is None:
        raise CloudError(f"{session} has no colour camera; simulate a rig with one")
    fuser = ColourFuser(source.calibration)
    people, rng = {}, np.random.default_rng(48)
    for frame in islice(source, 0, None, step):
        known, rgb = truth.read(f"{frame.index:06d}"), frame.decode_color()
        joints_m = pose.apply(np.array(known.notes["joints_mm"]) / 1000)
        landmarks = errors.landmarks(joints_m, color, rng)
        own = (known.persons == 1) & (known.depth_mm > 0)
        if rgb is None or not own.any():
            continue
        cloud = fuser.fuse_frame(frame)
        crop = cloud.crop(own)
        if crop is not None:
            mask = mask_with_errors(cloud.surface(own).at_px, crop, rng, size)
            people[zlib.crc32(rgb)] = PosedPerson(landmarks, crop, crop.pasted(mask, color.shape))
    return SimulatedWitness(people)


def of_session(session: Path, step: int) -> str:
    """Return recall, IoU and calibration of a session as a line."""
    source, truth = open_source(session), LabelSet.open(session.with_suffix(".truth"))
    texts = [session.stem]
    for size, errors in ((1.0, WitnessErrors()), (2.0, WitnessErrors().doubled())):
        matrix, sure, same = np.zeros((len(PAPER.class_ids),) * 2), [0.0], [0.0]
        for index, _, labels in labelled(source, simulated(session, errors, step, size), step):
            known = truth.read(f"{index:06d}").parts
            parts = np.where(labels.persons == 1, labels.parts, np.uint8(0))
            matrix = matrix + confusion_matrix(known, parts, PAPER)
            body = PAPER.on_body(known) & PAPER.on_body(parts)
            sure += labels.confidence[body].tolist()
            same += (parts == known)[body].tolist()
        texts.append(
            f"errors x {size:.0f}: recall {float(mean_recall(matrix)):.4f}, "
            f"IoU {float(person_iou(matrix, PAPER)):.4f}, confidence {np.mean(sure) - np.mean(same):+.4f}"
        )
    return "; ".join(texts)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", type=Path, nargs="+")
    parser.add_argument("--step", type=int, default=1)
    options = parser.parse_args()
    for path in options.paths:
        of = of_recording if (path / "people.json").is_file() else of_session
        print(of(path, options.step), flush=True)


if __name__ == "__main__":
    main()
