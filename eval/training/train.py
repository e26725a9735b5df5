"""Train a network on labelled crops: resumable from any moment, deterministic given a seed, watched."""

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from zlib import crc32

import numpy as np
import torch
from torch import Tensor, nn

from annotate.array_types import Int64, UInt8
from annotate.labelset.claim import Claim, login
from annotate.labelset.images import encode_parts, encode_png
from annotate.parts import BACKGROUND, N_CLASSES
from eval.network.checkpoint import Epoch, Point, Progress, load_checkpoint, save_checkpoint, saved_work
from eval.network.networks import build
from eval.scores.confusion import confusion_matrix, mean_recall, miou
from eval.training.average import Average
from eval.training.crops import Crops
from eval.training.loader import BatchOrder, Images, batches, workers_watched
from eval.training.plan import Plan, class_weights, loss_of, optimizer_of, rate, seen_by
from eval.training.processes import ProcessGroup
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import is_taken, write_bytes

PLAN, CHECKPOINT, HISTORY = "plan.json", "checkpoint.safetensors", "history.json"
POINT_STEPS = 20
"""Steps whose mean loss is one point of the curve; untuned."""
WEIGHING_IMAGES = 512
"""Images that the classes' weights are counted on; untuned."""


def predicted(model: nn.Module, crops: Crops, batch: int = 32) -> Iterator[UInt8]:
    """Part ids (B, h, w) of a network on crops, as `predict` names them: a part wherever there is depth."""
    model.eval()
    device = next(model.parameters()).device
    for depth, _ in crops.batches(batch):
        x = torch.from_numpy(depth[:, None]).to(device).contiguous(memory_format=torch.channels_last)
        with torch.no_grad():
            parts = model(x).scores[:, 1:].argmax(1) + 1
        yield np.where(depth > 0, parts.cpu().numpy(), BACKGROUND).astype(np.uint8)


def evaluate(model: nn.Module, crops: Crops, batch: int = 32) -> Int64:
    """Confusion matrix (12, 12) of a network on crops, rows are the truth."""
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for (_, parts), labels in zip(crops.batches(batch), predicted(model, crops, batch), strict=True):
        total += confusion_matrix(parts, labels)
    return total


@dataclass(frozen=True)
class FixedFrame:
    """One frame and how its labelling grows: depth.png, truth.parts.png, epoch-000.parts.png and on."""

    folder: Path
    crop: Crops
    epochs: int

    def begin(self, model: nn.Module) -> None:
        """Write the frame itself and what the untrained network makes of it."""
        self.folder.mkdir(exist_ok=True)
        write_bytes(self.folder / "depth.png", encode_png(self.crop.depth(0)))
        write_bytes(self.folder / "truth.parts.png", encode_parts(self.crop.parts(0)))
        self.label(model, 0)

    def label(self, model: nn.Module, epoch: int) -> None:
        """Write the labelling after an epoch: of each to 10, each tenth to 100 and so on, and the last."""
        if epoch > 10 and epoch < self.epochs and epoch % 10 ** (len(str(epoch)) - 1):
            return
        labels = next(predicted(model, self.crop))
        write_bytes(self.folder / f"epoch-{epoch:03d}.parts.png", encode_parts(labels[0]))


@dataclass(frozen=True)
class Watch:
    """Calls after each step and each epoch of a training, and seconds between two checkpoints.

    advance: called with the images of a step, or with the seconds since the last call where the clock ends
    the training (``work_left``).
    """

    advance: Callable[[int], None] = lambda work: None
    ended: Callable[[Epoch], None] = lambda epoch: None
    checkpoint_s: float = 300.0


