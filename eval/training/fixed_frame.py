"""The labelling of one frame as a training goes on: the paper's Fig. 7."""

from dataclasses import dataclass
from pathlib import Path

from torch import nn

from annotate.labelset.images import encode_depth, encode_parts
from eval.training.crops import Crops
from eval.training.validate import predicted
from sensors.files.atomic import write_bytes


@dataclass(frozen=True)
class FixedFrame:
    """One frame and how its labelling grows: depth.png, truth.parts.png, epoch-000.parts.png and on."""

    folder: Path
    crop: Crops
    epochs: int

    def begin(self, model: nn.Module) -> None:
        """Write the frame itself and what the untrained network makes of it."""
        self.folder.mkdir(exist_ok=True)
        write_bytes(self.folder / "depth.png", encode_depth(self.crop.depth(0)))
        write_bytes(self.folder / "truth.parts.png", encode_parts(self.crop.parts(0)))
        self.label(model, 0)

    def label(self, model: nn.Module, epoch: int) -> None:
        """Write the labelling after an epoch: of each to 10, each tenth to 100 and so on, and the last."""
        if epoch > 10 and epoch < self.epochs and epoch % 10 ** (len(str(epoch)) - 1):
            return
        labels = next(predicted(model, self.crop))
        write_bytes(self.folder / f"epoch-{epoch:03d}.parts.png", encode_parts(labels[0]))
