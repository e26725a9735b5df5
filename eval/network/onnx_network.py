"""Exported network (ONNX) that labels the parts of a person."""

import hashlib
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.crop import SIZE, Crop, nearest_seen, network_crop, normalize
from annotate.labelset.images import Probabilities
from annotate.onnx_graph import with_outputs
from annotate.onnx_session import REFINEMENT, WITHOUT, onnx_session, scheme_in_metadata
from annotate.parts import PAPER
from annotate.posture import POSTURES
from annotate.scheme.scheme import BACKGROUND, Scheme
from annotate.scheme_network import SchemeNetwork
from annotate.segmentation.segmented_person import Segmentation
from eval.architecture.kinds import Kinds
from eval.network.body_state import BodyState
from eval.network.flip_averaging import CELL_OUTPUTS, averaged, flipped_back, mean_of_factors
from eval.network.joints.joint_correction import corrected_joints
from eval.network.joints.region_places import has_regions, region_places
from eval.scores.joint_visibility import VISIBILITIES
from eval.scores.joints import N_JOINTS
from sensors.errors import FormatError, Setting, one_line
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics

SHIPPED_WEIGHTS = Path(str(files("eval").joinpath("weights", "compact.onnx")))
MAX_WEIGHT_BYTES = 1_000_000_000  # of a network's file, read whole; the paper's has 540 MB
ROUNDING = 2 / 255  # of a probability, which some networks compute as a product of two in eight bits
AT_ONCE = min(4, os.cpu_count() or 1)  # crops at once, a thread each: threads that share a crop wait
BODY_OUTPUTS = {"facing": (2,), "posture": (len(POSTURES),), "joints": (N_JOINTS, 3)}
JOINT_OUTPUTS = {"joint_sd": (N_JOINTS, 2), "joint_state": (N_JOINTS, len(VISIBILITIES))}
"""Outputs of networks from release 0.4, beside ``BODY_OUTPUTS``."""
FACTORED = (*CELL_OUTPUTS, *BODY_OUTPUTS, *JOINT_OUTPUTS)
"""Outputs of networks with factors of the probabilities, which are computed faster."""
Image = tuple[UInt16, Bool]
"""Depth in millimetres and the person's pixels, both (h, w)."""


