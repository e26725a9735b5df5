"""Server from which tests fork processes, with the imports of all of them."""

from multiprocessing import get_context

FORKING = get_context("forkserver")
"""Shared, because a process has one such server, whose first start decides on the imports."""
FORKING.set_forkserver_preload(["tests.helpers.tiny_training", "torch._dynamo", "tests.helpers.dask_warm"])
