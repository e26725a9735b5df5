"""Training of the suit network on recordings or on any examples.

Seed, examples and stage decide every bit on one thread. Constants are untuned unless a source is given.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import sha256
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from annotate.scheme.scheme_file import scheme_to_fields
from annotate.segmentation.input_channels import network_input
from annotate.segmentation.segment import SAMPLE_M
from eval.training.plan import Precision
from eval.training.progress import Advance, Progress
from eval.training.resumable_loop import Schedule, State, fit, resumed
from eval.training.segmentation.augmentation import Sample, Sampling, draw_sample
from eval.training.segmentation.examples import Example, ExampleFiles, Recording, store_examples
from eval.training.segmentation.network import (
    FULL_SUIT_NETWORK,
    SuitNet,
    expanded_suit_network,
    export_suit_network,
    load_suit_network,
)
from eval.training.segmentation.validation import Validation, validate
from sensors.errors import CloudError, ExistsError, Setting
from sensors.files.atomic import write_bytes

BATCH = 8  # samples a step
ROOM_WEIGHT = 0.7  # of a sample of the room in the loss, beside 1 of the person, because there are many
BALANCE, RAREST = (
    0.75,
    0.01,
)  # a part weighs its share of the parts to the power of minus 0.75 (docs/adr/0027)
PLAN, EXAMPLES, WEIGHTS = "plan.json", "examples", "reader.onnx"
HELD_OUT = 4  # one of this many recordings is held out, counted from the last
SAMPLING = Sampling(SAMPLE_M, 160)  # 1.9 m: most of a person
CHECKPOINT_S = 60.0  # between two checkpoints
PEAK_RATE, AVERAGED = 3e-4, 0.99  # for a trained network: low, because it has little to unlearn

Watch = Callable[[int, float], None]
"""Called after each step with its number, from 1, and its loss."""


@dataclass(frozen=True)
class Stage:
    """Part of a training with one cycle of the learning rate; the next stage starts from its moving average.

    averaged, statistics: as in ``Schedule``. precision: number format of the forward pass.
    """

    sampling: Sampling
    steps: int
    peak_rate: float
    averaged: float
    statistics: bool = True
    precision: Precision = "float32"


@dataclass(frozen=True)
class SuitTraining:
    """Training of the suit network for a stage; an ``eval.training.resumable_loop.Training``.

    scheme: of the examples and the network.
    """

    examples: ExampleFiles | Sequence[Example]
    stage: Stage
    seed: int
    scheme: Scheme = PAPER

    @property
    def schedule(self) -> Schedule:
        stage = self.stage
        return Schedule(
            stage.peak_rate,
            stage.averaged,
            stage.steps,
            statistics=stage.statistics,
            seed=self.seed,
            checkpoint_s=CHECKPOINT_S,
        )

    def batches(self, step: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield inputs (B, n, s, s) and targets (B, s, s)."""
        for number in count(step):
            rng = np.random.default_rng((self.seed, number))
            samples = [self._drawn(rng) for _ in range(BATCH)]
            parts = len(self.scheme.parts)
            inputs = torch.from_numpy(np.stack([network_input(sample.planes, parts) for sample in samples]))
            targets = torch.from_numpy(np.stack([sample.target for sample in samples])).long()
            yield inputs.contiguous(memory_format=torch.channels_last), targets

    def _drawn(self, rng: np.random.Generator) -> Sample:
        example = self.examples[int(rng.integers(len(self.examples)))]
        return draw_sample(example, self.stage.sampling, rng, self.scheme)

    def loss(self, network: nn.Module, batch: tuple[Tensor, Tensor], share: float) -> tuple[Tensor, float]:
        """Return the loss to minimise and its value: cross entropy of known samples, weighted by
        `sample_weights`.

        share: finished share of the training, unused here.
        """
        inputs, targets = batch
        with torch.autocast("cpu", torch.bfloat16, enabled=self.stage.precision == "bfloat16"):
            scores = network(inputs)
        weight = sample_weights(targets, len(self.scheme.parts))
        loss = nn.functional.cross_entropy(scores.float(), targets, ignore_index=UNDEFINED, reduction="none")
        loss = (weight * loss).sum() / weight.sum()
        return loss, loss.item()

    def record(self, state: State, loss: float) -> bool:
        """Return False, because ``fit`` saves the state by the clock."""
        return False


def train_stage(network: SuitNet, training: SuitTraining, checkpoint: Path, watch: Watch) -> SuitNet:
    """Train a network for a stage, or for the rest of an interrupted stage; return the moving average.

    checkpoint: file of the state. Raises FormatError where it is damaged.
    """
    state = resumed(network, training.schedule, checkpoint)
    trained = fit(training, state, checkpoint, watch)
    assert isinstance(trained, SuitNet)
    return trained


