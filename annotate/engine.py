"""The labelling engine as data: which of its steps make labels, and the fitted weights that they use."""

import hashlib
from dataclasses import dataclass, field, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, Float64
from sensors.errors import FormatError
from sensors.files.atomic import replacing
from sensors.files.npz import load_arrays


@dataclass(frozen=True)
class Steps:
    """Steps of the engine that run. Without one, the others still run: `docs/ablation.md` measures each."""

    second_look: bool = True
    """The network reads supervoxels once more. Without: the labels stay as the suit's rules read them."""
    tidying: bool = True
    """Islands are given to what surrounds them. Without: islands stay."""
    color_refit: bool = True
    """The suit's colours are fitted to the frame. Without: no colour learns from the frame."""
    joint_reading: bool = True
    """Patches are read as one body in one light. Without: each by its own colour, in white light."""
    patch_belief: bool = True
    """Evidence of a supervoxel's part by its patch. Without: every part is as likely by the patch."""
    supervoxels: bool = True
    """Points are pooled in supervoxels. Without: every point is one of its own."""
    part_tree: bool = True
    """Supervoxels are joined over the body's part tree. Without: each is read by itself."""
    skin_warmth: bool = True
    """Evidence of bare and of clothed parts by temperature. Without: by colours alone."""
    sleeves: bool = True
    """Bare skin belongs to the sleeve that it grows out of. Without: its side follows from place alone."""
    frame_before: bool = True
    """The suit is read with the parts of the frame before. Without: only the second look has them."""
    fine_borders: bool = True
    """Borders are refined pixel by pixel. Without: they follow the supervoxels."""
    suit_for_person: bool = True
    """Evidence of the person by the suit's colours. Without: by warmth and depth alone."""
    join_halves: bool = True
    """What a laptop cuts in two is one person. Without: it stays cut."""
    room_planes: bool = True
    """Walls, floor and table tops are found and left out. Without: warmth and depth jumps decide."""
    room_colors: bool = True
    """Evidence of the room by the colours around the person. Without: by warmth and depth jumps."""

    def left_out(self) -> list[str]:
        """Names of the steps that do not run."""
        return [step.name for step in fields(self) if not getattr(self, step.name)]


@dataclass(frozen=True)
class Weights:
    """Arrays that `annotate-cloud train-labels` fits.

    network: weights of `annotate.second_look.network.GraphNetwork`, float32, by field. confidence: float64
    (20,), weights of `annotate.segmentation.confidence.FEATURES` and, last, the intercept. clothed: float64
    (2, 7), weights of `annotate.person.clothed_mask.Clue` inside and outside the mask found without the suit.
    touch: float64 (2,), weights of a patch's own log odds and of those that touch it.
    """

    network: dict[str, Float32]
    confidence: Float64
    clothed: Float64
    touch: Float64

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """All arrays by their names in the file."""
        return {**self.network, **{name: getattr(self, name) for name in REGRESSIONS}}

    def save(self, path: Path) -> None:
        """Write the weights file, which ``load_weights`` reads."""
        with replacing(path) as unfinished, unfinished.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **self.arrays())

    def sha256(self) -> str:
        """Digest of all numbers."""
        digest = hashlib.sha256()
        for name, array in sorted(self.arrays().items()):
            digest.update(f"{name} {array.shape}".encode() + array.tobytes())
        return digest.hexdigest()


NETWORK = ("middle", "spread", "enter", "rounds", "leave")
"""Names of the network's arrays in the file."""
REGRESSIONS = ("confidence", "clothed", "touch")
"""Names of the other arrays."""


WEIGHTS_BYTES = 1 << 26
"""Size that a weights file may unpack to; the shipped one takes 0.3 MB."""
REMEDY = "give a file that `annotate-cloud train-labels` wrote"


@cache
def shipped_weights() -> Weights:
    """The weights that come with the package; their model card is `annotate/weights.md`."""
    with files("annotate").joinpath("weights.npz").open("rb") as file:
        return weights_of(dict(np.load(file, allow_pickle=False)))


def load_weights(path: Path) -> Weights:
    """A weights file of `annotate-cloud train-labels`. Raises FormatError where it is none."""
    arrays = load_arrays(path, WEIGHTS_BYTES, REMEDY)
    shipped = shipped_weights().arrays()
    for name, like in shipped.items():
        given = arrays.get(name)
        if given is None or given.dtype != like.dtype or not _fits(name, given.shape, like.shape):
            raise FormatError(f"{path} has no array {name!r} as labelling needs it; {REMEDY}")
        if not np.isfinite(given).all():
            raise FormatError(f"{path}: {name!r} holds numbers that are not finite; {REMEDY}")
    return weights_of(arrays)


def _fits(name: str, shape: tuple[int, ...], like: tuple[int, ...]) -> bool:
    """Whether an array has the shape of the shipped one; networks may have more message rounds."""
    return shape[1:] == like[1:] and (shape[:1] == like[:1] or name == "rounds")


def weights_of(arrays: dict[str, NDArray[np.generic]]) -> Weights:
    """Weights from the arrays of a weights file. Raises KeyError where one is missing."""
    network = {name: np.asarray(arrays[name], np.float32) for name in NETWORK}
    return Weights(network, *(np.asarray(arrays[name], np.float64) for name in REGRESSIONS))


@dataclass(frozen=True)
class Engine:
    """Engine that makes labels: the steps that run, and their weights."""

    steps: Steps = Steps()
    weights: Weights = field(default_factory=shipped_weights)

    def note(self) -> dict[str, Any]:
        """Note in a label set about an engine that is not the shipped one."""
        note: dict[str, Any] = {}
        if without := self.steps.left_out():
            note["without"] = without
        if self.weights is not shipped_weights():
            note["weights_sha256"] = self.weights.sha256()
        return note
