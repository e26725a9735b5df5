"""The compact network that labels a person's crop: a U-Net with a stride-2 stem, made for CPUs."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from annotate.parts import N_CLASSES


@dataclass(frozen=True)
class CompactConfig:
    """Channels after the stem and after each of the four halvings."""

    widths: tuple[int, ...] = (24, 32, 48, 64, 96)


def _convolution(c_in: int, c_out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(c_in, c_out, 3, stride, 1, bias=False), nn.BatchNorm2d(c_out), nn.ReLU(inplace=True)
    )


class CompactUNet(nn.Module):
    """Depth crop in [0, 1] -> class scores, at the same resolution.

    The stem halves the image at once and a pixel shuffle restores it at the end: nearly all work is done
    at a quarter of the pixels, which is what makes training on two cores affordable.
    """

    def __init__(self, config: CompactConfig = CompactConfig()) -> None:
        super().__init__()
        w = config.widths
        self.stem = _convolution(1, w[0], stride=2)
        self.down = nn.ModuleList(
            nn.Sequential(_convolution(a, b, stride=2), _convolution(b, b)) for a, b in pairwise(w)
        )
        self.up = nn.ModuleList(
            _convolution(below + skip, skip) for skip, below in zip(w[-2::-1], w[:0:-1], strict=True)
        )
        self.refine = _convolution(w[0] + 4, w[0])
        self.head = nn.Conv2d(w[0], 4 * N_CLASSES, 1)

    def forward(self, depth: Tensor) -> Tensor:
        """(B, 1, H, W) float32 -> (B, 12, H, W) scores. H and W even."""
        x = self.stem(depth)
        skips = [x]
        for stage in self.down:
            x = stage(x)
            skips.append(x)
        skips.pop()
        for stage in self.up:
            skip = skips.pop()
            x = nn.functional.interpolate(x, size=skip.shape[-2:], mode="nearest")
            x = stage(torch.cat([x, skip], dim=1))
        # The raw pixels again, so that the last stage sees edges at full resolution.
        x = self.refine(torch.cat([x, nn.functional.pixel_unshuffle(depth, 2)], dim=1))
        scores: Tensor = nn.functional.pixel_shuffle(self.head(x), 2)
        return scores
