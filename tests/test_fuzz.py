"""Readers of files from outside: whatever is in one, it is read or refused in one line."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tools.fuzz.reader import Sample
from tools.fuzz.samples import READERS

CORPUS = Path(__file__).parent / "corpus"
law = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module", params=READERS)
def sample(request, tmp_path_factory) -> Sample:
    return Sample(READERS[request.param], tmp_path_factory.mktemp("sample"))


def test_what_is_whole_is_read(sample):
    fault = sample.fault({})
    assert not fault


@given(data=st.data(), content=st.binary(max_size=300))
@law
def test_a_file_of_any_bytes_is_read_or_refused_in_one_line(sample, data, content):
    path = data.draw(st.sampled_from(sorted(sample.files)))
    fault = sample.fault({path: content})
    assert not fault


@given(data=st.data(), piece=st.binary(min_size=1, max_size=40))
@law
def test_a_damaged_file_is_read_or_refused_in_one_line(sample, data, piece):
    path = data.draw(st.sampled_from(sorted(sample.files)))
    whole = sample.files[path]
    begin, end = sorted(data.draw(st.tuples(*[st.integers(0, len(whole))] * 2)))
    rest = data.draw(st.sampled_from([whole[begin + len(piece) :], whole[end:], b""]))
    fault = sample.fault({path: whole[:begin] + piece + rest})
    assert not fault


@pytest.mark.parametrize("kept", sorted(path.name for path in CORPUS.iterdir()))
def test_what_was_found_stays_mended(tmp_path, kept, capfd):
    name = next(name for name in sorted(READERS, key=len, reverse=True) if kept.startswith(name))
    found, sample = CORPUS / kept, Sample(READERS[name], tmp_path)
    files = {tmp_path / file.relative_to(found): file for file in found.rglob("*") if file.is_file()}
    fault = sample.fault({path: file.read_bytes() for path, file in files.items()})
    assert not fault
