"""Export of a trained network whose confidences and deviations are fitted on crops that it has not seen."""

from pathlib import Path

from torch import nn

from annotate.scheme.scheme import Scheme
from eval.architecture.networks import NetworkConfig
from eval.network.onnx_export import export_network
from eval.network.weights_file import save_weights
from eval.training.calibration.confidence_temperature import fitted_temperature
from eval.training.calibration.deviation_factors import UNCHANGED, fitted_deviation_factors
from eval.training.crops import Crops

CALIBRATED_ON = 512  # images, at most, that the confidences are fitted on; untuned


def export_calibrated(
    model: nn.Module, config: NetworkConfig, scheme: Scheme, held: Crops | None, path: Path
) -> float:
    """Write a network as ONNX to ``path``, and as safetensors beside it; return the softmax temperature.

    scheme: of the network's classes. held: crops left out of the training; None = not calibrated.
    """
    save_weights(path.with_suffix(".safetensors"), model, config, scheme)
    temperature, factors = 1.0, UNCHANGED
    if held is not None:
        held = held.spread(CALIBRATED_ON)
        temperature, factors = fitted_temperature(model, held), fitted_deviation_factors(model, held)
    export_network(model, path, temperature, scheme, factors)
    return temperature
