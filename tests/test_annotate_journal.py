"""The journal keeps every finished line, whatever happens to the last one, and checks each."""

import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import largest_file
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.labelset.claim import Claim, ClaimedError
from annotate.labelset.journal import Journal, NotSavedError
from annotate.labelset.stroke import Gesture, Stroke, from_line, to_line
from annotate.parts import N_CLASSES, UNDEFINED
from sensors.errors import CloudError, FormatError

law = settings(deadline=None, max_examples=50)

texts = st.text(max_size=20)
seconds = st.floats(0, 1e6, allow_nan=False)


@st.composite
def strokes(draw) -> Stroke:
    lengths = draw(st.lists(st.tuples(st.integers(1, 9), st.integers(0, 9)), max_size=6))
    ids = st.sampled_from([*range(N_CLASSES), UNDEFINED])
    runs, at = [], 0
    for length, gap in lengths:
        old, new = draw(st.lists(ids, min_size=2, max_size=2, unique=True))
        runs.append((at + gap, length, old, new))
        at += gap + length
    how = Gesture("brush", draw(st.integers(0, 9)), draw(st.integers(0, 99)), draw(seconds), 1)
    return Stroke(
        draw(texts),
        draw(st.sampled_from(["paint", "merge", "reject", "leave"])),
        np.array(runs, np.int64).reshape(-1, 4),
        draw(st.none() | ids),
        how,
        draw(texts),
        draw(texts),
        draw(st.dictionaries(st.sampled_from(["looking", "painting", "navigating"]), seconds)),
        draw(texts),
    )


def stroke(i: int = 0, frame_id: str = "a", n: int = 1) -> Stroke:
    runs = np.array([[4 * k, 2, 0, 1 + (i + k) % 11] for k in range(n)], np.int64)
    return Stroke(
        frame_id, "paint", runs, 1 + i % 11, Gesture("lasso", points=i), "ann", "2026", {"painting": 1.5}
    )


def written(folder, *strokes: Stroke) -> Journal:
    """The journal of a folder after these strokes."""
    journal = Journal.of(folder)
    for each in strokes:
        journal.add(each)
    journal.flush()
    return journal


def lines_of(journal: Journal) -> list[bytes]:
    """Its strokes as lines, by frame; where all frames' order counts, compare the file."""
    return [to_line(each) for i in journal.frame_ids for each in journal.strokes(i)]


@given(one=strokes())
@law
def test_a_line_is_a_stroke_and_back(one):
    line = to_line(one)
    assert line.count(b"\n") == 1
    assert to_line(from_line(line)) == line
    np.testing.assert_array_equal(from_line(line).runs, one.runs)


def test_strokes_are_written_as_they_come_and_found_again_by_frame(tmp_path):
    strokes = [stroke(i, "ba"[i % 2]) for i in range(6)]
    journal = written(tmp_path, *strokes[:2])
    for each in strokes[2:]:
        journal.add(each)
        journal.flush()
    assert journal.path.read_bytes() == b"".join(map(to_line, strokes))
    again = Journal.of(tmp_path)
    assert lines_of(again) == lines_of(journal)
    assert [each.how.points for each in again.strokes("a")] == [1, 3, 5]
    assert again.frame_ids == ["a", "b"] and len(again) == 6 and again.strokes("c") == ()


def test_a_line_cut_off_anywhere_costs_that_line_only(tmp_path):
    journal = written(tmp_path, stroke(0), stroke(1))
    whole = journal.path.read_bytes()
    first = len(to_line(stroke(0)))
    for cut in range(first, len(whole)):
        journal.path.write_bytes(whole[:cut])
        assert len(Journal.of(tmp_path)) == 1
        assert journal.path.read_bytes() == whole[:cut]
        written(tmp_path, stroke(2))
        assert lines_of(Journal.of(tmp_path)) == [to_line(stroke(0)), to_line(stroke(2))]


def test_who_reads_beside_a_writer_gets_whole_lines_that_were_there(tmp_path):
    """The writer cuts off a torn line, and what it appends reaches further than that did."""
    written(tmp_path, stroke(0))
    journal = Journal.of(tmp_path)
    whole = journal.path.read_bytes()
    journal.path.write_bytes(whole + to_line(stroke(1))[:-20])
    reading = journal._lines()
    first = next(reading)
    written(tmp_path, stroke(2), stroke(3))
    assert [first, *reading] == [whole]
    assert len(Journal.of(tmp_path)) == 3


def test_a_torn_line_longer_than_the_next_is_cut_off(tmp_path):
    journal = written(tmp_path, stroke(0))
    with journal.path.open("ab") as file:
        file.write(to_line(stroke(1, n=200))[:-1])
    written(tmp_path, stroke(2))
    assert journal.path.read_bytes() == to_line(stroke(0)) + to_line(stroke(2))


