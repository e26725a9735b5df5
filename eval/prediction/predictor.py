"""Prediction of depth images in memory: a predictor for one camera, and its results."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, Float64, UInt8, UInt16
from annotate.frame_labels import FrameLabels
from annotate.label_recording import label_cloud
from annotate.labelset.label_set import as_read
from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import load_scheme
from annotate.segmentation.labels_of_frame import labels_of
from eval.network.body_state import BodyState, body_state_notes, joint_quality, joint_row
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.predict import PredictOptions, fits
from eval.network.predict_source import NetworkLabeller
from eval.network.refine import shipped_refinement_network
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import mm_from_units
from sensors.rig.rig_calibration import RigCalibration

SUBJECT = 1  # number of the subject among the people
LEAST_MM = 100  # farthest reading of an image in millimetres; below it the image is in metres
KEPT = 4  # predictors of ``predict`` kept, one for each camera and options; untuned


@dataclass(frozen=True, eq=False)
class Person:
    """Person in one depth image.

    joints_mm: float64 (3,) by name: millimetres in the camera's frame, x right, y down, z forward. Left and
    right are the person's own; hidden joints are estimates. facing_deg: azimuth of the camera about the
    trunk, 0 in front of the chest, 90 on the person's left. posture: "" where it is unclear. posture_sure,
    facing_sure: [0, 1]. support: "floor", "furniture", or "" where the image does not show the support.
    joint_sd_mm: standard deviation by name. joint_visibility: "visible", "hidden" or "outside" by name. Both
    are empty if the network does not give them.
    """

    joints_mm: dict[str, Float64]
    posture: str
    posture_sure: float
    facing_deg: float
    facing_sure: float
    support: str
    joint_sd_mm: dict[str, float] = field(default_factory=dict)
    joint_visibility: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, state: BodyState, camera: Intrinsics) -> "Person":
        """Return the person of a body state. camera: of the undistorted depth image."""
        joints = {name: np.array(xyz) for name, xyz in joint_row(state.joints_mm(camera)).items()}
        sure = round(float(state.posture.max()), 3)
        quality = joint_quality(state.joints_sd_mm(camera), state.joint_visibility)
        return cls(joints, state.name, sure, state.facing_deg, state.facing_sure, state.support, **quality)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Body parts and people of one depth image (h, w).

    labels: uint8 (h, w), ids of ``scheme``; 0 = background, 255 = undefined. confidence: float32 (h, w), in
    [0, 1]. persons: uint8 (h, w), number of each pixel's person, 0 = none. people: by number, 1 = the
    subject. depth_mm: uint16 (h, w), lens distortion undone; the other images have its pixels. camera: of
    these pixels. notes: warnings. frame: the labels in the network's scheme.
    """

    labels: UInt8
    confidence: Float32
    persons: UInt8
    people: dict[int, Person]
    scheme: Scheme
    depth_mm: UInt16
    camera: Intrinsics
    notes: tuple[str, ...]
    frame: FrameLabels = field(repr=False)

    @property
    def joints_mm(self) -> dict[str, Float64]:
        """Return the subject's joints by name, float64 (3,); empty without a subject."""
        return self.people[SUBJECT].joints_mm if SUBJECT in self.people else {}

    @property
    def posture(self) -> str:
        """Return the subject's posture; "" without a subject."""
        return self.people[SUBJECT].posture if SUBJECT in self.people else ""

    @property
    def facing_deg(self) -> float:
        """Return the subject's facing in degrees; NaN without a subject."""
        return self.people[SUBJECT].facing_deg if SUBJECT in self.people else float("nan")


class Predictor:
    """Networks loaded for the depth images of one camera; thread-safe.

    scheme: of the labels; a shipped name, a file or a scheme; None = the network's usual one. everybody:
    label all persons. weights: network (.onnx); None = the shipped one. camera: of the undistorted images.
    Raises FormatError for malformed files, or for a scheme that the network cannot give.
    """

    def __init__(
        self,
        camera: Intrinsics,
        *,
        scheme: Scheme | str | Path | None = None,
        everybody: bool = False,
        weights: str | Path | None = None,
    ) -> None:
        self._labeller = labeller_of(as_scheme(scheme), everybody, weights)
        self.scheme = self._labeller.scheme
        self._fuser = self._labeller.fuser(RigCalibration(camera))
        self.camera = self._fuser.camera

    def predict(self, depth_mm: NDArray[Any], before: Prediction | None = None) -> Prediction:
        """Label a depth image (h, w): integers or floats, millimetres along z; 0, NaN = no reading.

        before: prediction for the previous image of a recording, 1/30 s earlier, which keeps the people's
        numbers and sides and steadies their joints.
        Raises CalibrationError for another size than the camera's, FormatError for images that are not depth.
        """
        cloud = self._fuser.fuse(_whole_mm(depth_mm))
        result, person = label_cloud(self._labeller, cloud, as_read(before.frame) if before else None)
        frame = labels_of("", cloud.depth_mm, result, person)
        notes = sorted(body_state_notes(frame.notes).items())
        states = {number: BodyState.from_note(note) for number, note in notes}
        assert frame.confidence is not None and frame.persons is not None
        return Prediction(
            labels=frame.parts,
            confidence=frame.confidence,
            persons=frame.persons,
            people={number: Person.of(state, self.camera) for number, state in states.items() if state},
            scheme=frame.scheme,
            depth_mm=frame.depth_mm,
            camera=self.camera,
            notes=tuple(frame.notes["notes"]),
            frame=frame,
        )


@lru_cache(KEPT)
def kept_predictor(camera: Intrinsics, scheme: Scheme | None, everybody: bool) -> Predictor:
    """Return a predictor with the shipped networks, loaded once for equal arguments."""
    return Predictor(camera, scheme=scheme, everybody=everybody)


def as_scheme(scheme: Scheme | str | Path | None) -> Scheme | None:
    """Return a scheme, or the scheme of a shipped name or a file. Raises FormatError as ``load_scheme``."""
    return load_scheme(scheme) if isinstance(scheme, (str, Path)) else scheme


def labeller_of(scheme: Scheme | None, everybody: bool, weights: str | Path | None) -> NetworkLabeller:
    """Return the labeller of the command ``predict`` for recordings; arguments as in ``Predictor``.

    The depth of the room refines the labels of one person, if the networks give the scheme. A network's file
    may exclude refinement.
    """
    network = OnnxNetwork(Path(weights or SHIPPED_WEIGHTS), scheme=scheme if weights else None)
    alone = PredictOptions(everybody=everybody, scheme=scheme)
    if everybody or network.unrefined:
        return NetworkLabeller(network, alone)
    refined = replace(alone, room_refiner=shipped_refinement_network())
    return NetworkLabeller(network, refined if fits(refined, network) else alone)


def _whole_mm(depth_mm: NDArray[Any]) -> UInt16:
    """Return a depth image uint16 (h, w) in millimetres. Raises FormatError for other images."""
    image = np.asarray(depth_mm)
    if image.ndim != 2 or image.dtype.kind not in "uif":
        raise FormatError(
            f"depth image is {image.dtype} {image.shape}; give numbers of shape (height, width)"
        )
    whole = mm_from_units(image, 1.0)
    if 0 < (farthest := int(whole.max(initial=0))) < LEAST_MM:
        raise FormatError(f"depth image has readings up to {farthest} mm; give millimetres, not metres")
    return whole
