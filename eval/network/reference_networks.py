"""Networks to compare with: the paper's FCN as far as it can be rebuilt, larger U-Nets of a library."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from annotate.parts import N_CLASSES
from eval.network.compact import convolution
from eval.network.network_output import Answer
from sensors.errors import CloudError

STAGES = ((1, 1), (2, 2), (4, 4, 4), (8, 8, 8), (8, 8, 8))
"""VGG-16: channels of each stage's 3x3 convolutions, in multiples of the base; a halving ends each stage."""
FIRST_PAD = 100
"""Around conv1_1, as in Long et al. 2015: with the other sizes it makes 212 x 212 come out again."""


@dataclass(frozen=True)
class PaperConfig:
    """base: channels of the first stage. dense: channels of the two layers that replace the dense ones.

    The published widths by default; a quarter of them, (16, 1024), can be trained on a CPU.
    """

    base: int = 64
    dense: int = 4096


class PaperFcn(nn.Module):
    """Depth crop in [0, 1] -> class scores, at the same resolution.

    As published (Nishi & Miura 2017, section 3.1 and Fig. 5; sizes after Oliveira et al. 2016): fifteen
    convolutions (VGG-16's thirteen, 7x7, 1x1), five learned deconvolutions (4x4, stride 2, bilinear at
    first), after each but the last the scores of the pooling layer of that resolution added, cropped about
    the centre; half of the maps dropped after the last two convolutions and on each skip. At base 64:
    135.1 M parameters.
    Added, since it has to start without VGG's weights and would not learn: batch normalisation after each
    convolution, He initialisation.
    """

    def __init__(self, config: PaperConfig = PaperConfig()) -> None:
        super().__init__()
        widths = [[config.base * k for k in stage] for stage in STAGES]
        self.stages = nn.ModuleList()
        before = 1
        for stage in widths:
            layers: list[nn.Module] = []
            for width in stage:
                layers += convolution(before, width, 3, FIRST_PAD if before == 1 else 1)
                before = width
            self.stages.append(nn.Sequential(*layers, nn.MaxPool2d(2, ceil_mode=True)))
        self.dense = nn.Sequential(
            *convolution(before, config.dense, 7, 0),
            nn.Dropout2d(0.5),
            *convolution(config.dense, config.dense, 1, 0),
            nn.Dropout2d(0.5),
        )
        self.skips = nn.ModuleList(
            nn.Sequential(nn.Conv2d(stage[-1], N_CLASSES, 1), nn.Dropout2d(0.5)) for stage in widths[-2::-1]
        )
        self.up = nn.ModuleList(
            nn.ConvTranspose2d(c, N_CLASSES, 4, 2, bias=False) for c in (config.dense, *[N_CLASSES] * 4)
        )
        self.apply(_initialise)
        for skip in self.skips:
            # As Long et al. 2015: a scoring layer starts from nothing, so the loss starts near log(12).
            nn.init.zeros_(skip.get_parameter("0.weight"))

    def forward(self, depth: Tensor) -> Answer:
        """(B, 1, h, w) float32 -> scores (B, 12, h, w)."""
        x, pooled = depth, []
        for stage in self.stages:
            x = stage(x)
            pooled.append(x)
        x = self.up[0](self.dense(x))
        for up, skip, features in zip(self.up[1:], self.skips, pooled[-2::-1], strict=True):
            x = up(x + _centre(skip(features), x.shape[-2:]))
        return Answer(_centre(x, depth.shape[-2:]))


def _centre(x: Tensor, size: torch.Size) -> Tensor:
    top, left = (x.shape[-2] - size[0]) // 2, (x.shape[-1] - size[1]) // 2
    return x[..., top : top + size[0], left : left + size[1]]


def _initialise(layer: nn.Module) -> None:
    if isinstance(layer, nn.Conv2d):
        nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    elif isinstance(layer, nn.ConvTranspose2d):
        with torch.no_grad():
            layer.weight.copy_(_bilinear(layer.in_channels, layer.out_channels))


def _bilinear(c_in: int, c_out: int) -> Tensor:
    """Weights (c_in, c_out, 4, 4) that double a map by interpolation; mix at random where channels differ.

    Small weights: the untrained scores are near 0.
    """
    ramp = torch.tensor([0.25, 0.75, 0.75, 0.25])
    mixture = torch.eye(c_in) if c_in == c_out else torch.randn(c_in, c_out) * 0.1 * c_in**-0.5
    return mixture[:, :, None, None] * torch.outer(ramp, ramp)


SMP_STRIDE = 32
"""The encoders of segmentation-models-pytorch halve five times: sides are padded to a multiple of this."""


@dataclass(frozen=True)
class SmpConfig:
    """A U-Net: its encoder by the library's name, and the channels of the five decoder stages."""

    encoder: str = "tu-mobilenetv4_conv_small"
    decoder: tuple[int, ...] = (64, 48, 32, 24, 16)


class SmpUnet(nn.Module):
    """A U-Net by segmentation-models-pytorch; starts from random weights, offline.

    Raises CloudError when the library is missing or knows no such encoder.
    """

    def __init__(self, config: SmpConfig = SmpConfig()) -> None:
        super().__init__()
        try:
            import segmentation_models_pytorch as smp  # type: ignore[import-not-found]

            self.unet: nn.Module = smp.Unet(
                config.encoder,
                encoder_depth=len(config.decoder),
                encoder_weights=None,
                decoder_channels=config.decoder,
                in_channels=1,
                classes=N_CLASSES,
            )
        except (ImportError, KeyError, ValueError, RuntimeError) as error:
            reason = str(error).splitlines()[0][:120]
            raise CloudError(
                f"no network with encoder {config.encoder!r} ({reason}); "
                "pip install segmentation-models-pytorch, or take another --network"
            ) from error

    def forward(self, depth: Tensor) -> Answer:
        """(B, 1, h, w) float32 -> scores (B, 12, h, w)."""
        h, w = depth.shape[-2:]
        down, right = -h % SMP_STRIDE, -w % SMP_STRIDE
        padded = nn.functional.pad(depth, (right // 2, right - right // 2, down // 2, down - down // 2))
        scores: Tensor = self.unet(padded)
        return Answer(scores[..., down // 2 : down // 2 + h, right // 2 : right // 2 + w])
