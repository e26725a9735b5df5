"""What tests share: the folder of real recordings, where there is one."""

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings beside the checkout; a test that asks for it skips without it."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no real recordings: ../shared/data is absent")
    return SHARED_DATA
