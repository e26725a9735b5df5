"""Make the README's pictures: python docs/pictures.py. Needs the virtual rig and the shipped network."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.fuse import Fuser
from annotate.labels import FrameLabels
from annotate.person import extract_person
from annotate.segment import segment
from eval.predict import Network
from eval.report.gallery import make_frame
from synth.body import shipped_bodies
from synth.body_picture import save_picture
from synth.rig import VirtualRig, truth_labels

IMAGES = Path(__file__).parent / "images"
SUBJECTS = 4
GAP = 6
COLUMNS = ("Thermal cloud", "Extracted depth", "Target labels", "Predicted labels")


def frame_picture() -> NDArray[np.uint8]:
    """One row a subject: thermal cloud, depth, truth, parts from the suit, parts from the network (RGB)."""
    rig, network = VirtualRig(SUBJECTS, SUBJECTS, "normal", 12), Network()
    fuser = Fuser(rig.calibration)
    rows = []
    for frame, known in rig.with_truth():
        cloud = fuser.fuse_frame(frame)
        truth, person = truth_labels(frame, known), extract_person(cloud).mask
        suit = FrameLabels(truth.frame_id, truth.depth_mm, segment(cloud, person, rig.suit).parts)
        net = FrameLabels(truth.frame_id, truth.depth_mm, network.segment(cloud.depth_mm, person).parts)
        by_suit, by_net = (make_frame(truth, labels, cloud).columns for labels in (suit, net))
        rows.append(np.hstack([_framed(by_suit[k]) for k in COLUMNS] + [_framed(by_net[COLUMNS[-1]])]))
    return np.vstack(rows)


def _framed(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.pad(image, ((GAP, 0), (GAP, 0), (0, 0)), constant_values=255)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    save_picture(IMAGES / "bodies.png", shipped_bodies())
    cv2.imwrite(str(IMAGES / "frame.png"), frame_picture()[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