def train(
    crops: Crops,
    measured: Crops | None,
    out: Path,
    plan: Plan,
    group: ProcessGroup,
    watch: Watch = Watch(),
    init: nn.Module | None = None,
    workers: int = 0,
) -> tuple[nn.Module, Progress]:
    """Train ``plan.network``, from ``init`` or from nothing, and go on with what ``out`` holds of it.

    ``out`` gets plan, checkpoints, history.json, and frame/: the labelling of one frame, the first measured
    one (else the first), before the training and as it goes. Every process of the group calls this; only the
    first writes. Raises ExistsError when ``out`` was started otherwise, ClaimedError while another training
    writes it, FormatError on a broken checkpoint, CloudError when the loss is no longer finite.
    """
    if group.first:
        _begin(out, plan, crops, init)
    group.wait()
    with workers_watched(), Claim.take(out, login()) if group.first else nullcontext():
        torch.manual_seed(plan.seed)
        model = init if init is not None else build(plan.network)
        model = model.to(group.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        optimizer = optimizer_of(plan.recipe, model.parameters())
        average = Average(model, plan.recipe.averaged)
        resumed = (out / CHECKPOINT).is_file()
        progress = (
            load_checkpoint(out / CHECKPOINT, model, average.model, optimizer) if resumed else Progress()
        )
        fixed = FixedFrame(out / "frame", (measured or crops).spread(1), plan.rounds)
        run = _Run(plan, crops, measured, out, watch, group, model, average, optimizer, progress, fixed)
        if group.first and not resumed:
            fixed.begin(model)
        run.go(workers)
        return average.model, progress


@dataclass(frozen=True)
class _Run:
    plan: Plan
    crops: Crops
    measured: Crops | None
    out: Path
    watch: Watch
    group: ProcessGroup
    model: nn.Module
    average: Average
    optimizer: torch.optim.Optimizer
    progress: Progress
    fixed: FixedFrame

    def go(self, workers: int) -> None:
        plan, progress = self.plan, self.progress
        order = BatchOrder(
            len(self.crops), plan.recipe.batch, plan.rounds, plan.seed, self.group.rank, self.group.world
        )
        images = Images(self.crops, plan.augmentation, plan.seed)
        _, weighed = next(self.crops.spread(WEIGHING_IMAGES).batches(WEIGHING_IMAGES))
        weight = class_weights(plan.recipe, weighed).to(self.group.device)
        network = self.group.together(self.model)
        began, before = time.monotonic(), progress.seconds
        saved, shown_s = began, int(before)
        if plan.done(progress.step / order.epoch_steps, progress.seconds) >= 1:
            return
        for depth, parts, whole in batches(images, order, progress.step, workers):
            share = plan.done(progress.step / order.epoch_steps, progress.seconds)
            self._step(network, (depth, parts, whole), weight, share)
            self._count(order)
            now = time.monotonic()
            progress.seconds = self.group.by_the_first(before + now - began)
            over = plan.done(progress.step / order.epoch_steps, progress.seconds) >= 1
            ended = over or progress.step % order.epoch_steps == 0
            if ended:
                self._end_epoch(order)
            if ended or now - saved >= self.watch.checkpoint_s:
                self._save()
                saved = now
            if ended:
                self.watch.ended(progress.epochs[-1])
            if plan.minutes is None:
                self.watch.advance(order.step_images)
            else:
                self.watch.advance(int(progress.seconds) - shown_s)
                shown_s = int(progress.seconds)
            if over:
                return

    def _step(
        self, network: nn.Module, batch: tuple[Tensor, Tensor, Tensor], weight: Tensor, share: float
    ) -> None:
        """One step of the optimizer. Dropout is the step's own, so that a resumed training draws the same."""
        processes, plan, progress = self.group, self.plan, self.progress
        torch.manual_seed((plan.seed * 1_000_003 + progress.step) * processes.world + processes.rank)
        network.train()
        if not plan.recipe.statistics:
            for layer in network.modules():
                if isinstance(layer, nn.BatchNorm2d):
                    layer.eval()
        for group in self.optimizer.param_groups:
            group["lr"] = rate(plan.recipe, share)
        depth, parts, whole = (
            tensor.to(processes.device) for tensor in (seen_by(plan.recipe, *batch[:2], share) + batch[2:])
        )
        depth = depth.contiguous(memory_format=torch.channels_last)
        with torch.autocast(processes.device.type, torch.bfloat16, enabled=plan.precision == "bfloat16"):
            answer = network(depth)
        loss, mean = loss_of(plan.recipe, answer, depth, parts, whole, weight, processes)
        if not math.isfinite(mean):
            raise CloudError(
                f"the loss is no longer finite at step {progress.step}; train with --precision float32"
            )
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.model.parameters(), plan.recipe.clip)
        self.optimizer.step()
        self.average.add(self.model, progress.step + 1)
        progress.since_point.append(mean)

    def _count(self, order: BatchOrder) -> None:
        progress = self.progress
        progress.step += 1
        progress.epoch_loss += progress.since_point[-1]
        if len(progress.since_point) >= POINT_STEPS:
            mean = float(np.mean(progress.since_point))
            progress.points.append(Point(progress.step * order.step_images, mean))
            progress.since_point.clear()

    def _end_epoch(self, order: BatchOrder) -> None:
        progress = self.progress
        number = len(progress.epochs) + 1
        steps = progress.step - (number - 1) * order.epoch_steps
        loss, progress.epoch_loss = progress.epoch_loss / steps, 0.0
        scores: tuple[float | None, float | None] = (None, None)
        if self.measured is not None and self.group.first:
            matrix = evaluate(self.average.model, self.measured)
            scores = float(mean_recall(matrix)), float(miou(matrix))
        if self.group.first:
            self.fixed.label(self.average.model, number)
        progress.epochs.append(Epoch(number, loss, *scores, round(progress.seconds, 1)))

    def _save(self) -> None:
        if not self.group.first:
            return
        save_checkpoint(self.out / CHECKPOINT, self.model, self.average.model, self.optimizer, self.progress)
        history = {
            "plan": self.plan.described(),
            "images": len(self.crops),
            "parameters": sum(p.numel() for p in self.model.parameters()),
            "processes": self.group.world,
            "device": self.group.device.type,
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
            "points": [asdict(point) for point in self.progress.points],
            "epochs": [asdict(epoch) for epoch in self.progress.epochs],
        }
        write_bytes(self.out / HISTORY, (json.dumps(history, indent=1) + "\n").encode())


