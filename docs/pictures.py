"""Make the README's pictures: python docs/pictures.py. Needs the virtual rig and the shipped network."""

from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cloud.fuse import Fuser
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller
from annotate.parts import PAPER_PARTS, palette_rgb
from annotate.segmentation.suit_network import shipped_suit_network
from eval.network.onnx_network import OnnxNetwork
from eval.report.gallery import cloud_picture, make_frame
from synth.body.body import shipped_bodies
from synth.body.body_picture import picture, save_picture
from synth.images.dataset_page import contact_sheet
from synth.images.presets import PRESETS, sample
from synth.rig.difficulty import DIFFICULTIES
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import VirtualRig

IMAGES = Path(__file__).parent / "images"
SUBJECTS = 4
GAP = 6
DIFFICULTIES_SEED, PEOPLE_SEED = 140, 7
VIEW_PX = (270, 200)
OTHERS_RGB = (120, 120, 120)
COLUMNS = ("Thermal cloud", "Extracted depth", "Target labels", "Predicted labels")


def frame_picture() -> NDArray[np.uint8]:
    """One row a subject: thermal cloud, depth, truth, parts from the suit, parts from the network (RGB)."""
    rig, network = VirtualRig(SUBJECTS, SUBJECTS, "normal", 12), OnnxNetwork()
    fuser, labeller = Fuser(rig.calibration), SuitLabeller(rig.suit, shipped_suit_network())
    rows = []
    for frame, known in rig.with_truth():
        cloud = fuser.fuse_frame(frame)
        truth, survey = truth_labels(frame, known), labeller.detect(cloud)
        suit = FrameLabels(truth.frame_id, truth.depth_mm, labeller.label(survey)[0].parts)
        person = survey.persons.person().mask
        net = FrameLabels(truth.frame_id, truth.depth_mm, network.segment(cloud.depth_mm, person).parts)
        by_suit, by_net = (
            make_frame(truth, labels, partial(cloud_picture, cloud)).columns for labels in (suit, net)
        )
        rows.append(np.hstack([_framed(by_suit[k]) for k in COLUMNS] + [_framed(by_net[COLUMNS[-1]])]))
    return np.vstack(rows)


def difficulties_picture() -> NDArray[np.uint8]:
    """One row a difficulty: colour, temperature (18 to 36 C), depth (1 to 4 m), true parts; RGB."""
    rows = []
    for difficulty in DIFFICULTIES:
        frame, known = next(VirtualRig(1, 1, difficulty, DIFFICULTIES_SEED).with_truth())
        color = frame.decode_color()
        assert color is not None and frame.thermal_c is not None
        depth_m = np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)
        parts = palette_rgb()[PAPER_PARTS[known.regions]]
        parts[known.persons > 1] = OTHERS_RGB
        views = (
            color,
            _mapped(frame.thermal_c, 18, 36, cv2.COLORMAP_INFERNO),
            _mapped(depth_m, 4, 1, cv2.COLORMAP_VIRIDIS),
            parts,
        )
        rows.append(np.hstack([_framed(_scaled(view)) for view in views]))
    return np.vstack(rows)


def people_picture() -> NDArray[np.uint8]:
    """Parts above depth of 24 images of the preset ``people``, each of another person; RGB."""
    preset = PRESETS["people"]
    return contact_sheet([sample(preset, PEOPLE_SEED, i * preset.each) for i in range(24)])


def _mapped(values: NDArray[np.floating], low: float, high: float, colors: int) -> NDArray[np.uint8]:
    """Values (h, w) as colours between low and high; black where there is none."""
    share = np.clip((np.nan_to_num(values) - low) / (high - low), 0, 1)
    image = cv2.applyColorMap((255 * share).astype(np.uint8), colors)[..., ::-1].copy()
    image[np.isnan(values)] = 0
    return image


def _scaled(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The middle of a view, scaled to ``VIEW_PX``: photographs are smoothed, parts keep their colours."""
    width, height = VIEW_PX
    across = min(image.shape[1], round(image.shape[0] * width / height))
    down = min(image.shape[0], round(across * height / width))
    top, left = (image.shape[0] - down) // 2, (image.shape[1] - across) // 2
    middle = image[top : top + down, left : left + across]
    mode = cv2.INTER_AREA if down > 2 * height else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(middle, VIEW_PX, interpolation=mode), np.uint8)


def _framed(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.pad(image, ((GAP, 0), (GAP, 0), (0, 0)), constant_values=255)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    save_picture(IMAGES / "bodies.png", picture(shipped_bodies()))
    difficulties = str(IMAGES / "difficulties.png")
    cv2.imwrite(difficulties, difficulties_picture()[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    cv2.imwrite(str(IMAGES / "frame.png"), frame_picture()[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    people = str(IMAGES / "people.png")
    cv2.imwrite(people, people_picture()[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
