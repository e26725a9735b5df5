"""Readers of bytes from outside: what was once found by fuzzing stays mended, and a little is fuzzed anew."""

import io
import random
import shutil
import tarfile
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.labelset.dataset import encode_shard
from tools.fuzz_samples import READERS, labelled, png
from tools.fuzz_spoil import Fuzzer, mutate, seal

CORPUS = Path(__file__).parent / "corpus"
SAMPLES = 12
"""New samples a reader; ``fuzz_readers.py`` makes as many as one likes."""


@pytest.mark.parametrize("name", READERS)
def test_spoilt_files_are_refused_in_one_line(tmp_path, name, capfd):
    fuzzer = Fuzzer(READERS[name], tmp_path)
    for number in range(SAMPLES):
        fuzzer.spoil(("test", number))
        assert not fuzzer.finding()


@pytest.mark.parametrize("name", ["labels", "dataset", "session-bare", "trc"])
def test_sealing_leaves_what_is_right_as_it_is(tmp_path, name):
    for data in Fuzzer(READERS[name], tmp_path).files.values():
        assert seal(data) == data


@given(st.integers(0, 2**32))
def test_a_sealed_image_has_right_sums_where_its_chunks_are_whole(seed):
    rng = random.Random(seed)
    image = png(np.zeros((9, 9), np.uint16))
    at = rng.randrange(len(image) - 40, len(image) - 16) if rng.random() < 0.5 else rng.randrange(16, 29)
    spoilt = image[:at] + bytes([image[at] ^ (1 + rng.randrange(255))]) + image[at + 1 :]
    assert not sums_are_right(spoilt) and sums_are_right(seal(spoilt))


def sums_are_right(image: bytes) -> bool:
    at, right = 8, True
    while at < len(image):
        end = at + 8 + int.from_bytes(image[at : at + 4])
        right &= crc32(image[at + 4 : end]) == int.from_bytes(image[end : end + 4])
        at = end + 4
    return right


@given(st.integers(0, 2**32))
def test_a_sealed_archive_opens_whatever_its_first_header_says(seed):
    rng = random.Random(seed)
    shard = bytearray(encode_shard([labelled(0)]))
    shard[rng.randrange(100, 107)] ^= 1 << rng.randrange(3)  # the mode's digits
    with tarfile.open(fileobj=io.BytesIO(seal(bytes(shard)))) as tar:
        assert len(tar.getnames()) > 1


@given(st.binary(max_size=300), st.integers(0, 2**32))
def test_mutating_and_sealing_take_any_bytes_and_say_the_same_twice(data, seed):
    once, again = (seal(mutate(data, random.Random(seed))) for _ in range(2))
    assert once == again


@pytest.mark.parametrize("kept", sorted(path.name for path in CORPUS.iterdir()))
def test_what_was_found_stays_mended(tmp_path, kept, capfd):
    name = next(name for name in sorted(READERS, key=len, reverse=True) if kept.startswith(name))
    fuzzer = Fuzzer(READERS[name], tmp_path)
    shutil.rmtree(fuzzer.spoilt)
    shutil.copytree(CORPUS / kept, fuzzer.spoilt)
    assert not fuzzer.finding()
