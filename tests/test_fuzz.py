"""Readers of bytes from outside: what was once found by fuzzing stays mended, and a little is fuzzed anew."""

import shutil
from pathlib import Path

import pytest
from fuzz_readers import Fuzzer
from fuzz_samples import READERS

CORPUS = Path(__file__).parent / "corpus"
SAMPLES = 12
"""New samples a reader; ``fuzz_readers.py`` makes as many as one likes."""


@pytest.mark.parametrize("name", READERS)
def test_spoilt_files_are_refused_in_one_line(tmp_path, name, capfd):
    fuzzer = Fuzzer(READERS[name], tmp_path)
    for number in range(SAMPLES):
        fuzzer.spoil(("test", number))
        assert not fuzzer.finding()


@pytest.mark.parametrize("kept", sorted(path.name for path in CORPUS.iterdir()))
def test_what_was_found_stays_mended(tmp_path, kept, capfd):
    name = next(name for name in sorted(READERS, key=len, reverse=True) if kept.startswith(name))
    fuzzer = Fuzzer(READERS[name], tmp_path)
    shutil.rmtree(fuzzer.spoilt)
    shutil.copytree(CORPUS / kept, fuzzer.spoilt)
    assert not fuzzer.finding()