def sample_weights(targets: Tensor, parts: int) -> Tensor:
    """Return the loss weights (B, h, w) of samples by their targets (B, h, w). parts: number in the scheme.

    The mean weight over the parts of an image is 1. The room weighs ``ROOM_WEIGHT``, another person 1, an
    unknown target 0.
    """
    # After the background and the parts: another person, unknown.
    own, unknown = slice(1, parts + 1), parts + 2
    known = nn.functional.one_hot(targets.clamp(max=unknown), unknown + 1)
    count = known.sum(dim=(1, 2))[:, own].float()
    share = count / count.sum(dim=1, keepdim=True).clamp(min=1)
    weight = share.clamp(min=RAREST) ** -BALANCE
    table = torch.ones(len(targets), unknown + 1)
    table[:, own] = weight / (weight * share).sum(dim=1, keepdim=True).clamp(min=1e-9)
    table[:, BACKGROUND], table[:, unknown] = ROOM_WEIGHT, 0
    return table.gather(1, targets.clamp(max=unknown).flatten(1)).reshape(targets.shape)


class Fitted(NamedTuple):
    """Trained weights at ``path``, with validation on held-out frames before and after the training."""

    path: Path
    frames: int
    frames_held_out: int
    before: Validation
    after: Validation


def train_labels(
    recordings: Sequence[Recording], out: Path, steps: int, seed: int, progress: Progress
) -> Fitted:
    """Train the shipped suit network further on labelled recordings; write ``out``/reader.onnx.

    The network gets the classes of the labels' scheme. An interrupted run is resumed. The same recordings,
    steps and seed give the same weights. Examples, 3 MB a frame, are removed at the end. Raises CloudError
    for one recording, several schemes or no usable frame. Raises ExistsError for another or a finished
    training in ``out``, ClaimedError while it is in use.
    """
    if len(recordings) < 2:
        raise CloudError(
            "one recording is given; give two or more, because confidence is fitted on a held-out one"
        )
    scheme = recordings[0].labels.scheme
    if other := next((one for one in recordings if one.labels.scheme != scheme), None):
        raise CloudError(
            f"{recordings[0].labels.path} has scheme {scheme.name!r}, {other.labels.path} has "
            f"{other.labels.scheme.name!r}; convert one of them"
        )
    torch.set_num_threads(1)
    stage = Stage(SAMPLING, steps, PEAK_RATE, AVERAGED)
    sources = [[r.source.name, r.digest()] for r in recordings]
    start = sha256(FULL_SUIT_NETWORK)
    plan = {"seed": seed, "stages": [asdict(stage)], "start": start, "recordings": sources}
    claim(out, plan | ({} if scheme == PAPER else {"scheme": scheme_to_fields(scheme)}))
    with Claim.take(out, login()):
        files = [_stored(one, out / EXAMPLES / f"{i}.npz", progress) for i, one in enumerate(recordings)]
        test = files[::-HELD_OUT]
        learnt, held_out = ExampleFiles([file for file in files if file not in test]), ExampleFiles(test)
        network = expanded_suit_network(load_suit_network(FULL_SUIT_NETWORK), scheme)
        before = validate(network, held_out, SAMPLE_M)
        with progress("train, steps", steps) as advance:
            trainings = [SuitTraining(learnt, stage, seed, scheme)]
            after = train_stages(network, trainings, held_out, out, by_steps(advance))
    shutil.rmtree(out / EXAMPLES)
    return Fitted(out / WEIGHTS, len(learnt), len(held_out), before, after)


def claim(out: Path, plan: dict[str, Any]) -> None:
    """Reserve a folder for a training. Raises ExistsError where it holds another or a finished training."""
    text = json.dumps(plan, indent=1).encode()
    if (out / WEIGHTS).exists():
        raise ExistsError(f"{out} holds a finished training; choose another folder", Setting.OVERWRITE)
    if (out / PLAN).exists() and (out / PLAN).read_bytes() != text:
        raise ExistsError(f"{out} holds another training; choose another folder", Setting.OVERWRITE)
    (out / EXAMPLES).mkdir(parents=True, exist_ok=True)
    write_bytes(out / PLAN, text)


def by_steps(advance: Advance) -> Watch:
    """Return a training callback that advances a progress bar by the steps since the last call."""
    last = 0

    def watch(step: int, loss: float) -> None:
        nonlocal last
        advance(step - last)
        last = step

    return watch


def _stored(recording: Recording, path: Path, progress: Progress) -> Path:
    """Return the file of a recording's examples; write the file unless an earlier run has."""
    if not path.exists():
        with progress(f"{recording.source.name}, frames", len(recording.source)) as advance:

            def usable() -> Iterator[Example]:
                for example in recording.examples():
                    advance(1)
                    if example is not None:
                        yield example

            store_examples(usable(), path)
    return path


def train_stages(
    network: SuitNet, trainings: Sequence[SuitTraining], held_out: ExampleFiles, out: Path, watch: Watch
) -> Validation:
    """Train in stages and write ``out``/reader.onnx, its confidence fitted to held-out examples.

    An interrupted run is resumed from the checkpoints in ``out``. Raises FormatError where one is damaged.
    """
    for number, training in enumerate(trainings):
        network = train_stage(network, training, out / f"stage-{number}.safetensors", watch)
    found = validate(network, held_out, trainings[-1].stage.sampling.sample_m)
    export_suit_network(network, out / WEIGHTS, found.temperature)
    return found
