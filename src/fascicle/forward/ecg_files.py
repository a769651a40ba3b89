"""Simulated ECGs as CSV: time_ms, then the twelve leads in mV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from fascicle.core.files import write_text
from fascicle.core.leads import LEADS


def write_ecg(path: Path, ecg: xr.DataArray) -> None:
    """Write an ECG (lead × time, mV) as CSV with the columns time_ms, I … V6."""
    rows = np.column_stack([ecg["time"].to_numpy(), ecg.sel(lead=list(LEADS)).to_numpy().T])
    lines = [",".join(["time_ms", *LEADS])]
    lines += [",".join([f"{row[0]:g}", *(f"{value:.6f}" for value in row[1:])]) for row in rows]
    write_text(path, "\n".join(lines) + "\n")
