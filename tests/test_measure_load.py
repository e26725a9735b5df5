"""The long material that a load is measured on holds what was made, under new ids."""

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import encode_shard, read_shard
from tools.load.material import renamed


def test_a_shard_under_new_ids_holds_the_same_images(tmp_path):
    rng = np.random.default_rng(0)
    depth = rng.integers(1, 9000, (3, 20, 30)).astype(np.uint16)
    parts = rng.integers(0, 12, depth.shape).astype(np.uint8)
    frames = [FrameLabels(f"{i:08d}", depth[i], parts[i], subject="s", status="truth") for i in range(3)]
    (tmp_path / "s.tar").write_bytes(renamed(encode_shard(frames), 99_998))
    again = list(read_shard(tmp_path / "s.tar"))
    assert [frame.frame_id for frame in again] == ["00099998", "00099999", "00100000"]
    for frame, i in zip(again, range(3), strict=True):
        np.testing.assert_array_equal(frame.depth_mm, depth[i])
        np.testing.assert_array_equal(frame.parts, parts[i])