class OnnxNetwork(SchemeNetwork):
    """Exported network on the CPU; loading executes no code from the file.

    sha256: hash of the file. flip: average the outputs for an image and its flip (docs/adr/0024), which takes
    twice as long. The network, in any precision, gives probabilities (B, K, 212, 212) for (B, 1, 212, 212),
    the background first, then the parts by id. It may also give ``facing``, ``posture`` and ``joints`` as in
    `NetworkOutput`, and with these ``joint_sd`` and ``joint_state``, the latter as probabilities.

    unrefined: True for a file that names its labels better without refinement. own: scheme of the classes,
    named in the file. A file that names none is of ``scheme`` where the number of classes is the same, else
    of ``paper``. scheme: of the labels, ``own`` or by ``in_scheme``. Raises FormatError for a file that is
    not such a network, or that keeps its tensors in further files.
    """

    def __init__(
        self, path: Path = SHIPPED_WEIGHTS, *, flip: bool = True, scheme: Scheme | None = None
    ) -> None:
        data = read_bounded(path, MAX_WEIGHT_BYTES, "give an exported network (.onnx)")
        if not data:
            raise FormatError(f"weights {path} are empty; give an exported network (.onnx)")
        try:
            named_scheme, (trial, *body) = self._tried(data)
        except FormatError as error:
            raise FormatError(f"weights {path}: {error}") from error
        except Exception as error:  # ONNX Runtime's own errors share no public base
            text = one_line(str(error))[:150] or "no reason is given"
            why = "it keeps tensors in other files" if "xternal" in text else text
            raise FormatError(
                f"weights {path} are not a network for (B, 1, {SIZE}, {SIZE}) ({why}); export again"
            ) from error
        schemes = [named_scheme] if named_scheme else [scheme or PAPER, PAPER]
        fitting = [one for one in schemes if trial.shape == (2, len(one.class_ids), SIZE, SIZE)]
        if not fitting:
            other = "" if named_scheme or scheme else ", or name the scheme of its classes"
            raise FormatError(
                f"weights {path} output {trial.shape} for two crops; give a network of "
                f"{len(schemes[0].class_ids)} classes (scheme {schemes[0].name!r} and the background) at "
                f"{SIZE}x{SIZE}{other}",
                *((Setting.SCHEME,) if other else ()),
            )
        self.own = self.scheme = fitting[0]
        if not ((trial >= 0).all() and np.abs(trial.sum(axis=1) - 1).max() < ROUNDING * trial.shape[1]):
            raise FormatError(
                f"weights {path} do not give probabilities; export the network with its softmax"
            )
        shapes = [(2, *(BODY_OUTPUTS | JOINT_OUTPUTS)[name]) for name in self._body]
        if [values.shape for values in body] != shapes:
            raise FormatError(f"weights {path} give {self._body} of other shapes than {shapes}; export again")
        self.sha256, self._flip = hashlib.sha256(data).hexdigest(), flip

    def _tried(self, data: bytes) -> tuple[Scheme | None, list[Float32]]:
        """Load a network; return the scheme that its file names, and its outputs for two crops.

        A file's declaration of its inputs and outputs may be wrong. Raises ValueError for outputs of wrong
        shapes.
        """
        crops = np.full((2, SIZE, SIZE), 0.5, np.float32)
        for file in (with_outputs(data, FACTORED), data):
            named = self._load(file)
            try:
                return named, self._outputs(crops, flip=False)
            except ValueError:
                if self._kinds is None:
                    raise
        raise ValueError("factors of an unknown scheme's classes")

    def _load(self, file: bytes) -> Scheme | None:
        """Load a network; return the scheme that its file names."""
        self._session = onnx_session(file)
        depth = self._session.get_inputs()[0]
        outputs = {output.name for output in self._session.get_outputs()}
        wanted = BODY_OUTPUTS | (JOINT_OUTPUTS if outputs >= set(JOINT_OUTPUTS) else {})
        self._body = list(wanted) if outputs >= set(BODY_OUTPUTS) else []
        self._input, self._float = depth.name, np.float16 if "float16" in depth.type else np.float32
        metadata = self._session.get_modelmeta().custom_metadata_map
        named, self.unrefined = scheme_in_metadata(metadata), metadata.get(REFINEMENT) == WITHOUT
        # The exporter names every scheme but ``paper``.
        self._kinds = Kinds.of(named or PAPER) if outputs == set(FACTORED) else None
        return named

    def probabilities(self, crops: Float32) -> Float32:
        """Return class probabilities (B, K, 212, 212), in ``scheme``, of normalised crops (B, 212, 212)."""
        return np.stack([self.merged(planes) for planes in self.outputs(crops)[0]])

    def outputs(self, crops: Float32) -> list[Float32]:
        """Return probabilities of the own classes of normalised crops (B, 212, 212), then facing, posture,
        joints, their deviations and visibility if the network gives them.
        """
        return self._outputs(crops, flip=self._flip)

    def _outputs(self, crops: Float32, *, flip: bool) -> list[Float32]:
        """Return the outputs for normalised crops (B, 212, 212), with or without test-time augmentation."""
        images = np.concatenate([crops, crops[..., ::-1]]) if flip else crops
        each = self._each(images)
        groups = [each[i :: len(crops)] for i in range(len(crops))]
        return _joined([self._mean(crop, outputs) for crop, outputs in zip(crops, groups, strict=True)])

    def _mean(self, crop: Float32, outputs: list[list[Float32]]) -> list[Float32]:
        """Return the mean of the outputs for a crop (212, 212), and for its flip if there are two."""
        if self._kinds is not None:
            return mean_of_factors(crop, outputs, self._kinds)
        if len(outputs) == 1:
            return outputs[0]
        twins = self.own.twin_classes
        return averaged(outputs[0], flipped_back(outputs[1], twins), twins)

    def _each(self, crops: Float32) -> list[list[Float32]]:
        """Return the outputs for each crop, as for one crop, without test-time augmentation."""
        first = [self._session.get_outputs()[0].name] if self._kinds is None else list(CELL_OUTPUTS)
        names = [*first, *self._body]

        # One crop at a time: products of matrices round otherwise with other crops beside it.
        def run(crop: Float32) -> list[Float32]:
            outputs = self._session.run(names, {self._input: crop[None, None].astype(self._float)})
            return [output.astype(np.float32, copy=False) for output in outputs]

        if len(crops) == 1:
            return [run(crops[0])]
        with ThreadPoolExecutor(AT_ONCE, "network") as threads:
            return list(threads.map(run, crops))

    @property
    def has_joints(self) -> bool:
        """Return whether the network gives facing, posture and joints."""
        return bool(self._body)

    def body_state(
        self, crop: Crop, image: Image, outputs: Sequence[Float32], planes: Float32, camera: Intrinsics | None
    ) -> BodyState:
        """Return the state from the outputs for a crop, as ``BodyState.of``, with corrected joints.

        planes: (K, 212, 212), probabilities of the own classes. camera: of the image, None = uncorrected.
        """
        state = BodyState.of(crop, image, tuple(outputs))
        if camera is None or not has_regions(self.own):
            return state
        return corrected_joints(state, camera, region_places(crop, image, planes, self.own))

    def segment(
        self, depth_mm: UInt16, person: Bool, camera: Intrinsics | None = None, *, probabilities: bool = False
    ) -> Segmentation:
        """Label the person of a depth image; both (h, w), see ``segment_all``."""
        return self.segment_all([(depth_mm, person)], [camera], probabilities=probabilities)[0]

    def segment_all(
        self,
        images: Sequence[Image],
        cameras: Sequence[Intrinsics | None],
        *,
        probabilities: bool = False,
    ) -> list[Segmentation]:
        """Label the persons of depth images of any sizes: each pixel with depth gets a body part.

        An image of 212 x 212 is treated as a crop. cameras: of the images' own pixels, without distortion;
        None leaves an image's joints uncorrected. probabilities: keep the probabilities of all classes. The
        result for an image is bit-identical in any batch.
        """
        masks = [person & (depth_mm > 0) for depth_mm, person in images]
        results = [self._unlabelled(mask.shape) for mask in masks]
        there = [i for i, mask in enumerate(masks) if mask.any()]
        if not there:
            return results
        crops = [network_crop(masks[i]) for i in there]
        depths = [
            normalize(crop.cut(images[i][0], 0), crop.cut(masks[i], False))
            for i, crop in zip(there, crops, strict=True)
        ]
        planes, *body = self.outputs(np.stack(depths))
        for k, (i, crop) in enumerate(zip(there, crops, strict=True)):
            state = None
            if body:
                outputs = tuple(values[k] for values in body)
                state = self.body_state(crop, (images[i][0], masks[i]), outputs, planes[k], cameras[i]).note()
            own = self.merged(planes[k])
            parts, confidence = _pasted(crop, depths[k] > 0, own, masks[i])
            kept = Probabilities(crop, self._by_id(own)) if probabilities else None
            parts = self.scheme.class_ids[parts]
            results[i] = Segmentation(
                parts, confidence, probabilities=kept, bearing=state, scheme=self.scheme
            )
        return results

    def _by_id(self, planes: Float32) -> Float32:
        """Return probabilities (n, h, w) by part id from (K, h, w) by class; unused ids have 0."""
        by_id = np.zeros((self.scheme.n_classes, *planes.shape[1:]), np.float32)
        by_id[self.scheme.class_ids] = planes
        return by_id

    def _unlabelled(self, shape: tuple[int, ...]) -> Segmentation:
        nothing, why = np.full(shape, BACKGROUND, np.uint8), ("no person: nothing to label",)
        return Segmentation(nothing, np.zeros(shape, np.float32), why, scheme=self.scheme)


