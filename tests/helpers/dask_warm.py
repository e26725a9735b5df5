"""Imported once where nodes of dask are forked from: what they need is loaded, and the kernels are."""

import cv2

import tests.helpers.dask_node  # noqa: F401
from synth.images.generate import Order, make_shard
from synth.images.presets import PRESETS

cv2.setNumThreads(1)  # Its threads would not be there in what is forked.
make_shard(Order(PRESETS["sitting-train"], 1, 0, 1), 0)