GOOD = json.loads(to_line(stroke()))
HOSTILE = {
    "no JSON": b"paint everything",
    "bytes": b"\xff\xfe\x00",
    "a list": b"[1, 2]",
    "too deep": b"[" * 100_000,
    "a huge number": b'{"runs": [' + b"9" * 5000 + b"]}",
    "an empty object": b"{}",
    **{
        name: json.dumps({**GOOD, **change}).encode()
        for name, change in {
            "another field": {"shell": "rm"},
            "a missing frame": {"frame_id": None},
            "a name of no text": {"who": 7},
            "an unknown operation": {"operation": "format"},
            "an operation of no text": {"operation": ["paint"]},
            "part 12": {"part": 12},
            "part true": {"part": True},
            "an unknown gesture": {"how": {"kind": "telepathy"}},
            "negative clicks": {"how": {"clicks": -1}},
            "a gesture of no object": {"how": 7},
            "negative seconds": {"seconds": {"painting": -1}},
            "not a number of seconds": {"seconds": {"painting": float("nan")}},
            "endless seconds": {"seconds": {"painting": float("inf")}},
            "an unknown activity": {"seconds": {"sleeping": 1}},
            "seconds of no object": {"seconds": 4},
            "three numbers": {"runs": [0, 1, 0]},
            "fractions": {"runs": [0.5, 1, 0, 1]},
            "truths": {"runs": [0, True, 0, 1]},
            "runs of no list": {"runs": "0101"},
            "a pixel before the image": {"runs": [-1, 1, 0, 1]},
            "a pixel beyond any image": {"runs": [1 << 62, 1, 0, 1]},
            "a number beyond 64 bits": {"runs": [1 << 70, 1, 0, 1]},
            "an endless run": {"runs": [0, 1 << 40, 0, 1]},
            "overlapping runs": {"runs": [0, 5, 0, 1, 2, 5, 0, 1]},
            "unsorted runs": {"runs": [5, 1, 0, 1, 0, 1, 0, 1]},
            "an empty run": {"runs": [0, 0, 0, 1]},
            "a run that changes nothing": {"runs": [0, 1, 1, 1]},
            "part 254": {"runs": [0, 1, 0, 254]},
            "from part 254": {"runs": [0, 1, 254, 1]},
        }.items()
    },
}


@pytest.mark.parametrize("line", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_line_that_is_no_stroke_is_named(tmp_path, line):
    journal = written(tmp_path, stroke())
    with journal.path.open("ab") as file:
        file.write(line + b"\n" + to_line(stroke()))
    before = journal.path.read_bytes()
    with pytest.raises(FormatError, match=r"journal\.jsonl line 2: .*; restore it") as refusal:
        Journal.of(tmp_path)
    assert len(str(refusal.value)) < 500
    assert journal.path.read_bytes() == before


def test_a_journal_as_large_as_the_bound_is_read_and_a_larger_one_refused(tmp_path, monkeypatch):
    journal = written(tmp_path, stroke())
    size = journal.path.stat().st_size
    monkeypatch.setattr("annotate.labelset.journal.MAX_BYTES", size)
    assert len(Journal.of(tmp_path)) == 1
    monkeypatch.setattr("annotate.labelset.journal.MAX_BYTES", size - 1)
    with pytest.raises(FormatError, match=f"larger than {size - 1} bytes"):
        Journal.of(tmp_path)


def test_a_full_disk_keeps_whole_lines_and_the_rest_waits_in_memory(tmp_path):
    journal = written(tmp_path, stroke(0))
    whole = journal.path.read_bytes()
    with largest_file(len(whole) + 50):
        for i in (1, 2):
            journal.add(stroke(i))
            with pytest.raises(NotSavedError, match=f"{i} strokes are kept in memory"):
                journal.flush()
            assert journal.path.read_bytes() == whole and len(journal.pending) == i
    journal.flush()
    assert not journal.pending
    assert lines_of(Journal.of(tmp_path)) == [to_line(stroke(i)) for i in range(3)]
    journal.path.write_bytes(b"")
    journal.add(stroke())
    with pytest.raises(NotSavedError, match="shortened"):
        journal.flush()
    assert journal.path.read_bytes() == b"", "shortened by something else, so not written over"


# One writer


def test_a_second_writer_is_told_the_first_ones_name(tmp_path):
    claim = Claim.take(tmp_path, "ann")
    with pytest.raises(ClaimedError, match=r"ann@.*\(process \d+, since 20.*read-only"):
        Claim.take(tmp_path, "bob")
    claim.release()
    claim.release()
    assert not list(tmp_path.iterdir())
    Claim.take(tmp_path, "bob").release()


HOLD = """
import sys
from pathlib import Path
from annotate.labelset.claim import Claim
claim = Claim.take(Path(sys.argv[1]), "ann")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_killed_writer_leaves_no_claim(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(ClaimedError, match=rf"ann@.*process {process.pid}\b"):
            Claim.take(tmp_path, "bob")
        process.kill()
        process.wait()
    assert (tmp_path / "claim.json").is_file()
    Claim.take(tmp_path, "bob").release()


@pytest.mark.parametrize("says", [b"", b"\xff", b"[]", b'{"who": []}', b"[" * 5000])
def test_a_claim_that_says_nonsense_still_holds(tmp_path, says):
    claim = Claim.take(tmp_path, "ann")
    (tmp_path / "claim.json").write_bytes(says)
    with pytest.raises(ClaimedError, match="written by another process"):
        Claim.take(tmp_path, "bob")
    claim.release()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(CloudError, match="absent cannot be written to"):
        Claim.take(tmp_path / "absent", "ann")
