"""Imports and kernels for the server from which nodes of dask are forked."""

import cv2

import tests.helpers.dask_node  # noqa: F401
from synth.images.generate import Order, make_shard
from synth.images.presets import PRESETS

cv2.setNumThreads(1)  # threads do not survive a fork
make_shard(Order(PRESETS["sitting-train"], 1, 0, 1), 0)
