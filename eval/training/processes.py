"""Processes that train one network together: each sees a share of every batch, and all take the same step."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel


@dataclass(frozen=True)
class ProcessGroup:
    """This process among all: rank of world, and the device it computes on."""

    rank: int
    world: int
    device: torch.device

    @staticmethod
    @contextmanager
    def join() -> Iterator["ProcessGroup"]:
        """Meet the others when torchrun's environment names any, part at the end; a GPU each, if any."""
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
        """Whether this process is the one that writes and reports."""
        return self.rank == 0

    def wait(self) -> None:
        """Until all are here."""
        if self.world > 1:
            distributed.barrier()

    def total(self, value: Tensor) -> Tensor:
        """The sum of all processes' values, as a number that no gradient flows through."""
        value = value.detach()
        if self.world > 1:
            value = value.clone()
            distributed.all_reduce(value)
        return value

    def by_the_first(self, seconds: float) -> float:
        """The first process's clock, so that all come to an end together."""
        return float(self.total(torch.tensor(seconds if self.first else 0.0, dtype=torch.float64)))

    def together(self, model: nn.Module) -> nn.Module:
        """The model whose gradients are the mean over all processes, and whose normalisation is over all."""
        if self.world == 1:
            return model
        for layer in model.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.__class__ = _NormOverAll
        return DistributedDataParallel(model)


ALONE = ProcessGroup(0, 1, torch.device("cpu"))
"""One process, on the processor."""


class _Sum(torch.autograd.Function):
    """The sum of all processes' values; so is its gradient that of all their losses."""

    @staticmethod
    def forward(_: object, value: Tensor) -> Tensor:
        value = value.clone()
        distributed.all_reduce(value)
        return value

    @staticmethod
    def backward(_: object, gradient: Tensor) -> Tensor:
        return _Sum.forward(_, gradient)


def _sum(value: Tensor) -> Tensor:
    summed: Tensor = _Sum.apply(value)  # type: ignore[no-untyped-call]
    return summed


class _NormOverAll(nn.BatchNorm2d):
    """Batch normalisation by the statistics of all processes' images; torch's own does this on GPUs only.

    Every process has as many images as the others or one fewer, of one size.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Normalised (B, C, h, w); while training it keeps the statistics."""
        if not self.training:
            return super().forward(x)
        values = x.float()
        sums = torch.cat([values.sum((0, 2, 3)), values.new_tensor([values[:, 0].numel()])])
        sums = _sum(sums)
        number, mean = sums[-1], sums[:-1] / sums[-1]
        centred = values - mean[:, None, None]
        variance = _sum(centred.square().sum((0, 2, 3))) / number
        self._keep(mean.detach(), (variance * number / (number - 1)).detach())
        scale = self.weight / torch.sqrt(variance + self.eps)
        return (centred * scale[:, None, None] + self.bias[:, None, None]).to(x.dtype)

    @torch.no_grad()
    def _keep(self, mean: Tensor, variance: Tensor) -> None:
        """Let the running statistics follow."""
        if self.running_mean is None or self.running_var is None or self.num_batches_tracked is None:
            return
        share = 0.1 if self.momentum is None else self.momentum
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean, share)
        self.running_var.lerp_(variance, share)
