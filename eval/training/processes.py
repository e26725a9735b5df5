"""Processes that train one network together: each has a share of every batch, and all take the same step."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel


@dataclass(frozen=True)
class ProcessGroup:
    """Rank of this process, number of all processes (``world``), and device of this process."""

    rank: int
    world: int
    device: torch.device

    @staticmethod
    @contextmanager
    def join() -> Iterator["ProcessGroup"]:
        """Join the processes that torchrun's environment names, each on a GPU if any; leave at the end."""
        gpu = torch.cuda.is_available()
        world = int(os.environ.get("WORLD_SIZE", "1"))
        local = int(os.environ.get("LOCAL_RANK", "0"))
        device = torch.device("cuda", local) if gpu else torch.device("cpu")
        if gpu:
            torch.cuda.set_device(device)
            torch.backends.cudnn.deterministic = True
        if world > 1:
            distributed.init_process_group("nccl" if gpu else "gloo")
        try:
            yield ProcessGroup(int(os.environ.get("RANK", "0")), world, device)
        finally:
            if world > 1:
                distributed.destroy_process_group()

    @property
    def first(self) -> bool:
        """Return True for the process that writes files and reports."""
        return self.rank == 0

    def wait(self) -> None:
        """Wait for all processes."""
        if self.world > 1:
            distributed.barrier()

    def total(self, value: Tensor) -> Tensor:
        """Return the sum of ``value`` over all processes, without a gradient."""
        return _all_sum(value.detach()) if self.world > 1 else value.detach()

    def by_the_first(self, seconds: float) -> float:
        """Return ``seconds`` of the first process, because all processes must end at the same step."""
        return float(self.total(torch.tensor(seconds if self.first else 0.0, dtype=torch.float64)))

    def together(self, model: nn.Module) -> nn.Module:
        """Return the model with gradients averaged, and normalisation computed, over all processes."""
        if self.world == 1:
            return model
        for layer in model.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.__class__ = _NormOverAll
        return DistributedDataParallel(model)


ALONE = ProcessGroup(0, 1, torch.device("cpu"))
"""Group of one process, on the processor."""


def _all_sum(value: Tensor) -> Tensor:
    value = value.clone()
    distributed.all_reduce(value)
    return value


class _Sum(torch.autograd.Function):
    """Sum over all processes; the gradient is the sum of their gradients."""

    @staticmethod
    def forward(_: object, value: Tensor) -> Tensor:
        return _all_sum(value)

    @staticmethod
    def backward(_: object, gradient: Tensor) -> Tensor:
        return _all_sum(gradient)


def _sum(value: Tensor) -> Tensor:
    summed: Tensor = _Sum.apply(value)  # type: ignore[no-untyped-call]
    return summed


class _NormOverAll(nn.BatchNorm2d):
    """Batch normalisation over all processes; torch's SyncBatchNorm needs a GPU.

    The processes have images of one size; their numbers of images differ by one at most.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, C, h, w) normalised; training updates the running statistics."""
        if not self.training:
            return super().forward(x)
        values = x.float()
        sums = _sum(torch.cat([values.sum((0, 2, 3)), values.new_tensor([values[:, 0].numel()])]))
        number, mean = sums[-1], sums[:-1] / sums[-1]
        centred = values - mean[:, None, None]
        variance = _sum(centred.square().sum((0, 2, 3))) / number
        if self.num_batches_tracked is not None and self.running_mean is not None:
            share = 0.1 if self.momentum is None else self.momentum
            self.num_batches_tracked.add_(1)
            self.running_mean.lerp_(mean.detach(), share)
            self.running_var.lerp_((variance * number / (number - 1)).detach(), share)  # type: ignore[union-attr]
        scale = self.weight / torch.sqrt(variance + self.eps)
        return (centred * scale[:, None, None] + self.bias[:, None, None]).to(x.dtype)
