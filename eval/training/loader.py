"""Batches of augmented crops; an image depends on (seed, epoch, index) only, so training can resume at any
step.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from eval.training.augment import Augmentation, augment
from eval.training.crops import Crops
from sensors.errors import CloudError, Setting
from synth.images.workers import check_semaphores
from synth.random_stream import stream

Turn = tuple[int, int]
"""Epoch of an image, and index of its crop."""
Batch = tuple[Tensor, Tensor, Tensor]
"""Depth float32 (B, 1, h, w), parts uint8 (B, h, w) and rows (B, ROW) of ``eval.training.body_targets``."""


@dataclass(frozen=True)
class Images(Dataset[Batch]):
    """Crops as tensors, augmented at random and differently in each epoch."""

    crops: Crops
    augmentation: Augmentation
    seed: int

    def __getitem__(self, turn: Turn) -> Batch:
        epoch, index = turn
        rng = stream(self.seed, "augmentation", epoch, index)
        example = *self.crops.image(index), self.crops.wholes[index]
        depth, parts, whole = augment(example, self.augmentation, rng, self.crops.scheme)
        return torch.from_numpy(depth[None]), torch.from_numpy(parts), torch.from_numpy(whole)


@dataclass(frozen=True)
class BatchOrder:
    """Sampler of shuffled batches of crops, one per training step, that can resume at any step.

    The incomplete last batch of an epoch is dropped. With fewer crops than ``batch``, each epoch is a single
    smaller batch. rank, world: index of this process, and number of processes that share each batch.
    """

    images: int
    batch: int
    epochs: int
    seed: int
    rank: int = 0
    world: int = 1

    def __post_init__(self) -> None:
        if min(self.images, self.batch) < self.world:
            raise CloudError(
                f"{self.images} images in batches of {self.batch} are too few for {self.world} processes; "
                "start fewer processes"
            )

    @property
    def step_images(self) -> int:
        """Return the number of images of one step over all processes."""
        return min(self.batch, self.images)

    @property
    def epoch_steps(self) -> int:
        """Return the number of steps of one epoch."""
        return self.images // self.step_images

    def after(self, step: int) -> Iterator[list[Turn]]:
        """Yield this process's share of each batch from a step on, as pairs (epoch, index of a crop)."""
        for epoch in range(step // self.epoch_steps, self.epochs):
            order = stream(self.seed, "order", epoch).permutation(self.images)
            first = step % self.epoch_steps if epoch == step // self.epoch_steps else 0
            for k in range(first, self.epoch_steps):
                batch = order[k * self.step_images : (k + 1) * self.step_images]
                yield [(epoch, int(i)) for i in batch[self.rank :: self.world]]


def batches(images: Images, order: BatchOrder, step: int, workers: int = 0) -> Iterator[Batch]:
    """Yield the batches from a step on; worker processes prepare batches in advance."""
    if workers:
        check_semaphores()
    pinned = torch.cuda.is_available()
    loader = DataLoader(images, batch_sampler=order.after(step), num_workers=workers, pin_memory=pinned)
    with no_opencv_threads():
        drawn = iter(loader)
    yield from drawn


@contextmanager
def no_opencv_threads() -> Iterator[None]:
    """End OpenCV's threads while worker processes start: a fork copies their locks without the threads, and
    the worker then waits for ever.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


@contextmanager
def workers_watched() -> Iterator[None]:
    """Turn torch's errors about a killed worker process into CloudError.

    torch raises its error in a signal handler, at any point of the training. Reading a batch at that time
    ends in a pipe error.
    """
    try:
        yield
    except (RuntimeError, ConnectionError, EOFError) as error:
        if isinstance(error, RuntimeError) and "DataLoader worker" not in str(error):
            raise
        raise CloudError(
            "a worker process was killed, perhaps because memory ran out; run the same command again to "
            "continue, with fewer workers",
            Setting.WORKERS,
        ) from error
