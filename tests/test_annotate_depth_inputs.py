"""Networks read fewer inputs where a frame has neither colour nor temperature; the result is the same."""

import numpy as np
import pytest

from annotate.onnx_graph import parsed, without_channels
from annotate.parts import PAPER
from annotate.segmentation.depth_inputs import depth_input, inputs_by_depth, is_depth_alone
from annotate.segmentation.input_channels import (
    CHANNELS,
    FELT,
    FIXED,
    OTHER,
    SEEN,
    SUBJECT,
    VALID,
    network_input,
)
from annotate.segmentation.split_network import INPUT
from annotate.segmentation.suit_network import SHIPPED_SUIT_NETWORK, shipped_suit_network

PARTS = len(PAPER.parts)


def drawn(shape):
    """Return random channels of depth alone."""
    planes = np.random.default_rng(3).integers(0, 256, (len(CHANNELS), *shape)).astype(np.uint8)
    planes[0] &= VALID | SUBJECT | OTHER
    planes[1] %= PARTS + 3
    planes[len(FIXED) - 2 :] = 0
    return planes


def test_channels_of_depth_alone_give_the_inputs_that_are_not_constant():
    planes = drawn((20, 33))
    every = network_input(planes, PARTS)
    kept = inputs_by_depth(PARTS)
    np.testing.assert_array_equal(depth_input(planes, PARTS), every[kept])
    assert not np.delete(every, kept, axis=0).any() and every[kept].any(axis=(1, 2)).all()


@pytest.mark.parametrize(("channel", "byte"), [(0, FELT), (0, SEEN), (len(FIXED) - 2, 1), (-1, 1)])
def test_a_single_pixel_of_colour_or_temperature_is_not_depth_alone(channel, byte):
    planes = drawn((20, 33))
    assert is_depth_alone(planes) and is_depth_alone(planes[:, :0])
    planes[channel, 7, 5] |= byte
    assert not is_depth_alone(planes)


def test_probabilities_are_the_same_with_fewer_inputs(monkeypatch):
    network, planes = shipped_suit_network(), drawn((64, 90))
    found = network.probabilities(planes, 2)
    assert network._halves(planes).inputs == inputs_by_depth(PARTS)
    monkeypatch.setattr(type(network), "_depth_inputs", network._all_inputs)
    np.testing.assert_array_equal(network.probabilities(planes, 2), found)


def test_inputs_that_other_layers_read_are_kept():
    model = parsed(SHIPPED_SUIT_NETWORK.read_bytes())
    model.graph.node.add(kind="Relu", input=[INPUT], output=["more"])
    with pytest.raises(ValueError, match="Relu reads"):
        without_channels(model.SerializeToString(), INPUT, [0])
    del model.graph.node[-1]
    with pytest.raises(ValueError, match="no convolution"):
        without_channels(model.SerializeToString(), "other", [0])
    with pytest.raises(ValueError, match="of form"):
        without_channels(model.SerializeToString(), INPUT, [0, 99])