def _joined(each: list[list[Float32]]) -> list[Float32]:
    """Return the outputs of all crops, joined; a single crop's outputs are not copied."""
    return each[0] if len(each) == 1 else [np.concatenate(outputs) for outputs in zip(*each, strict=True)]


def _pasted(crop: Crop, seen: Bool, planes: Float32, mask: Bool) -> tuple[UInt8, Float32]:
    """Return classes and confidence, both (h, w), of a mask's pixels from the crop's probabilities.

    seen: pixels of the crop with depth. planes: (K, 212, 212). Background is not a candidate, because the
    mask already separates the person.
    """
    best, certain = _likeliest(planes.reshape(len(planes), -1))
    # A smaller crop drops pixels: at a rim the crop's pixel for one of the person may show the room.
    nearest = nearest_seen(seen)
    best = crop.paste(best[nearest], mask.shape, BACKGROUND)
    certain = crop.paste(certain[nearest], mask.shape, 0.0)
    best[~mask], certain[~mask] = BACKGROUND, 0.0
    return best, certain


@njit(cache=True, nogil=True)
def _likeliest(planes: Float32) -> tuple[UInt8, Float32]:
    """Return the likeliest class (n,) other than background, and its probability.

    planes: (K, n), by class. Of equal probabilities the lowest class is returned.
    """
    best, certain = np.ones(planes.shape[1], np.uint8), planes[1].copy()
    for k in range(2, planes.shape[0]):
        for i in range(planes.shape[1]):
            above = planes[k, i] > certain[i]
            best[i] = np.uint8(k) if above else best[i]
            certain[i] = planes[k, i] if above else certain[i]
    return best, certain
