"""Agreement of the networks' ECGs with the recorded QRS, lead by lead and over all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS
from fascicle.networks.target_comparison import Network
from fascicle.recording.criteria import frontal_axis
from fascicle.recording.target import Target


@dataclass(frozen=True)
class Agreement:
    """Agreement of the networks' mean ECG with the recorded mean beat, within the QRS window.

    Attributes
    ----------
    leads : tuple of str
        The leads of the heart.
    explained, correlation : (n_leads,) arrays
        For each lead: explained power, 1 − Σ(recorded − predicted)² / Σ recorded²; Pearson's
        correlation. NaN where a lead is not used.
    explained_over_all, correlation_over_all : float
        Explained power and correlation over all leads together.
    recorded, predicted : dict of str to float, and to (n,) array
        QRS duration (ms) and frontal axis (degrees): recorded, and of each network. Axes are within
        half a turn of the recorded one.
    """

    leads: tuple[str, ...]
    explained: Floats
    correlation: Floats
    explained_over_all: float
    correlation_over_all: float
    recorded: dict[str, float]
    predicted: dict[str, Floats]

    def percentiles(self, name: str) -> tuple[float, float, float]:
        """5th percentile, median and 95th percentile of a predicted quantity over the networks."""
        low, middle, high = np.percentile(self.predicted[name], (5, 50, 95))
        return float(low), float(middle), float(high)

    def content(self) -> dict[str, Any]:
        """Agreement for a summary; None for leads that are not used."""

        def by_lead(values: Floats, over_all: float) -> dict[str, float | None]:
            values_by_lead = {
                lead: round(float(v), 6) if np.isfinite(v) else None
                for lead, v in zip(self.leads, values, strict=True)
            }
            return values_by_lead | {"all": round(over_all, 6)}

        content: dict[str, Any] = {
            "explained_power": by_lead(self.explained, self.explained_over_all),
            "correlation": by_lead(self.correlation, self.correlation_over_all),
        }
        for name, value in self.recorded.items():
            shares = (round(share, 3) for share in self.percentiles(name))
            networks = dict(zip(("5 %", "median", "95 %"), shares, strict=True))
            content[name] = {"recorded": round(value, 3), "networks": networks}
        return content


def agreement(target: Target, networks: Sequence[Network]) -> Agreement:
    """Measure how networks, simulated in the scenario of a recording, agree with it."""
    window = target.qrs_samples
    recorded = np.where(target.used[:, None], target.mean[:, window], np.nan)
    predicted = np.mean([network.predicted[:, window] for network in networks], axis=0)
    used = target.used
    residual = ((recorded - predicted) ** 2).sum(axis=1)
    power = (recorded**2).sum(axis=1)
    correlation = np.full(len(used), np.nan)
    pairs = zip(recorded[used], predicted[used], strict=True)
    correlation[used] = [pearson(*pair) for pair in pairs]
    simulated_values = {"qrs_duration_ms": [network.beat.qrs_duration for network in networks]}
    recorded_values = {"qrs_duration_ms": target.qrs_duration}
    if used[: len(LIMB_LEADS)].all():
        axis = recorded_values["axis_degrees"] = frontal_axis(recorded)
        turns = [frontal_axis(network.predicted[:, window]) - axis for network in networks]
        simulated_values["axis_degrees"] = [axis + (turn + 180) % 360 - 180 for turn in turns]
    return Agreement(
        target.leads,
        1 - residual / power,
        correlation,
        float(1 - residual[used].sum() / power[used].sum()),
        pearson(recorded[used].ravel(), predicted[used].ravel()),
        recorded_values,
        {name: np.array(values, dtype=float) for name, values in simulated_values.items()},
    )


def pearson(x: Floats, y: Floats) -> float:
    """Pearson's correlation of values (n,); 0 if either is constant."""
    x, y = x - x.mean(), y - y.mean()
    size = float(np.sqrt((x**2).sum() * (y**2).sum()))
    return float((x * y).sum() / size) if size else 0.0
