"""How much memory there is."""

from __future__ import annotations

import os
from pathlib import Path


def available_memory() -> float:
    """Memory that programs may still take (bytes); infinite where the system does not say."""
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():  # Linux, which counts what its caches would give back
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    if "SC_PHYS_PAGES" in getattr(os, "sysconf_names", {}):
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return float("inf")
