"""Files from outside with any content are read, or refused in one line."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tools.fuzz.reader import Sample
from tools.fuzz.samples import READERS

CORPUS = Path(__file__).parent / "corpus"
law = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module", params=READERS)
def sample(request, tmp_path_factory) -> Iterator[Sample]:
    sample = Sample(READERS[request.param], tmp_path_factory.mktemp("sample"))
    assert not sample.fault({})
    yield sample
    assert not sample.fault({}), "damaged files spoilt the reader"


@given(data=st.data(), piece=st.binary(max_size=300))
@law
def test_any_bytes_and_a_damaged_file_are_read_or_refused_in_one_line(sample, data, piece):
    path = data.draw(st.sampled_from(sorted(sample.files)))
    whole = sample.files[path]
    begin, end = sorted(data.draw(st.tuples(*[st.integers(0, len(whole))] * 2)))
    rest = data.draw(st.sampled_from([whole[begin + len(piece) :], whole[end:], b""]))
    for content in (piece, whole[:begin] + piece[:40] + rest):
        fault = sample.fault({path: content})
        assert not fault


@pytest.mark.parametrize("kept", sorted(path.name for path in CORPUS.iterdir()))
def test_a_fault_of_earlier_fuzzing_stays_mended(tmp_path, kept, capfd):
    name = next(name for name in sorted(READERS, key=len, reverse=True) if kept.startswith(name))
    found, sample = CORPUS / kept, Sample(READERS[name], tmp_path)
    files = {tmp_path / file.relative_to(found): file for file in found.rglob("*") if file.is_file()}
    fault = sample.fault({path: file.read_bytes() for path, file in files.items()})
    assert not fault
