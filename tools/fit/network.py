"""Weights of a training as the wheel has them: ``python -m tools.fit.network RUN CALIBRATION_SET``.

Writes eval/weights/compact.onnx, most of whose convolutions compute in eight bits, and compact.safetensors in
half precision, both from RUN's weights.safetensors; on a dataset that was not trained on, confidences are
made chances and the ranges of the eight bits are taken.
"""

import sys
from pathlib import Path

from eval.network.checkpoint import load_weights, save_weights
from eval.network.half_precision import LEAST_HALVED, halve_onnx
from eval.network.networks import export_onnx
from eval.network.onnx_network import SHIPPED_WEIGHTS
from eval.training.crops import load_crops
from eval.training.temperature import fitted_temperature
from sensors.files.atomic import replacing
from tools.fit.quantise import SEEN, eight_bits

EXACT = ("stem.0", "down.0.0.0", "up.3.0", "refine.0", "kinds", "places")
"""Layers that stay in full precision: the first, whose depth of eight bits would have steps of 8 mm, the
finest and the last. They take 1 ms of 7; in eight bits they cost 0.002 of the recall of standing and lying
people (measured on development images)."""


def main() -> None:
    """Ship."""
    run, calibration = map(Path, sys.argv[1:])
    network, config = load_weights(run / "weights.safetensors")
    crops = load_crops([calibration])
    temperature = fitted_temperature(network, crops)
    seen = ({"depth": depth[:, None]} for depth, _ in crops.spread(SEEN).batches(1))
    with replacing(SHIPPED_WEIGHTS) as unfinished:
        full = run / "full.onnx"
        export_onnx(network, full, temperature)
        eight_bits(full, seen, unfinished, EXACT)
        halve_onnx(unfinished)
    for name, value in network.state_dict().items():
        if value.is_floating_point() and value.numel() >= LEAST_HALVED:
            network.get_parameter(name).data = value.half()
    save_weights(SHIPPED_WEIGHTS.with_suffix(".safetensors"), network, config)
    print(f"temperature {temperature:.4f}")


if __name__ == "__main__":
    main()
