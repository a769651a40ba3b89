"""Where the real data are."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DEFAULT_DATA = REPOSITORY.parent / "shared" / "data"


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of real recordings and hearts; tests that need it skip where it is missing."""
    folder = Path(os.environ.get("FASCICLE_TEST_DATA", DEFAULT_DATA))
    if not (folder / "ecg").is_dir():
        pytest.skip(f"no test data in {folder}; set FASCICLE_TEST_DATA")
    return folder
