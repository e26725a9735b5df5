"""The line about compiling: once, and only where numba compiles."""

import os
import subprocess
import sys

import pytest
from numba import njit

from annotate.compiler_notice import LINE, announce_compiling
from synth.images.workers import processes

KERNELS = """
from numba import njit

@njit(cache=True)
def one(x):
    return x + 1

@njit(cache=True)
def two(x):
    return x * 2.0
"""
RUN = """
from annotate.compiler_notice import announce_compiling
announce_compiling()
from kernels import one, two
assert one(1) + two(1) == 4
"""


def compiled(_):
    return njit(lambda x: x + 1)(1)


def test_only_a_compilation_prints_one_line(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    printed = [
        subprocess.run(
            [sys.executable, "-c", RUN], env=environment, stderr=subprocess.PIPE, check=True, text=True
        ).stderr
        for _ in range(2)
    ]
    assert printed == [LINE + "\n", ""]


def test_the_command_announces_its_first_compilation(annotate_cloud, capsys):
    annotate_cloud("scheme", "list")
    assert compiled(0) == compiled(1) == 2
    assert capsys.readouterr().err == LINE + "\n"


@pytest.mark.parametrize("due", [True, False])
def test_the_workers_of_a_command_print_one_line(capfd, due):
    announce_compiling()
    if not due:
        compiled(0)
    capfd.readouterr()
    with processes(2) as (pool, _):
        assert list(pool.map(compiled, range(6))) == [2] * 6
    assert capfd.readouterr().err == (LINE + "\n" if due else "")
