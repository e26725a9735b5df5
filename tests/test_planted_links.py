"""Links to other files in a folder from outside: nothing is written through them."""

import os
import shutil

import numpy as np
import pytest

from annotate.labelset.atomic_folder import check_replaceable
from annotate.labelset.claim import CLAIM, Claim
from annotate.labelset.journal import JOURNAL, Journal, NotSavedError
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import Stroke
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import temporary_of, write_bytes
from sensors.rig.camera import Intrinsics


@pytest.fixture
def victim(tmp_path):
    """Yield a file outside the folder, which keeps its text."""
    file = tmp_path / "victim"
    file.write_text("precious")
    yield file
    assert file.read_text() == "precious"


@pytest.fixture
def foreign(tmp_path):
    folder = tmp_path / "foreign"
    LabelSet.create(folder, Intrinsics(1, 1, 1, 1, 0, 0), {})
    return folder


def test_a_claim_that_is_a_link_is_refused(foreign, victim):
    (foreign / CLAIM).symlink_to(victim)
    for claim in (lambda: Claim.take(foreign, "ann"), lambda: check_replaceable(foreign, "labelset.json")):
        with pytest.raises(CloudError, match="cannot be written to"):
            claim()


def test_a_journal_that_is_a_link_is_refused(foreign, victim):
    journal = Journal.of(foreign)
    journal.add(Stroke("a", "leave", np.zeros((0, 4), np.int64)))
    (foreign / JOURNAL).symlink_to(victim)
    with pytest.raises(NotSavedError):
        journal.flush()
    with pytest.raises(FormatError, match="cannot be read"):
        Journal.of(foreign)
    (foreign / JOURNAL).unlink()
    os.mkfifo(foreign / JOURNAL)
    with pytest.raises(FormatError, match="is not a file"):
        Journal.of(foreign)


def test_a_temporary_file_that_is_a_link_is_not_written_through(tmp_path, victim):
    for temporary in (temporary_of(tmp_path / "x"), tmp_path / f".x.{os.getpid()}.partial"):
        temporary.symlink_to(victim)
    write_bytes(tmp_path / "x", b"new")
    assert (tmp_path / "x").read_bytes() == b"new"


@pytest.mark.parametrize("name", ["frames", "original"])
def test_a_label_set_whose_folder_is_a_link_is_refused(foreign, tmp_path, name):
    outside = tmp_path / "outside"
    outside.mkdir()
    (tmp_path / "link").symlink_to(foreign)
    LabelSet.open(tmp_path / "link")
    shutil.rmtree(foreign / name, ignore_errors=True)
    (foreign / name).symlink_to(outside)
    with pytest.raises(FormatError, match=f"{name} is a link"):
        LabelSet.open(foreign)
