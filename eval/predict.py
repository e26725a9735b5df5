"""A trained network at work: the person's crop in, part labels over the depth image out."""

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.crop import SIZE, crop_around, normalize, person_of
from annotate.label import WINDOW_C, Run, run
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES
from annotate.person import PersonMask, extract_person
from annotate.segment import Segmentation
from annotate.store import LabelSet
from sensors.errors import FormatError
from sensors.source import FrameSource
from synth.dataset import sha256

SHIPPED_WEIGHTS = Path(str(files("eval").joinpath("weights", "compact.onnx")))
MAX_WEIGHT_BYTES = 1_000_000_000


class Network:
    """An exported network, run by ONNX Runtime on the CPU. Loading executes no code from the file.

    Raises FormatError when the file is no network of this kind: (B, 1, 212, 212) -> (B, 12, 212, 212).
    """

    def __init__(self, path: Path = SHIPPED_WEIGHTS) -> None:
        try:
            if path.stat().st_size > MAX_WEIGHT_BYTES:
                raise FormatError(
                    f"weights {path} are larger than {MAX_WEIGHT_BYTES} bytes; give an exported network"
                )
            self._session = onnxruntime.InferenceSession(
                path.read_bytes(), providers=["CPUExecutionProvider"]
            )
        except OSError as error:
            raise FormatError(
                f"weights {path} cannot be read ({error.strerror}); give an .onnx file"
            ) from error
        except Exception as error:  # ONNX Runtime's own errors share no public base
            raise FormatError(
                f"weights {path} are no ONNX network ({type(error).__name__}); export it again"
            ) from error
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if len(inputs) != 1 or inputs[0].shape[1:] != [1, SIZE, SIZE] or not outputs:
            raise FormatError(
                f"weights {path} take {[i.shape for i in inputs]}; give a network for (B, 1, 212, 212)"
            )
        if outputs[0].shape[1:] != [N_CLASSES, SIZE, SIZE]:
            raise FormatError(
                f"weights {path} give {outputs[0].shape}; give a network of {N_CLASSES} classes"
            )
        self._input = inputs[0].name
        self.sha256 = sha256(path)

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
    window_c: tuple[float, float] = WINDOW_C,
) -> Run:
    """Extract the person of every frame of a source and label it by the network; resumes."""

    def one(cloud: ThermalCloud) -> tuple[Segmentation, PersonMask]:
        person = extract_person(cloud, window_c)
        return network.segment(cloud.depth_mm, person.mask), person

    return run(
        source, {"predict": {"weights": network.sha256, "window_c": list(window_c)}}, out, one, progress
    )


def predict_labels(labels: LabelSet, network: Network, out: Path, progress: Callable[[int], None]) -> Run:
    """Label the persons of an existing label set again, by the network, within the same outlines; resumes."""
    info = {"source": labels.info.get("source", ""), "steps": {"predict": {"weights": network.sha256}}}
    predicted = LabelSet.resume(out, labels.intrinsics, info)
    for frame_id in labels.frame_ids:
        if frame_id not in predicted:
            frame = labels.read(frame_id)
            result = network.segment(frame.depth_mm, person_of(frame.parts))
            predicted.write(
                FrameLabels(
                    frame_id,
                    frame.depth_mm,
                    result.parts,
                    result.confidence.astype(np.float32),
                    subject=frame.subject,
                    notes={"notes": list(result.notes)},
                )
            )
        progress(1)
    return Run(predicted, ())
