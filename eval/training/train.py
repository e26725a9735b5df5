"""Train a network on labelled crops: resumable at any step, deterministic given a seed."""

import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import torch
from torch import Tensor, nn

from annotate.array_types import Int64, UInt8
from annotate.labelset.claim import Claim, login
from annotate.labelset.images import encode_parts, encode_png
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from annotate.scheme.scheme_file import scheme_to_fields
from eval.architecture.class_scores import merged_scores
from eval.architecture.networks import build, scheme_of
from eval.scores.confusion import mean_recall, miou
from eval.training.crops import Crops
from eval.training.loader import Batch, BatchOrder, Images, batches, workers_watched
from eval.training.plan import Loss, Plan, at_resolution
from eval.training.processes import ProcessGroup
from eval.training.resumable_loop import Epoch, Point, Progress, Schedule, State, fit, load_progress, resumed
from sensors.errors import ExistsError, Setting
from sensors.files.atomic import is_taken, write_bytes

PLAN, CHECKPOINT, HISTORY = "plan.json", "checkpoint.safetensors", "history.json"
POINT_STEPS = 20  # steps of one point of the curve; untuned
WEIGHING_IMAGES = 512  # images that the classes' weights are counted on; untuned


def predicted(model: nn.Module, crops: Crops, batch: int = 32) -> Iterator[UInt8]:
    """Yield part ids (B, h, w) of a network on crops; each pixel with depth gets a body part."""
    model.eval()
    device = next(model.parameters()).device
    for depth, _ in crops.batches(batch):
        x = torch.from_numpy(depth[:, None]).to(device).contiguous(memory_format=torch.channels_last)
        with torch.no_grad():
            scores = merged_scores(model(x).scores, scheme_of(model, crops.scheme), crops.scheme)
        classes = scores[:, 1:].argmax(1) + 1
        parts = crops.scheme.class_ids[classes.cpu().numpy()]
        yield np.where(depth > 0, parts, np.uint8(BACKGROUND))


def evaluate(model: nn.Module, crops: Crops, batch: int = 32) -> Int64:
    """Return the confusion matrix (K, K) of a network's classes on crops; rows are the truth."""
    table, count = crops.scheme.class_table, len(crops.scheme.class_ids)
    total = np.zeros(count * count, np.int64)
    for (_, parts), labels in zip(crops.batches(batch), predicted(model, crops, batch), strict=True):
        known = parts != UNDEFINED
        pairs = table[parts[known]].astype(np.int64) * count + table[labels[known]]
        total += np.bincount(pairs, minlength=count * count)
    return total.reshape(count, count)


@dataclass(frozen=True)
class Data:
    """Crops to train on and to measure on, the network to start from (None: random weights), and number of
    workers.

    left_out: bodies that are in no image to train on.
    """

    crops: Crops
    measured: Crops | None = None
    start: nn.Module | None = None
    workers: int = 0
    left_out: tuple[str, ...] = ()

    @property
    def classes(self) -> Scheme:
        """Return the scheme of the network's classes: of ``start``, or of the crops without one."""
        scheme = self.crops.scheme
        return scheme if self.start is None else scheme_of(self.start, scheme)


@dataclass(frozen=True)
class Watch:
    """Callbacks after each step and each epoch, and the seconds between two checkpoints.

    advance: called with the images of a step, or with the seconds since the last call where the clock ends
    the training (``work_left``).
    """

    advance: Callable[[int], None] = lambda work: None
    ended: Callable[[Epoch], None] = lambda epoch: None
    checkpoint_s: float = 300.0


def train(
    data: Data, out: Path, plan: Plan, group: ProcessGroup, watch: Watch = Watch()
) -> tuple[nn.Module, Progress]:
    """Train ``plan.network`` or resume the training in ``out``; return the network and the progress.

    ``out`` gets plan, checkpoints, history.json, and frame/: the labels of one frame, the first measured one
    (else the first), as training goes on. Every process of the group calls this; the first one writes. Raises
    ExistsError where ``out`` holds another training, ClaimedError while another process trains there,
    FormatError on a broken checkpoint, CloudError where the loss is not finite.
    """
    if group.first:
        _begin(out, plan, data)
    group.wait()
    with workers_watched(), Claim.take(out, login()) if group.first else nullcontext():
        torch.manual_seed(plan.seed)
        model = data.start if data.start is not None else build(plan.network, data.crops.scheme)
        model = model.to(group.device)
        run = _NetworkTraining(data, out, plan, group, watch.checkpoint_s)
        state = resumed(model, run.schedule, out / CHECKPOINT)
        if group.first and not (out / CHECKPOINT).is_file():
            run.begin_frame(state.model)
        shown_s = int(state.progress.seconds)

        def shown(step: int, loss: float) -> None:
            nonlocal shown_s
            if run.at_end(state.progress):
                watch.ended(state.progress.epochs[-1])
            seconds = int(state.progress.seconds)
            watch.advance(run.order.step_images if plan.minutes is None else seconds - shown_s)
            shown_s = seconds

        return fit(run, state, out / CHECKPOINT, shown, group), state.progress


