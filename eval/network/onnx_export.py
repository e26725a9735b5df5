"""Export of networks as ONNX."""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from annotate.crop import SIZE
from annotate.onnx_session import REFINEMENT, SCHEME, WITHOUT
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import scheme_to_fields
from eval.architecture.class_scores import class_probabilities, kind_odds
from eval.architecture.compact import CompactUNet, in_pixels
from eval.architecture.kinds import Kinds
from eval.network.flip_averaging import CELL_OUTPUTS
from eval.scores.joint_visibility import VISIBILITIES
from sensors.files.atomic import replacing

LEAST_HALVED = 1024  # numbers of a tensor from which half precision makes the file smaller

OUTPUTS = ("probability", "facing", "posture", "joints", "joint_sd", "joint_state", *CELL_OUTPUTS)
CELL = 4  # pixels, 2 x 2, whose scores are channels in the last layer


class _Probabilities(nn.Module):
    """Network that outputs probabilities instead of scores; a pixel without depth is background.

    The other ``OUTPUTS`` follow if the network has them, postures and states as probabilities. Networks with
    sides also give the factors of the probabilities (see ``CELL_OUTPUTS``).
    """

    factors: Tensor

    def __init__(self, network: nn.Module, temperature: float, factors: Sequence[float]) -> None:
        super().__init__()
        self.network, self.temperature = network, temperature
        self.register_buffer("factors", torch.tensor(factors)[:, None])

    def forward(self, depth: Tensor) -> tuple[Tensor, ...]:
        """Return the ``OUTPUTS`` for depth (B, 1, h, w); part probabilities are (B, K, h, w)."""
        if not isinstance(self.network, CompactUNet):
            scores = self.network(depth).scores
            without_sides = Kinds(tuple(range(scores.shape[1])), (0,) * scores.shape[1])
            return (class_probabilities(without_sides, scores / self.temperature, None, depth > 0),)
        cells, others = self.network.factors(depth, self.temperature)
        facing, posture, joints, deviations, states, _ = others
        parts = class_probabilities(self.network.classes, *in_pixels(cells), depth > 0)
        seen = torch.softmax(states, dim=2)
        kinds, side = cells
        odds = kind_odds(kinds.reshape(len(kinds), -1, CELL, *kinds.shape[2:])).flatten(1, 2)
        by_cell = () if side is None else (odds, torch.sigmoid(side))
        sd = deviations * (seen @ self.factors)
        return parts, facing, torch.softmax(posture, dim=1), joints, sd, seen, *by_cell


def export_network(
    network: nn.Module,
    path: Path,
    temperature: float = 1.0,
    scheme: Scheme = PAPER,
    factors: Sequence[float] = (1.0,) * len(VISIBILITIES),
) -> None:
    """Write a network as ONNX: ``depth`` (B, 1, 212, 212) -> ``probability`` (B, K, 212, 212).

    Further outputs are as in `NetworkOutput`, ``posture`` and ``joint_state`` as probabilities. temperature:
    divides the scores, of kinds and of the side where the network has these. scheme: of the classes, written
    into the file's metadata. factors: of the joints' deviations, by ``VISIBILITIES``.
    """
    whole = _Probabilities(network.cpu(), temperature, factors).eval()
    example = torch.rand(1, 1, SIZE, SIZE)
    with torch.no_grad():
        names = OUTPUTS[: len(whole(example))]
    with replacing(path) as temporary:
        _write(whole, example, temporary, {name: {0: "batch"} for name in ("depth", *names)})
        name_scheme(temporary, scheme)


def name_scheme(path: Path, scheme: Scheme) -> None:
    """Write the scheme of its classes into an ONNX file's metadata; a file of ``paper`` stays unchanged."""
    if scheme != PAPER:
        _add_metadata(path, {SCHEME: json.dumps(scheme_to_fields(scheme))})


def leave_unrefined(path: Path) -> None:
    """Write into an ONNX file's metadata that ``predict`` does not refine its labels by default."""
    _add_metadata(path, {REFINEMENT: WITHOUT})


def _add_metadata(path: Path, entries: dict[str, str]) -> None:
    """Add entries to an ONNX file's metadata."""
    import onnx

    model = onnx.load(path)
    known = {entry.key: entry.value for entry in model.metadata_props}
    onnx.helper.set_model_props(model, known | entries)
    with replacing(path) as temporary:
        onnx.save(model, temporary)


def export_any_size(network: nn.Module, path: Path, channels: int, multiple: int, names: list[str]) -> None:
    """Write a network for one image (1, channels, h, w) whose sides are multiples of ``multiple``.

    names: of the input and the output. Normalisation statistics are not folded into weights, so training can
    continue from the file.
    """
    axes = {name: {2: "h", 3: "w"} for name in names}
    example = torch.zeros(1, channels, 2 * multiple, 3 * multiple)
    _write(network.eval(), example, path, axes, torch.onnx.TrainingMode.PRESERVE)


def export_crops(network: nn.Module, path: Path, example: Tensor, names: list[str]) -> None:
    """Write a network for any number of crops as in ``example`` (n, C, h, w).

    names: of the input and the output.
    """
    _write(network.eval(), example, path, {name: {0: "n"} for name in names})


def _write(
    network: nn.Module,
    example: Tensor,
    path: Path,
    axes: dict[str, dict[int, str]],
    mode: torch.onnx.TrainingMode = torch.onnx.TrainingMode.EVAL,
) -> None:
    """Write a network as ONNX. axes: dimensions of variable size, by the name of the input, then of the
    outputs.
    """
    given, *outputs = axes
    with replacing(path) as temporary, warnings.catch_warnings():
        # The newer exporter needs another package, onnxscript.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (example,),
            str(temporary),
            training=mode,
            opset_version=17 if mode == torch.onnx.TrainingMode.PRESERVE else None,
            input_names=[given],
            output_names=outputs,
            dynamic_axes=axes,
            dynamo=False,
        )


def halve_onnx(path: Path) -> None:
    """Store an ONNX file's large tensors in half precision; computation stays in single precision."""
    import onnx
    from onnx import helper, numpy_helper

    model, widened = onnx.load(path), []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= LEAST_HALVED:
            name = tensor.name
            tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}_half"))
            widened.append(helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*widened, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    with replacing(path) as temporary:
        onnx.save(model, temporary)
