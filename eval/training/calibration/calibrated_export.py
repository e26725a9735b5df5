"""Export of a trained network whose confidences and deviations are fitted on crops that it has not seen."""

from pathlib import Path
from typing import NamedTuple

from torch import nn

from annotate.scheme.scheme import Scheme
from eval.architecture.networks import NetworkConfig
from eval.network.onnx_export import export_network
from eval.network.weights_file import save_weights
from eval.training.calibration.confidence_temperature import fitted_temperature
from eval.training.calibration.deviation_factors import UNCHANGED, fitted_deviation_factors
from eval.training.crops import Crops
from eval.training.progress import Progress

CALIBRATED_ON = 512  # images, at most, that the confidences are fitted on; untuned


class Calibration(NamedTuple):
    """Softmax temperature of a network, and factors of its joints' deviations."""

    temperature: float = 1.0
    factors: tuple[float, ...] = UNCHANGED


def calibrated(model: nn.Module, held: Crops | None, progress: Progress) -> Calibration:
    """Return the calibration of a network. held: crops left out of its training; None = not calibrated."""
    if held is None:
        return Calibration()
    held = held.spread(CALIBRATED_ON)
    with progress("calibrate, images", 2 * len(held)) as advance:
        temperature = fitted_temperature(model, held, advance)
        return Calibration(temperature, fitted_deviation_factors(model, held, advance))


def export_calibrated(
    model: nn.Module, config: NetworkConfig, scheme: Scheme, calibration: Calibration, path: Path
) -> None:
    """Write a network as ONNX to ``path``, and as safetensors beside it. scheme: of the network's classes."""
    save_weights(path.with_suffix(".safetensors"), model, config, scheme)
    export_network(model, path, calibration.temperature, scheme, calibration.factors)