@dataclass(frozen=True)
class _NetworkTraining:
    """Training of a network on crops; an ``eval.training.resumable_loop.Training``."""

    data: Data
    out: Path
    plan: Plan
    group: ProcessGroup
    checkpoint_s: float

    @cached_property
    def order(self) -> BatchOrder:
        plan, group = self.plan, self.group
        return BatchOrder(
            len(self.data.crops), plan.recipe.batch, plan.rounds, plan.seed, group.rank, group.world
        )

    @cached_property
    def schedule(self) -> Schedule:
        return self.plan.schedule(self.order.epoch_steps, self.checkpoint_s)

    @cached_property
    def _loss(self) -> Loss:
        _, weighed = next(self.data.crops.spread(WEIGHING_IMAGES).batches(WEIGHING_IMAGES))
        scheme = self.data.crops.scheme
        return Loss.weighed(self.plan.recipe, weighed, self.group, scheme, self.data.classes)

    def batches(self, step: int) -> Iterator[Batch]:
        images = Images(self.data.crops, self.plan.augmentation, self.plan.seed)
        return batches(images, self.order, step, self.data.workers)

    def loss(self, network: nn.Module, batch: Batch, share: float) -> tuple[Tensor, float]:
        device = self.group.device
        depth, parts = (t.to(device) for t in at_resolution(self.plan.recipe, *batch[:2], share))
        depth = depth.contiguous(memory_format=torch.channels_last)
        with torch.autocast(device.type, torch.bfloat16, enabled=self.plan.precision == "bfloat16"):
            output = network(depth)
        return self._loss.of(output, (depth, parts, batch[2].to(device)))

    def at_end(self, progress: Progress) -> bool:
        """Return whether an epoch or the training has just ended."""
        return progress.step % self.order.epoch_steps == 0 or self.schedule.share(progress) >= 1

    def record(self, state: State, loss: float) -> bool:
        progress = state.progress
        progress.since_point.append(loss)
        progress.epoch_loss += loss
        if len(progress.since_point) >= POINT_STEPS:
            mean = float(np.mean(progress.since_point))
            progress.points.append(Point(progress.step * self.order.step_images, mean))
            progress.since_point.clear()
        if not self.at_end(progress):
            return False
        number = len(progress.epochs) + 1
        mean = progress.epoch_loss / (progress.step - (number - 1) * self.order.epoch_steps)
        scores: tuple[float | None, float | None] = (None, None)
        if self.data.measured is not None and self.group.first:
            matrix = evaluate(state.average, self.data.measured)
            scores = float(mean_recall(matrix)), float(miou(matrix))
        progress.epoch_loss = 0.0
        progress.epochs.append(Epoch(number, mean, *scores, round(progress.seconds, 1)))
        if self.group.first:
            self._label_frame(state.average, number)
            self._write_history(state)
        return True

    @cached_property
    def _frame(self) -> Crops:
        return (self.data.measured or self.data.crops).spread(1)

    def begin_frame(self, model: nn.Module) -> None:
        """Write the depth and the true parts of the frame that shows the training's course, and its labels by
        the untrained network.
        """
        folder = self.out / "frame"
        folder.mkdir(exist_ok=True)
        write_bytes(folder / "depth.png", encode_png(self._frame.depth(0)))
        write_bytes(folder / "truth.parts.png", encode_parts(self._frame.parts(0), self._frame.scheme))
        self._label_frame(model, 0)

    def _label_frame(self, model: nn.Module, epoch: int) -> None:
        """Write the labels of the frame in ``begin_frame`` after an epoch.

        Labels are kept of epochs 1 to 10, then every tenth to 100, every hundredth to 1000 and so on, and of
        the last.
        """
        if epoch > 10 and epoch < self.plan.rounds and epoch % 10 ** (len(str(epoch)) - 1):
            return
        labels = next(predicted(model, self._frame))
        write_bytes(
            self.out / "frame" / f"epoch-{epoch:03d}.parts.png", encode_parts(labels[0], self._frame.scheme)
        )

    def _write_history(self, state: State) -> None:
        history = {
            "plan": self.plan.described(),
            **_scheme_of(self.data),
            "images": len(self.data.crops),
            "left_out": list(self.data.left_out),
            "parameters": sum(p.numel() for p in state.model.parameters()),
            "processes": self.group.world,
            "device": self.group.device.type,
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
            "points": [asdict(point) for point in state.progress.points],
            "epochs": [asdict(epoch) for epoch in state.progress.epochs],
        }
        write_bytes(self.out / HISTORY, (json.dumps(history, indent=1) + "\n").encode())


def work_left(out: Path, plan: Plan, crops: Crops) -> tuple[int, str]:
    """Return the remaining work of a training in ``out`` and its unit: images, or seconds if the clock ends
    it.
    """
    path = out / CHECKPOINT
    progress = load_progress(path) if path.is_file() else Progress()
    if plan.minutes is not None:
        return max(0, round(60 * plan.minutes) - int(progress.seconds)), "seconds"
    order = BatchOrder(len(crops), plan.recipe.batch, plan.epochs, plan.seed)
    return (order.epoch_steps * plan.epochs - progress.step) * order.step_images, "images"


def _begin(out: Path, plan: Plan, data: Data) -> None:
    """Write the plan of a new training, or check it against an earlier run in ``out``.

    Settings, data and initial weights identify a training.
    """
    images = {"images": len(data.crops), "crc32": data.crops.crc32}
    start = None if data.start is None else _crc32(data.start)
    fields = {**plan.described(), **_scheme_of(data), "data": images, "init": start}
    text = json.dumps(fields, sort_keys=True, indent=1)
    if (out / PLAN).is_file():
        if (out / PLAN).read_text() != text + "\n":
            raise ExistsError(
                f"{out} holds another training (other plan or data); use another folder", Setting.OVERWRITE
            )
        return
    if is_taken(out):
        raise ExistsError(f"{out} exists and is not a training; choose another folder", Setting.OVERWRITE)
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / PLAN, (text + "\n").encode())


def _scheme_of(data: Data) -> dict[str, Any]:
    """Return the scheme of the network's classes as JSON values; empty for ``paper``."""
    scheme = data.classes
    return {} if scheme == PAPER else {"scheme": scheme_to_fields(scheme)}


def _crc32(model: nn.Module) -> int:
    value = 0
    for tensor in model.state_dict().values():
        value = crc32(tensor.contiguous().numpy().tobytes(), value)
    return value
