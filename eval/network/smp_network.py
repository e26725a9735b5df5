"""Networks of segmentation-models-pytorch, larger than the compact one."""

from dataclasses import dataclass

from torch import Tensor, nn

from annotate.parts import N_CLASSES
from sensors.errors import CloudError

STRIDE = 32
"""Their encoders halve five times: sides are padded to a multiple of this."""


@dataclass(frozen=True)
class SmpConfig:
    """A U-Net: its encoder by the library's name, and the channels of the five decoder stages."""

    encoder: str = "tu-mobilenetv4_conv_small"
    decoder: tuple[int, ...] = (64, 48, 32, 24, 16)


class SmpUnet(nn.Module):
    """Depth crop in [0, 1] -> class scores, at the same resolution; starts from random weights, offline.

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

    def forward(self, depth: Tensor) -> Tensor:
        """(B, 1, h, w) float32 -> (B, 12, h, w) scores."""
        h, w = depth.shape[-2:]
        down, right = -h % STRIDE, -w % STRIDE
        padded = nn.functional.pad(depth, (right // 2, right - right // 2, down // 2, down - down // 2))
        scores: Tensor = self.unet(padded)
        return scores[..., down // 2 : down // 2 + h, right // 2 : right // 2 + w]
