"""The verb ``train``: train a network on depth images."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from natsort import natsorted
from typer import Argument, Option

from cli.console import Json, Overwrite, check_room, clear, finish, progress, say
from cli.durations import duration
from cli.extras import check_extra, needing
from sensors.errors import CloudError
from sensors.files.atomic import check_there

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn

    from annotate.scheme.scheme import Scheme
    from eval.architecture.networks import NetworkConfig
    from eval.training.calibration.calibration_split import CalibrationSplit
    from eval.training.crops import Crops
    from eval.training.plan import Plan
    from eval.training.processes import ProcessGroup
    from eval.training.resumable_loop import Epoch
    from eval.training.train import Watch

EPOCHS = 12  # passes over all images by default; untuned
PLAN = "plan.json"
"""First file of a training in its folder."""
SHIPPED = Path("shipped")
"""For ``--init``: the shipped network."""
Without = StrEnum(
    "Without", ["mirror", "place", "turn", "noise", "holes", "occluders", "cuts", "borders", "extras"]
)
"""Augmentations that can be left out: the fields of ``eval.training.augment.Augmentation``."""
NetworkName = Literal["compact", "compact-small", "compact-large", "paper", "paper-quarter", "smp"]
RecipeName = Literal["modern", "paper"]
Precision = Literal["float32", "bfloat16"]


@dataclass(frozen=True)
class _Choices:
    """Options of ``train`` that make its plan. Raises CloudError where they exclude each other."""

    network: NetworkName | None
    recipe: RecipeName
    init: Path | None
    without: list[Without] | None
    epochs: int | None
    minutes: float | None
    batch: int | None
    seed: int
    precision: Precision | None

    def __post_init__(self) -> None:
        if self.epochs is not None and self.minutes is not None:
            raise CloudError("--epochs and --minutes exclude each other; give one of them")
        if self.init and self.network:
            raise CloudError(f"{self.init} determines the network; leave out --network {self.network}")

    @property
    def weights(self) -> Path | None:
        """Return the weights file from which to start a training, if any."""
        if self.init != SHIPPED:
            return self.init
        from eval.network.onnx_network import SHIPPED_WEIGHTS

        return SHIPPED_WEIGHTS.with_suffix(".safetensors")

    def plan(self, scheme: "Scheme") -> "tuple[Plan, nn.Module | None]":
        """Return the plan, and the network to start from if any, with the classes of a scheme."""
        from eval.network.weights_file import load_weights
        from eval.training.augment import Augmentation
        from eval.training.expansion import expanded
        from eval.training.plan import ModernRecipe, PaperRecipe, Plan, best_precision

        weights, without = self.weights, self.without or []
        model: nn.Module | None = None
        if weights:
            start, config, known = load_weights(weights)
            model = expanded(start, config, known, scheme)
        else:
            config = _config(self.network or "compact")
        how = Augmentation(**{f.name: f.name not in without for f in fields(Augmentation)})
        kind = PaperRecipe if self.recipe == "paper" else ModernRecipe
        recipe = kind() if self.batch is None else kind(self.batch)
        if weights and isinstance(recipe, ModernRecipe):
            recipe = recipe.continued()
        epochs, precision = self.epochs or EPOCHS, self.precision or best_precision()
        return Plan(config, recipe, how, epochs, self.minutes, self.seed, precision), model


PrecisionName = Annotated[
    Precision,
    Option(
        help="bfloat16 is faster where the processor supports it.",
        show_default="bfloat16 on a GPU that supports it, else float32",
    ),
]


def train(
    data: Annotated[list[Path], Argument(help="Datasets and label sets.")],
    out: Annotated[Path, Option(help="Folder for weights; an interrupted run continues there.")],
    test: Annotated[
        list[Path] | None, Option(help="Dataset or label set to measure on after each epoch; repeatable.")
    ] = None,
    test_images: Annotated[int, Option(min=1, help="Number of test images, evenly spread.")] = 512,
    hold_out: Annotated[
        list[str] | None,
        Option(help="Subject or synthetic body to measure on; no image that shares it is trained on."),
    ] = None,
    network: Annotated[NetworkName | None, Option(help="Architecture.", show_default="compact")] = None,
    recipe: Annotated[
        RecipeName, Option(help="modern: AdamW with one cycle; paper: SGD on a summed loss.")
    ] = "modern",
    init: Annotated[Path | None, Option(help="Weights to start from (.safetensors), or shipped.")] = None,
    scheme: Annotated[
        Path | None, Option(help="Scheme to train on, name or file (TOML).", show_default="the data's")
    ] = None,
    without: Annotated[list[Without] | None, Option(help="Augmentation to leave out; repeatable.")] = None,
    epochs: Annotated[
        int | None, Option(min=1, max=10_000, help="Passes over all images.", show_default="12")
    ] = None,
    minutes: Annotated[
        float | None, Option(min=0.1, callback=duration, help="How long to train, instead of --epochs.")
    ] = None,
    batch: Annotated[
        int | None, Option(min=1, max=1024, help="Images per step.", show_default="32, the paper's 12")
    ] = None,
    seed: Annotated[int, Option(min=0, help="The same seed, data and threads give the same network.")] = 0,
    precision: PrecisionName | None = None,
    workers: Annotated[int, Option(min=0, max=64, help="Processes that prepare images.")] = 0,
    checkpoint_minutes: Annotated[
        float, Option(min=0, callback=duration, help="Minutes between checkpoints in an epoch.")
    ] = 5.0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Train a network; writes weights.onnx, weights.safetensors, history.json. Needs the extra 'train'."""
    started, tests = time.monotonic(), test or []
    choices = _Choices(network, recipe, init, without, epochs, minutes, batch, seed, precision)
    inputs = _checked(data, tests, hold_out, choices)
    parts = _scheme(scheme, [*data, *tests])
    check_room(out, PLAN, overwrite, *inputs)
    with needing("train"):
        from eval.training.processes import ProcessGroup
        from eval.training.train import Data
        from eval.training.train import train as run
    with ProcessGroup.join() as group:
        plan, start = choices.plan(parts)
        split, measured = _crops(data, tests, frozenset(hold_out or []), test_images, parts)
        if group.first:
            _say_unchecked([*data, *tests])
            clear(out, PLAN, overwrite, *inputs)
        crops = Data(split.trained, measured, start, workers, _left_out(split, hold_out or []))
        with _watching(group, out, plan, split.trained, checkpoint_minutes) as watch:
            model, done = run(crops, out, plan, group, watch)
    if group.first:
        say(split.note)
        _finish(_written(out, model, plan, split), done.epochs, started, json)


