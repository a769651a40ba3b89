"""Where this machine's user keeps what can be computed again."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

VARIABLE = "FASCICLE_CACHE"  # environment variable with another folder


def user_cache() -> Path:
    """Folder for what belongs to no heart and no study; it may be deleted at any time."""
    chosen = os.environ.get(VARIABLE)
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("fascicle"))
