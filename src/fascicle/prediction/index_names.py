"""Names of the indices, with units. Nothing heavy is imported: the command line lists them."""

from __future__ import annotations

from fascicle.core.errors import InputError
from fascicle.core.ranges import shown

INDICES = {
    "qrs_duration": "ms",
    "qrs_from_stimulus": "ms",
    "total_activation_time": "ms",
    "lv_activation_time": "ms",
    "rv_activation_time": "ms",
    "activation_time_90": "ms",
    "activation_time_95": "ms",
    "lv_rv_delay": "ms",
    "lv_dyssynchrony": "ms",
    "latest_segment": "1",
    "v6_r_wave_peak_time": "ms",
    "v6_v1_interpeak_interval": "ms",
    "qrs_area": "µVs",
}
"""Names of the indices, and their units."""

# Indices for which lower is better; for LV-RV delay, a lower absolute value
COMPARED = (
    "qrs_duration", "total_activation_time", "lv_activation_time",
    "rv_activation_time", "activation_time_90", "activation_time_95", "lv_rv_delay",
    "lv_dyssynchrony", "qrs_area",
)  # fmt: skip


def check_index(index: str) -> None:
    """Refuse an index that is not in `COMPARED`."""
    if not isinstance(index, str) or index not in COMPARED:
        raise InputError(
            f"index {shown(index)} is not compared; choose one of {', '.join(COMPARED)}"
        )
