"""A recording is locked while it is written: whatever else is run on it, nothing of it is lost."""

import subprocess
import sys
from pathlib import Path

import pytest

import sensors.session.repair
from sensors.errors import CloudError, ExistsError
from sensors.session.reader import Session
from sensors.session.repair import repair
from sensors.session.writer import SessionWriter
from tests.conftest import assert_refused
from tests.test_sensors_session import RIG, assert_same, frames

RECORDS = """
import sys
from pathlib import Path
from sensors.session.writer import SessionWriter
from tests.test_sensors_session import RIG, frames
with SessionWriter(Path(sys.argv[1]), RIG, "rig") as writer:
    for frame in frames(20)[:10]:
        writer.write(frame)
    print("ready", flush=True)
    sys.stdin.readline()
    for frame in frames(20)[10:]:
        writer.write(frame)
"""


@pytest.fixture
def recorder(tmp_path):
    """Another process that has recorded 10 frames, and records 10 more after a line."""
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDS, str(tmp_path / "take.mcap")],
        cwd=Path(__file__).parent.parent,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout.readline() == b"ready\n"
    yield process
    process.kill()
    process.communicate()


def test_nothing_that_is_run_during_a_recording_harms_it(annotate_cloud, tmp_path, recorder):
    path, partial = tmp_path / "take.mcap", tmp_path / "take.mcap.partial"
    assert_refused(annotate_cloud("repair", path), "is being recorded; end the recording first")
    assert_refused(annotate_cloud("repair", partial, "--out", tmp_path / "out.mcap"), "is being recorded")
    info = annotate_cloud("info", path, "--json").result
    assert (info["frames"], info["being_recorded"]) == (10, True)
    assert "is being recorded" in " ".join(info["notes"])
    checked = annotate_cloud("validate", path)
    assert checked.code == 1 and "is being recorded" in checked.out
    for text in (*info["notes"], checked.out, annotate_cloud("info", partial).out):
        assert "repair" not in text
    with (
        pytest.raises(CloudError, match="in use by another program"),
        SessionWriter(path, RIG, "other", overwrite=True),
    ):
        pass
    assert recorder.communicate(b"\n") == (b"", None) and recorder.returncode == 0
    assert [file.name for file in tmp_path.iterdir()] == ["take.mcap"]
    for original, copy in zip(frames(20), Session(path), strict=True):
        assert_same(original, copy)


def test_a_recording_without_a_frame_yet_is_no_damage(tmp_path):
    with SessionWriter(tmp_path / "a.mcap", RIG, "rig") as writer:
        writer.flush()
        with pytest.raises(CloudError, match="is being recorded"):
            Session(tmp_path / "a.mcap")
        writer.write(frames(1)[0])


def test_a_killed_recording_holds_no_lock(annotate_cloud, tmp_path, recorder):
    recorder.kill()
    recorder.communicate()
    info = annotate_cloud("info", tmp_path / "take.mcap", "--json").result
    assert not info["being_recorded"] and "annotate-cloud repair" in " ".join(info["notes"])
    assert repair(tmp_path / "take.mcap").frames == 10


def test_a_file_that_came_to_the_name_during_a_recording_stays(tmp_path):
    path, partial = tmp_path / "take.mcap", tmp_path / "take.mcap.partial"
    with pytest.raises(ExistsError, match="rename it"), SessionWriter(path, RIG, "rig") as writer:
        for frame in frames(5):
            writer.write(frame)
        path.write_bytes(b"precious")
    assert path.read_bytes() == b"precious"
    session = Session(partial)
    assert not session.truncated
    for frame, written in zip(session, frames(5), strict=True):
        assert_same(frame, written)


def test_a_file_that_came_to_the_name_during_a_repair_stays(tmp_path, monkeypatch):
    path, out = tmp_path / "take.mcap", tmp_path / "take.repaired.mcap"
    with SessionWriter(path, RIG, "rig") as writer:
        for frame in frames(5):
            writer.write(frame)
    path.write_bytes(path.read_bytes()[:-100])
    rewrite = sensors.session.repair._rewrite

    def slow(*arguments):
        out.write_bytes(b"precious")
        return rewrite(*arguments)

    monkeypatch.setattr(sensors.session.repair, "_rewrite", slow)
    with pytest.raises(ExistsError):
        repair(path)
    assert out.read_bytes() == b"precious" and len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("moved", [True, False], ids=["moved", "removed"])
def test_a_writer_never_names_another_program_s_file(tmp_path, moved):
    path, partial = tmp_path / "take.mcap", tmp_path / "take.mcap.partial"
    with pytest.raises(FileNotFoundError), SessionWriter(path, RIG, "rig") as writer:
        for frame in frames(5):
            writer.write(frame)
        assert writer.is_in_place()
        partial.rename(tmp_path / "elsewhere") if moved else partial.unlink()
        partial.write_bytes(b"precious")
        assert not writer.is_in_place()
    assert partial.read_bytes() == b"precious" and not path.exists()
    if moved:
        assert len(Session(tmp_path / "elsewhere")) == 5


def test_a_recording_that_is_completed_as_its_repair_begins_is_left_alone(tmp_path, monkeypatch):
    path, partial = tmp_path / "take.mcap", tmp_path / "take.mcap.partial"
    with SessionWriter(path, RIG, "rig") as writer:
        for frame in frames(5):
            writer.write(frame)
    whole = path.read_bytes()
    path.rename(partial)
    check = sensors.session.repair.check_ended
    monkeypatch.setattr(
        sensors.session.repair, "check_ended", lambda file: (check(file), partial.rename(path))
    )
    with pytest.raises(CloudError, match=r"was completed meanwhile; use .*take\.mcap$"):
        repair(partial)
    assert path.read_bytes() == whole and len(list(tmp_path.iterdir())) == 1
