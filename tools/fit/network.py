"""Write the shipped weights of a training: ``python -m tools.fit.network RUN CALIBRATION_SET``.

Writes eval/weights/compact.onnx; most layers are quantised. The safetensors file beside it has half
precision. Both come from RUN's weights.safetensors. The calibration set is a dataset that was not trained on.
Its images of the bodies that RUN left out give the temperature and the ranges of the quantisation.
"""

import json
import sys
from pathlib import Path

from eval.network.onnx_export import LEAST_HALVED, export_network, halve_onnx, name_scheme
from eval.network.onnx_network import SHIPPED_WEIGHTS
from eval.network.weights_file import load_weights, save_weights
from eval.scores.joint_visibility import VISIBILITIES
from eval.training.calibration.calibration_split import LEAST_BODIES
from eval.training.calibration.confidence_temperature import fitted_temperature
from eval.training.calibration.deviation_factors import fitted_deviation_factors
from eval.training.crops import load_crops
from eval.training.train import HISTORY
from sensors.files.atomic import replacing
from tools.fit.quantise import CALIBRATED_ON, quantise
from tools.fit.suit_network import check_inputs

EXACT = ("stem.0", "down.0.0.0", "kinds", "places", "correction")
"""Convolutions in full precision: the first, whose depth in eight bits has steps of 8 mm, and the last."""
LINEAR = ("query_key_value", "mixed", "thought.0", "thought.2")
"""Linear layers in eight bits, all of the attention."""


def main() -> None:
    """Write both files."""
    run, calibration = map(Path, sys.argv[1:])
    network, config, scheme = load_weights(run / "weights.safetensors")
    check_inputs([calibration])
    left_out = json.loads((run / HISTORY).read_text())["left_out"]
    if not left_out:
        sys.exit(f"{run} has left out 0 bodies; train with --hold-out, or on {LEAST_BODIES} bodies or more")
    crops = load_crops([calibration], only=frozenset(left_out))
    temperature, factors = fitted_temperature(network, crops), fitted_deviation_factors(network, crops)
    inputs = ({"depth": depth[:, None]} for depth, _ in crops.spread(CALIBRATED_ON).batches(1))
    with replacing(SHIPPED_WEIGHTS) as unfinished:
        full = run / "full.onnx"
        export_network(network, full, temperature, scheme, factors)
        quantise(full, inputs, unfinished, EXACT, LINEAR)
        halve_onnx(unfinished)
        name_scheme(unfinished, scheme)
    for name, value in network.state_dict().items():
        if value.is_floating_point() and value.numel() >= LEAST_HALVED:
            network.get_parameter(name).data = value.half()
    save_weights(SHIPPED_WEIGHTS.with_suffix(".safetensors"), network, config, scheme)
    named = ", ".join(f"{name} {one:.2f}" for name, one in zip(VISIBILITIES, factors, strict=True))
    print(f"temperature {temperature:.4f}; factors of deviations: {named}")


if __name__ == "__main__":
    main()
