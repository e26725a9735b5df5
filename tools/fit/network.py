"""Weights of a training as the wheel has them: ``python -m tools.fit.network RUN CALIBRATION_SET``.

Writes eval/weights/compact.onnx and compact.safetensors in half precision from RUN's weights.safetensors; the
confidences are made chances on a dataset that was not trained on.
"""

import sys
from pathlib import Path

from eval.network.checkpoint import load_weights, save_weights
from eval.network.halved import LEAST_HALVED, halve_onnx
from eval.network.networks import export_onnx
from eval.network.onnx_network import SHIPPED_WEIGHTS
from eval.training.crops import load_crops
from eval.training.temperature import fitted_temperature


def main() -> None:
    """Ship."""
    run, calibration = map(Path, sys.argv[1:])
    network, config = load_weights(run / "weights.safetensors")
    temperature = fitted_temperature(network, load_crops([calibration]))
    export_onnx(network, SHIPPED_WEIGHTS, temperature)
    halve_onnx(SHIPPED_WEIGHTS)
    for name, value in network.state_dict().items():
        if value.is_floating_point() and value.numel() >= LEAST_HALVED:
            network.get_parameter(name).data = value.half()
    save_weights(SHIPPED_WEIGHTS.with_suffix(".safetensors"), network, config)
    print(f"temperature {temperature:.4f}")


if __name__ == "__main__":
    main()
