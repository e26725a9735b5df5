"""Reference networks: the paper's FCN as far as it can be rebuilt, U-Nets of segmentation-models-pytorch."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from eval.architecture.blocks import NetworkOutput, convolution
from sensors.errors import CloudError, Setting

STAGES = ((1, 1), (2, 2), (4, 4, 4), (8, 8, 8), (8, 8, 8))
"""VGG-16: channels of each stage's 3x3 convolutions, in multiples of the base; a halving ends each stage."""
FIRST_PAD = 100  # px around conv1_1, as in Long et al. 2015: 212 x 212 comes out again
SMP_STRIDE = 32  # sides are multiples of this, because the library's encoders halve five times


@dataclass(frozen=True)
class PaperConfig:
    """Numbers of channels: of the first stage, and of the two convolutions in place of VGG's dense layers.

    Defaults are the published widths; a quarter of them, (16, 1024), can be trained on a CPU.
    """

    base: int = 64
    dense: int = 4096


class PaperFcn(nn.Module):
    """Network of Nishi & Miura 2017 (section 3.1 and Fig. 5; sizes after Oliveira et al. 2016).

    Fifteen convolutions (VGG-16's thirteen, 7x7, 1x1) and five learned deconvolutions (4x4, stride 2,
    initialised bilinear). After each deconvolution but the last, the scores of the pooling layer of that
    resolution are added, cropped about the centre. Channel dropout of 0.5 follows the last two convolutions
    and each skip. 135.1 M parameters at base 64. Batch normalisation and He initialisation are added, because
    training starts without VGG's weights.
    """

    def __init__(self, config: PaperConfig = PaperConfig(), scheme: Scheme = PAPER) -> None:
        super().__init__()
        classes = len(scheme.class_ids)
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
            nn.Sequential(nn.Conv2d(stage[-1], classes, 1), nn.Dropout2d(0.5)) for stage in widths[-2::-1]
        )
        self.up = nn.ModuleList(
            nn.ConvTranspose2d(c, classes, 4, 2, bias=False) for c in (config.dense, *[classes] * 4)
        )
        self.apply(_initialise)
        for skip in self.skips:
            # As Long et al. 2015: a scoring layer starts from zero, so the loss starts near log(K).
            nn.init.zeros_(skip.get_parameter("0.weight"))

    def forward(self, depth: Tensor) -> NetworkOutput:
        """Return scores (B, K, h, w) for depth (B, 1, h, w) float32."""
        x, pooled = depth, []
        for stage in self.stages:
            x = stage(x)
            pooled.append(x)
        x = self.up[0](self.dense(x))
        for up, skip, features in zip(self.up[1:], self.skips, pooled[-2::-1], strict=True):
            x = up(x + _centre(skip(features), x.shape[-2:]))
        return NetworkOutput(_centre(x, depth.shape[-2:]))


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
    """Return weights (c_in, c_out, 4, 4) of a deconvolution that doubles a map's size by interpolation.

    With c_in != c_out the channels are mixed at random; the mix is small, so that untrained scores are near
    0.
    """
    ramp = torch.tensor([0.25, 0.75, 0.75, 0.25])
    mixture = torch.eye(c_in) if c_in == c_out else torch.randn(c_in, c_out) * 0.1 * c_in**-0.5
    return mixture[:, :, None, None] * torch.outer(ramp, ramp)


@dataclass(frozen=True)
class SmpConfig:
    """Encoder name and numbers of channels of the decoder's stages, for a U-Net of
    segmentation-models-pytorch.
    """

    encoder: str = "tu-mobilenetv4_conv_small"
    decoder: tuple[int, ...] = (64, 48, 32, 24, 16)


class SmpUnet(nn.Module):
    """U-Net of segmentation-models-pytorch with random initial weights; nothing is downloaded.

    Raises CloudError where the library is missing or has no such encoder.
    """

    def __init__(self, config: SmpConfig = SmpConfig(), scheme: Scheme = PAPER) -> None:
        super().__init__()
        try:
            import segmentation_models_pytorch as smp  # type: ignore[import-not-found]

            self.unet: nn.Module = smp.Unet(
                config.encoder,
                encoder_depth=len(config.decoder),
                encoder_weights=None,
                decoder_channels=config.decoder,
                in_channels=1,
                classes=len(scheme.class_ids),
            )
        except (ImportError, KeyError, ValueError, RuntimeError) as error:
            reason = str(error).splitlines()[0][:120]
            raise CloudError(
                f"encoder {config.encoder!r} is not available ({reason}); "
                "pip install segmentation-models-pytorch, or take another network",
                Setting.NETWORK,
            ) from error

    def forward(self, depth: Tensor) -> NetworkOutput:
        """Return scores (B, K, h, w) for depth (B, 1, h, w) float32."""
        h, w = depth.shape[-2:]
        down, right = -h % SMP_STRIDE, -w % SMP_STRIDE
        padded = nn.functional.pad(depth, (right // 2, right - right // 2, down // 2, down - down // 2))
        scores: Tensor = self.unet(padded)
        return NetworkOutput(scores[..., down // 2 : down // 2 + h, right // 2 : right // 2 + w])
