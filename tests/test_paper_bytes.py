"""Label sets, datasets and exports of the paper's parts keep the bytes of version 0.3."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from annotate.exchange.formats import FORMATS, export_labels
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import encode_shard
from annotate.labelset.label_set import MANIFEST, LabelSet
from sensors.rig.camera import Intrinsics

CAMERA = Intrinsics(24, 18, 20.0, 20.0, 11.5, 8.5)
DIGESTS = {
    "label set": "700410d1c89912df90bd6779c1961aa9037bc1398cfcd91b59e69ccd6c99a0e5",
    "shard": "3050813b36e61d3d454082559181829bc120618ab916bd2ab8241e6c33bd1ffc",
    "pairs": "d19c96319ee8f97464a2f81ec14396ffb5e840338aef292c239cf19ad9a41329",
    "mmseg": "4ad3766b5bf49a29ff9cccc6d54a8bccf9118b475bfc8d92ec927a931fdadf37",
    "coco": "f6d304ec580c6ec16c41504e9323a850d130824c4134fa8b1231a959460f37f0",
    "cvat": "ab87da098988f029b50f1194d1c9d8a9224cb7702b3cf300032739dd11732504",
    "pcd": "59205f2706c7b9f52338db0e651bec2c8693e9bc3f75777ae7c69e25e8d981f7",
    "ply": "96d87c785a9e5698083e6dd5460f2b7c4d4fec5ffef4317d3a2f8cab5d0e4d74",
    "semantic-kitti": "7d2c327a3f90e3568622db740b9284920431724bf8e52606c5e92cd1f0be81ae",
    "parquet": "5b056b4569d117508b1b7051b3bcf50509841e2e656a74c8c4959fbfa83bbc4b",
}
"""SHA-256 of what commit d4896c61 wrote, which knew the paper's parts alone."""


def frames() -> list[FrameLabels]:
    found = []
    for number in range(2):
        rows, columns = np.mgrid[:18, :24]
        parts = ((rows // 3 + 2 * (columns // 4) + number) % 13).astype(np.uint8)
        parts[parts == 12] = 255
        depth = (1500 + 17 * rows + 3 * columns + number).astype(np.uint16)
        depth[:2], parts[:2] = 0, 0
        confidence = ((rows * 24 + columns) % 256 / np.float32(255)).astype(np.float32)
        persons = (parts > 0).astype(np.uint8)
        notes = {"why": "half hidden", "n": [1, None, 0.5]}
        frame = FrameLabels(f"{number:06d}", depth, parts, confidence, "corrected", "P1", notes, persons)
        found.append(frame)
    return found


def written(path: Path) -> LabelSet:
    labels = LabelSet.create(path, CAMERA, {"source": "test", "steps": {}})
    for frame in frames():
        labels.write(frame)
    return labels


def digest(folder: Path) -> str:
    """Return the SHA-256 of names and contents of all files, without the versions of programs."""
    found = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        data = file.read_bytes()
        if file.name == MANIFEST:
            manifest = json.loads(data)
            del manifest["versions"]
            data = json.dumps(manifest).encode()
        found.update(f"{file.relative_to(folder)} {len(data)}\n".encode() + data)
    return found.hexdigest()


def test_a_label_set_of_the_paper_keeps_its_bytes(tmp_path):
    assert digest(written(tmp_path / "set").path) == DIGESTS["label set"]


def test_a_shard_of_the_paper_keeps_its_bytes():
    assert hashlib.sha256(encode_shard(frames())).hexdigest() == DIGESTS["shard"]


@pytest.mark.parametrize("name", sorted(FORMATS.keys() - {"parquet"}))
def test_an_export_of_the_paper_keeps_its_bytes(name, tmp_path):
    export_labels(written(tmp_path / "set"), tmp_path / name, name, lambda _: None)
    assert digest(tmp_path / name) == DIGESTS[name]


def test_the_images_in_parquet_keep_their_bytes(tmp_path):
    pytest.importorskip("pyarrow")
    import pyarrow.parquet

    export_labels(written(tmp_path / "set"), tmp_path / "out", "parquet", lambda _: None)
    (file,) = (tmp_path / "out" / "data").iterdir()
    rows = pyarrow.parquet.read_table(file).to_pylist()
    assert [row.pop("classes") for row in rows] == [[*range(12)]] * 2
    assert hashlib.sha256(repr(rows).encode()).hexdigest() == DIGESTS["parquet"]
