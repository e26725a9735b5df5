"""From where tests start processes: forked from one that has imported once what all of them need."""

from multiprocessing import get_context

FORKING = get_context("forkserver")
"""A process has one such server, and its first start decides on its imports: so this names those of all."""
FORKING.set_forkserver_preload(["tests.helpers.tiny_training", "torch._dynamo", "tests.helpers.dask_warm"])