def _scheme(given: Path | None, paths: list[Path]) -> "Scheme":
    """Return the scheme to train on, which all labels convert to. Raises CloudError where they do not."""
    from annotate.labelset.labelled_frames import open_frames
    from annotate.scheme.merging import conversion_table
    from annotate.scheme.scheme_file import load_scheme
    from eval.training.crops import common_scheme

    opened = [open_frames(path) for path in paths]
    if given is None:
        return common_scheme(opened)
    scheme = load_scheme(str(given))
    for frames in opened:
        conversion_table(frames.scheme, scheme)
    return scheme


def _left_out(split: "CalibrationSplit", hold_out: list[str]) -> tuple[str, ...]:
    """Return the bodies and subjects that are not trained on, in natural order."""
    return tuple(natsorted({*split.bodies, *hold_out}))


def _finish(written: dict[str, Any], epochs: "Sequence[Epoch]", started: float, json: bool) -> None:
    """Print the results of a training. started: reading of ``time.monotonic`` at its start."""
    history, loss = [asdict(epoch) for epoch in epochs], epochs[-1].loss
    seconds = round(time.monotonic() - started, 1)
    result = written | {"epochs": len(history), "loss": loss, "history": history, "seconds": seconds}
    finish(result, json, f"{len(history)} epochs, loss {loss:.4f}, weights in {written['weights']}")


