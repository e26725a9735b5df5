"""Weights for a scheme's classes from a network of another scheme's classes.

The parent of a finer class is the class that holds its regions; the background is the parent of a thing. A
class starts with its parent's score, lowered by the logarithm of the number of children. The children's
summed probability is then the parent's. A coarser class starts as the mean of the classes that it holds.
"""

from collections import Counter
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from annotate.scheme.merging import conversion_table, converts
from annotate.scheme.scheme import Scheme
from eval.architecture.compact import CompactConfig
from eval.architecture.joint_head import HEAD
from eval.architecture.kinds import Kinds
from eval.architecture.networks import NetworkConfig, build
from eval.architecture.reference_networks import SmpConfig
from sensors.errors import CloudError, Setting

Parents = Sequence[Sequence[int]]
"""Old classes of each new class, one or more."""


def parents_of(old: Scheme, new: Scheme) -> list[list[int]]:
    """Return the classes of ``old`` from which each class of ``new`` starts.

    A thing starts from the thing of its name, otherwise from the background.
    """
    things = {part.name: int(old.class_table[part.id]) for part in old.parts if part.is_free}
    parents = [[0]]
    for part in new.parts:
        if part.is_free:
            parents.append([things.get(part.name, 0)])
        else:
            parents.append(old.class_table[list(old.ids_of(part.regions))].tolist())
    return parents


def joins(old: Scheme, new: Scheme) -> bool:
    """Return whether each class of ``new`` is the union of some of ``old``."""
    return converts(old, new) and set(conversion_table(old, new)[old.class_ids]) == {*new.class_ids.tolist()}


def started(values: Tensor, parents: Parents) -> Tensor:
    """Return weights (n, ...) of new classes: the means over their parents in (n', ...)."""
    return torch.stack([values[list(one)].mean(dim=0) for one in parents])


def started_bias(bias: Tensor, parents: Parents) -> Tensor:
    """Return biases (n, ...) of new classes from (n', ...), lowered by the logarithm of the children."""
    children = Counter(parent for one in parents for parent in one)
    shared = torch.tensor([float(max(children[i], 1)) for i in range(len(bias))])
    counts = torch.tensor([float(len(one)) for one in parents])
    shape = (-1, *[1] * (bias.dim() - 1))
    lowered = bias - shared.log().reshape(shape).to(bias)
    return started(lowered, parents) + counts.log().reshape(shape).to(bias)


def start_layer(values: dict[str, Tensor], layer: str, parents: Parents, n_old: int) -> None:
    """Replace a layer's weights and bias for new classes; its rows are ``n_old`` equal blocks."""
    for name, start in ((f"{layer}.weight", started), (f"{layer}.bias", started_bias)):
        blocks = values[name].reshape(n_old, -1, *values[name].shape[1:])
        values[name] = start(blocks, parents).flatten(0, 1)


def start_inputs(values: dict[str, Tensor], name: str, parents: Parents, n_old: int) -> None:
    """Replace weights (n, c, ...) of a layer whose last inputs are ``n_old`` class probabilities.

    A class has the weights of its parents, so that children that share a probability count as before.
    """
    others, own = values[name][:, :-n_old], values[name][:, -n_old:]
    values[name] = torch.cat([others, started(own.transpose(0, 1), parents).transpose(0, 1)], dim=1)


def expanded(model: nn.Module, config: NetworkConfig, old: Scheme, new: Scheme) -> nn.Module:
    """Return a network for the classes of ``new`` from one for the classes of ``old``.

    A network of classes that ``new`` joins stays as it is, because a training can use their sums
    (``merged_scores``). Where each class of ``new`` has one parent and each class of ``old`` a child, the
    probabilities summed by parent are the old ones. Raises CloudError for a network whose last layer has no
    bias.
    """
    if old == new or joins(old, new):
        return model
    values = dict(model.state_dict())
    if isinstance(config, CompactConfig):
        start_layer(values, "kinds", _parents_of_kinds(old, new), len(Kinds.of(old)))
        start_inputs(values, f"{HEAD}finer.0.weight", parents_of(old, new), len(old.class_ids))
    elif isinstance(config, SmpConfig):
        start_layer(values, "unet.segmentation_head.0", parents_of(old, new), len(old.class_ids))
    else:
        raise CloudError(
            f"weights have scheme {old.name!r} and the data {new.name!r}; start without weights, because the "
            "last layer of this network has no bias",
            Setting.INIT,
        )
    built = build(config, new)
    for name, value in built.state_dict().items():
        if name.startswith("sides.") and name not in values:
            values[name] = torch.zeros_like(value)  # because both sides are equally likely at first
    built.load_state_dict({name: values[name] for name in built.state_dict()})
    return built


def _parents_of_kinds(old: Scheme, new: Scheme) -> list[list[int]]:
    """Return the old kinds from which each kind of the new classes starts."""
    of_old, of_new = Kinds.of(old).of_class, Kinds.of(new).of_class
    parents: list[set[int]] = [set() for _ in range(1 + max(of_new))]
    for kind, classes in zip(of_new, parents_of(old, new), strict=True):
        parents[kind] |= {of_old[i] for i in classes}
    return [sorted(one) for one in parents]
