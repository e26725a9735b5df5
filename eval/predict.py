"""A trained network at work: the person's crop in, part labels over the depth image out."""

import hashlib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.crop import SIZE, crop_around, normalize, person_of
from annotate.label import Run, check_same, finished, run
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES
from annotate.person import PersonMask, extract_person
from annotate.segment import Segmentation
from annotate.store import LabelSet
from sensors.errors import FormatError
from sensors.source import FrameSource

SHIPPED_WEIGHTS = Path(str(files("eval").joinpath("weights", "compact.onnx")))
MAX_WEIGHT_BYTES = 1_000_000_000


class Network:
    """An exported network, run by ONNX Runtime on the CPU. Loading executes no code from the file.

    Raises FormatError when the file is no network of this kind: (B, 1, 212, 212) -> (B, 12, 212, 212).
    """

    def __init__(self, path: Path = SHIPPED_WEIGHTS) -> None:
        try:
            data = path.read_bytes() if path.stat().st_size <= MAX_WEIGHT_BYTES else b""
        except OSError as error:
            raise FormatError(
                f"weights {path} cannot be read ({error.strerror}); give an .onnx file"
            ) from error
        if not data:
            raise FormatError(
                f"weights {path} are empty or larger than {MAX_WEIGHT_BYTES} bytes; give an exported network"
            )
        try:
            self._session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
            self._input = self._session.get_inputs()[0].name
            # A trial run: what a file declares of its inputs and outputs need not be true.
            shapes = [self.probabilities(np.zeros((n, SIZE, SIZE), np.float32)).shape for n in (1, 2)]
        except Exception as error:  # ONNX Runtime's own errors share no public base
            raise FormatError(
                f"weights {path} are no network for (B, 1, {SIZE}, {SIZE}) ({type(error).__name__}); "
                "export it again"
            ) from error
        if shapes != [(n, N_CLASSES, SIZE, SIZE) for n in (1, 2)]:
            raise FormatError(
                f"weights {path} give {shapes[0]}; give a network of {N_CLASSES} classes at {SIZE}x{SIZE}"
            )
        self.sha256 = hashlib.sha256(data).hexdigest()

    def probabilities(self, crops: NDArray[np.float32]) -> NDArray[np.float32]:
        """Normalised crops (B, 212, 212) -> class probabilities (B, 12, 212, 212)."""
        return np.asarray(self._session.run(None, {self._input: crops[:, None]})[0], np.float32)

    def segment(self, depth_mm: NDArray[np.uint16], person: NDArray[np.bool_]) -> Segmentation:
        """Label the person (bool (h, w)) of a depth image: every pixel of it gets a body part."""
        mask = person & (depth_mm > 0)
        if not mask.any():
            parts = np.full(mask.shape, BACKGROUND, np.uint8)
            return Segmentation(parts, np.zeros(mask.shape, np.float32), ("no person: nothing to label",))
        crop = crop_around(mask)
        depth = normalize(crop.cut(depth_mm, 0), crop.cut(mask, False))
        # The extraction has decided what is person: background is no answer there.
        body = self.probabilities(depth[None])[0, 1:]
        best = crop.paste((body.argmax(axis=0) + 1).astype(np.uint8), mask.shape, BACKGROUND)
        certain = crop.paste(body.max(axis=0), mask.shape, 0.0)
        return Segmentation(np.where(mask, best, BACKGROUND).astype(np.uint8), np.where(mask, certain, 0))


def predict_source(
    source: FrameSource,
    network: Network,
    out: Path,
    progress: Callable[[int], None],
    window_c: tuple[float, float] | None = None,
) -> Run:
    """Extract the person of every frame of a source and label it by the network; resumes."""

    def one(cloud: ThermalCloud, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        person = extract_person(cloud, window_c, before)
        return network.segment(cloud.depth_mm, person.mask), person

    return run(
        source,
        {"predict": {"weights": network.sha256, "window_c": list(window_c) if window_c else None}},
        out,
        one,
        progress,
    )


def predict_labels(labels: LabelSet, network: Network, out: Path, progress: Callable[[int], None]) -> Run:
    """Label the persons of an existing label set again, by the network, within the same outlines; resumes."""
    info = {"source": labels.info.get("source", ""), "steps": {"predict": {"weights": network.sha256}}}
    predicted, failed = LabelSet.resume(out, labels.intrinsics, info), []
    done = set(predicted.frame_ids)
    for frame_id in labels.frame_ids:
        try:
            frame = labels.read(frame_id)
        except FormatError as error:
            failed.append((frame_id, str(error)))
        else:
            if frame_id in done:
                check_same(predicted, frame_id, frame.depth_mm)
            else:
                predicted.write(_predicted(frame, network))
        progress(1)
    return finished(predicted, failed)


def _predicted(frame: FrameLabels, network: Network) -> FrameLabels:
    result = network.segment(frame.depth_mm, person_of(frame.parts))
    notes = {"notes": list(result.notes)}
    return FrameLabels(
        frame.frame_id, frame.depth_mm, result.parts, result.confidence, subject=frame.subject, notes=notes
    )