def work_left(out: Path, plan: Plan, crops: Crops) -> tuple[int, str]:
    """Return the rest of a training in ``out`` and its unit: images, or seconds where the clock ends it."""
    steps, seconds = saved_work(out / CHECKPOINT) if (out / CHECKPOINT).is_file() else (0, 0.0)
    if plan.minutes is not None:
        return max(0, round(60 * plan.minutes) - int(seconds)), "seconds"
    order = BatchOrder(len(crops), plan.recipe.batch, plan.epochs, plan.seed)
    return (order.epoch_steps * plan.epochs - steps) * order.step_images, "images"


def _begin(out: Path, plan: Plan, crops: Crops, init: nn.Module | None) -> None:
    """Start or resume: plan, data and initial weights identify the training."""
    data = {"images": len(crops), "crc32": crops.crc32}
    whole = {**plan.described(), "data": data, "init": None if init is None else _crc32(init)}
    order = json.dumps(whole, sort_keys=True, indent=1).encode() + b"\n"
    if (out / PLAN).is_file():
        if (out / PLAN).read_bytes() != order:
            raise ExistsError(
                f"{out} holds another training (other plan or data); use another folder or pass --overwrite"
            )
        return
    if is_taken(out):
        raise ExistsError(f"{out} exists and is not a training; choose another folder or pass --overwrite")
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / PLAN, order)


def _crc32(model: nn.Module) -> int:
    value = 0
    for tensor in model.state_dict().values():
        value = crc32(tensor.contiguous().numpy().tobytes(), value)
    return value