def _checked(
    data: list[Path], tests: list[Path], hold_out: list[str] | None, choices: _Choices
) -> list[Path]:
    """Return the files to train on, to test on and to start from, which exist.

    Raises CloudError for data of the judging cast, unless only tested on, and for tests beside ``hold_out``.
    """
    from annotate.labelset.cast_note import check_trainable
    from annotate.labelset.labelled_frames import open_frames

    if tests and hold_out:
        raise CloudError("--test and --hold-out exclude each other; give one of them")
    frames = [*data, *tests]
    check_extra("train", "torch", "onnx", "safetensors")
    for path in frames:
        open_frames(path)
    for path in data:
        check_trainable(path, open_frames(path).info)
    inputs = [*frames, *([choices.init] if choices.init not in (None, SHIPPED) else [])]
    check_there(*inputs)
    return inputs


def _say_unchecked(paths: list[Path]) -> None:
    """Print the number of automatic frames of label sets."""
    from annotate.labelset.label_set import LabelSet
    from annotate.labelset.labelled_frames import open_frames

    for path in paths:
        labels = open_frames(path)
        states = map(labels.status, labels.frame_ids) if isinstance(labels, LabelSet) else ()
        if automatic := sum(state == "auto" for state in states):
            say(f"{path}: {automatic} of {len(labels)} frames have unchecked labels; correct them with fix")


def _written(out: Path, model: "nn.Module", plan: "Plan", split: "CalibrationSplit") -> dict[str, Any]:
    """Write a trained network in both formats; return its path, its temperature and the calibration set."""
    from eval.architecture.networks import scheme_of
    from eval.training.calibration.calibrated_export import calibrated, export_calibrated

    weights = out / "weights.onnx"
    trained = split.trained.scheme
    scheme = scheme_of(model, trained)
    if scheme != trained:
        say(
            f"the network keeps its classes, of scheme {scheme.name!r}; predict --scheme {trained.name} "
            "joins them"
        )
    calibration = calibrated(model, split.calibrated, progress)
    export_calibrated(model, plan.network, scheme, calibration, weights)
    return {
        "temperature": round(calibration.temperature, 4),
        "calibrated_on": split.described(),
        "weights": str(weights),
    }


def _config(network: NetworkName) -> "NetworkConfig":
    from eval.architecture.compact import CompactConfig
    from eval.architecture.reference_networks import PaperConfig, SmpConfig

    configs: dict[NetworkName, NetworkConfig] = {
        "compact": CompactConfig(),
        "compact-small": CompactConfig((16, 24, 32, 48, 64), 2),
        "compact-large": CompactConfig((32, 48, 96, 160, 256)),
        "paper": PaperConfig(),
        "paper-quarter": PaperConfig(16, 1024),
        "smp": SmpConfig(),
    }
    return configs[network]


def _crops(
    data: list[Path], tests: list[Path], hold_out: frozenset[str], images: int, scheme: "Scheme"
) -> "tuple[CalibrationSplit, Crops | None]":
    """Return images to train on, to calibrate on, and to measure on if any; the three share no image."""
    from eval.training.calibration.calibration_split import calibration_split
    from eval.training.crops import load_crops

    split = calibration_split(load_crops(data, without=hold_out, scheme=scheme))
    if hold_out:
        return split, load_crops(data, only=hold_out, scheme=scheme).spread(images)
    return split, load_crops(tests, scheme=scheme).spread(images) if tests else None


@contextmanager
def _watching(
    group: "ProcessGroup", out: Path, plan: "Plan", crops: "Crops", minutes: float
) -> "Iterator[Watch]":
    """Yield the callbacks of a training; only the first of several processes reports."""
    from eval.training.train import Watch, work_left

    def ended(epoch: "Epoch") -> None:
        scores = "" if epoch.miou is None else f", mean recall {epoch.mean_recall:.4f}, mIoU {epoch.miou:.4f}"
        of = f" of {plan.epochs}" if plan.minutes is None else ""
        say(f"epoch {epoch.number}{of}: loss {epoch.loss:.4f}{scores}")

    if group.first:
        left, unit = work_left(out, plan, crops)
        with progress(f"train, {unit}", left) as advance:
            yield Watch(advance, ended, 60 * minutes)
    else:
        yield Watch(checkpoint_s=60 * minutes)
