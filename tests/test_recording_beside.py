"""The recording beside a label set is found by its name or its checksum, whatever its rig is called."""

import json
import shutil
from pathlib import Path

import pytest

from annotate.label_recording import run
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.labelset.source_recording import Recorded, find_session
from sensors.errors import ExistsError
from sensors.importers.open_source import open_source
from tests.helpers.depth_files import NUMBERS, depth_image, png, write
from tests.helpers.labellers import CloudLabeller, no_person
from tests.test_sensors_session import frames, record


def labelled(source: Path, out: Path) -> LabelSet:
    return run(open_source(source), {"label": {}}, out, CloudLabeller(no_person), lambda n: None).labels


@pytest.fixture
def people(tmp_path) -> Path:
    """A recording of the rig called "rig 7"."""
    return record(tmp_path / "people.mcap", frames(3))


def test_it_is_found_by_its_name(tmp_path, people):
    labels = labelled(people, tmp_path / "person")
    record(tmp_path / "other.mcap", frames(3, seed=1))
    assert find_session(labels) == people
    assert all(Recorded(labels, find_session(labels)).fused(frame).frame for frame in labels)


def test_it_is_found_by_its_checksum_when_it_was_renamed(tmp_path, people):
    labels = labelled(people, tmp_path / "person")
    renamed = people.rename(tmp_path / "anna.mcap")
    # Another recording has taken its name.
    record(people, frames(4, seed=1))
    assert find_session(labels) == renamed
    renamed.unlink()
    assert find_session(labels) is None


def test_old_manifests_are_found_by_the_checksum(tmp_path, people):
    labels = labelled(people, tmp_path / "person")
    manifest = json.loads((labels.path / MANIFEST).read_text())
    del manifest["recording"]
    (labels.path / MANIFEST).write_text(json.dumps(manifest))
    record(tmp_path / "a.mcap", frames(3, seed=1))
    assert find_session(LabelSet.open(labels.path)) == people


def test_a_run_goes_on_after_the_recording_was_renamed(tmp_path, people):
    labels = labelled(people, tmp_path / "person")
    again = labelled(people.rename(tmp_path / "anna.mcap"), tmp_path / "person")
    assert again.frame_ids == labels.frame_ids
    with pytest.raises(ExistsError):
        labelled(record(tmp_path / "other.mcap", frames(3, seed=1)), tmp_path / "person")


@pytest.mark.parametrize("name", ["..", "/etc/passwd", "../people.mcap", "", 3, "person"])
def test_names_from_a_manifest_stay_in_the_folder(tmp_path, people, name):
    labels = labelled(people, tmp_path / "person")
    people.unlink()
    for size in (None, 1):
        labels.info["recording"] = {"name": name, "bytes": size}
        assert find_session(labels) is None


def test_a_folder_of_images_is_found_too(tmp_path):
    folder = tmp_path / "take 1"
    write(folder / "intrinsics.json", json.dumps(NUMBERS).encode())
    for number in range(3):
        write(folder / "depth" / f"{number}.png", png(depth_image(number)))
    labels = labelled(folder, tmp_path / "labels")
    assert find_session(labels) == folder
    copy = tmp_path / "elsewhere" / "labels"
    shutil.copytree(labels.path, copy)
    assert find_session(LabelSet.open(copy)) is None
