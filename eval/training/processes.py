"""The processes of one training: alone, or started by torchrun on one machine or several."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import distributed, nn
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

    def together(self, model: nn.Module) -> nn.Module:
        """The model whose gradients are the mean over all processes."""
        return DistributedDataParallel(model) if self.world > 1 else model
