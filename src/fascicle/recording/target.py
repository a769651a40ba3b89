"""Targets of the inference: aligned beats of a recording, with QRS window and variability."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core import above, html_card
from fascicle.core.arrays import Booleans, Floats
from fascicle.core.files import as_path
from fascicle.core.leads import LEADS
from fascicle.core.ranges import short_repr
from fascicle.recording.criteria import Criterion, conventional_criteria
from fascicle.recording.filters import SAMPLING_STEP, Filter


@dataclass(frozen=True)
class Target:
    """Beats of one recording, aligned at the R peak and detrended, and their QRS window.

    Attributes
    ----------
    beats : (n_beats, 12 + k, n_time) array
        Potential (mV), leads in the order of `fascicle.core.leads.LEADS`, then additional ones;
        isoelectric level removed. Leads that are not used are NaN in every beat.
    time : (n_time,) array
        Time from the R peak (ms), every `SAMPLING_STEP`.
    qrs_onset, qrs_offset : float
        QRS (ms from the R peak), determined from all leads.
    heart_rate : float, optional
        Beats per minute; None if unknown, as of a single beat.
    provenance : dict
        Text about the origin of the target: source file, its hash, choices made.
    onset_sd, offset_sd : float
        Standard deviations of the ends of the window (ms); 0 where the user has given them.
    noise : float, optional
        Standard deviation of every sample (mV), stated by the user; needed for a single beat.
    filters : tuple of Filter
        Filters that the beats have passed, as far as known; simulated ECGs are filtered likewise.
    earliest_onset : float, optional
        End of the pacing spike (ms from the R peak), before which no QRS begins; None without one.
    leads : tuple of str
        Names of the leads.
    warnings : tuple of str
        Warnings that must be reported with any results, one a line.
    """

    beats: Floats
    time: Floats
    qrs_onset: float
    qrs_offset: float
    heart_rate: float | None
    provenance: dict[str, str] = field(default_factory=dict)
    onset_sd: float = 0.0
    offset_sd: float = 0.0
    noise: float | None = None
    filters: tuple[Filter, ...] = ()
    earliest_onset: float | None = None
    leads: tuple[str, ...] = LEADS
    warnings: tuple[str, ...] = ()

    __repr__ = short_repr
    _repr_html_ = html_card

    def plot(self) -> list[Any]:
        """Draw the target by `fascicle.plot.target`; returns Matplotlib axes."""
        return list(above("plot").target(self))

    def save(self, path: Path | str) -> None:
        """Write the target as netCDF-4; `fascicle.read_target` reads it."""
        above("recording.target_files").write_target(self, as_path(path, "path"))

    def in_leads(self, leads: Sequence[str]) -> Target:
        """Return the target with `leads` as rows; leads that it lacks are NaN and not used.

        ``provenance["leads_left_out"]`` names its other leads.
        """
        if tuple(leads) == self.leads:
            return self
        beats = np.full((len(self.beats), len(leads), len(self.time)), np.nan)
        for row, lead in enumerate(leads):
            if lead in self.leads:
                beats[:, row] = self.beats[:, self.leads.index(lead)]
        left_out = ", ".join(lead for lead in self.leads if lead not in leads)
        notes = self.provenance | ({"leads_left_out": left_out} if left_out else {})
        return replace(self, beats=beats, leads=tuple(leads), provenance=notes)

    @cached_property
    def used(self) -> Booleans:
        """Whether each lead is used, shape (12 + k,)."""
        return np.asarray(np.isfinite(self.beats[0]).all(axis=1))

    @cached_property
    def mean(self) -> Floats:
        """Mean beat (mV), shape (12 + k, n_time)."""
        return np.asarray(self.beats.mean(axis=0))

    @cached_property
    def standard_deviation(self) -> Floats:
        """Beat-to-beat standard deviation (mV), shape (12 + k, n_time)."""
        if self.noise is not None:
            return np.where(self.used[:, None], self.noise, np.nan) * np.ones(len(self.time))
        return np.asarray(self.beats.std(axis=0, ddof=1))

    @property
    def response(self) -> Callable[[Floats], Floats] | None:
        """Gain of all filters as a function of frequency (cycles per sample); None without any."""
        return self._gain if self.filters else None

    def _gain(self, frequency: Floats) -> Floats:
        hertz = frequency * (1000.0 / SAMPLING_STEP)
        return np.asarray(np.prod([filter_.gain(hertz) for filter_ in self.filters], axis=0))

    @property
    def qrs_duration(self) -> float:
        """QRS duration (ms)."""
        return self.qrs_offset - self.qrs_onset

    @cached_property
    def conventional_criteria(self) -> tuple[Criterion, ...]:
        """Conventional ECG criteria of conduction disturbances, evaluated on the mean beat."""
        window = self.qrs_samples
        return conventional_criteria(self.mean, window.start, window.stop - 1, self.leads)

    @property
    def qrs_samples(self) -> slice:
        """Samples of `time` inside the QRS window, both ends included."""
        inside = np.flatnonzero((self.time >= self.qrs_onset) & (self.time <= self.qrs_offset))
        return slice(int(inside[0]), int(inside[-1]) + 1)

    @property
    def qrs(self) -> Floats:
        """Mean QRS (mV), shape (12 + k, n_qrs)."""
        return np.asarray(self.mean[:, self.qrs_samples])

    @property
    def qrs_beats(self) -> Floats:
        """QRS of every beat (mV), shape (n_beats, 12 + k, n_qrs)."""
        return np.asarray(self.beats[:, :, self.qrs_samples])


@dataclass(frozen=True)
class ResidualCovariance:
    """Covariance of the beats about their mean, within the QRS.

    The covariance of lead l at time t with lead m at time s is
    ``sd[l, t] * sd[m, s] * leads[l, m] * time[t, s]``. A shrinkage is the weight of the identity in
    a correlation: near 0 with many beats, 1 if the beats are no evidence of any correlation.
    """

    sd: Floats  # (n_leads, n_qrs) mV, of every sample; NaN where a lead is not used
    leads: Floats  # (n_leads, n_leads), correlation; NaN where a lead is not used
    time: Floats  # (n_qrs, n_qrs), correlation across samples of the QRS
    shrinkage_leads: float
    shrinkage_time: float


def residual_covariance(target: Target) -> ResidualCovariance:
    """Estimate the covariance of a target's beats about their mean, within the QRS.

    The correlation is taken as separable: the product of one between leads, estimated over all
    times, and one between times, estimated over all leads. Each is shrunk towards the identity by
    the weight of Ledoit and Wolf (2004, J. Multivar. Anal. 88:365), with beats as the independent
    samples. With a stated noise, samples and leads are taken as independent.
    """
    window, used = target.qrs_samples, target.used
    sd = target.standard_deviation[:, window]
    if target.noise is not None:
        leads, time, weights = np.eye(len(sd)), np.eye(sd.shape[1]), (1.0, 1.0)
    else:
        residual = (target.qrs_beats - target.qrs)[:, used]
        scores = residual / np.maximum(sd[used], np.finfo(float).tiny)
        leads = np.eye(len(sd))
        leads[np.ix_(used, used)], by_lead = _correlation(scores)
        time, by_time = _correlation(scores.transpose(0, 2, 1))
        weights = by_lead, by_time
    leads[~used] = leads[:, ~used] = np.nan
    return ResidualCovariance(sd, leads, time, *weights)


def _correlation(scores: Floats) -> tuple[Floats, float]:
    """Shrunk correlation (p, p) of scores (n_beats, p, q), and the weight of the shrinkage."""
    by_beat = scores @ scores.transpose(0, 2, 1) / scores.shape[2]
    n, raw = len(by_beat), by_beat.mean(axis=0)
    identity = np.eye(len(raw)) * np.trace(raw) / len(raw)
    structure = ((raw - identity) ** 2).sum()
    if n < 3 or not structure > 0:  # deviations of two beats from their mean are opposite
        return np.eye(len(raw)), 1.0
    # n(n - 2), not n(n - 1): the residuals are about the mean of the same beats
    weight = float(min(((by_beat - raw) ** 2).sum() / (n * (n - 2)) / structure, 1.0))
    shrunk = (1 - weight) * raw + weight * identity
    root = np.sqrt(np.maximum(np.diag(shrunk), np.finfo(float).tiny))
    return shrunk / np.outer(root, root), weight


def repeated(target: Target, rng: np.random.Generator) -> Target:
    """Target of ten simulated repetitions of a single beat, with its stated noise.

    Their mean is the recorded beat.
    """
    assert target.noise is not None
    noise = smooth_noise(rng, (10, *target.beats.shape[1:]), target.noise)
    noise -= noise.mean(axis=0)
    return replace(target, beats=target.beats + noise, noise=None)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], sd: float) -> Floats:
    """Noise of standard deviation `sd` (mV), correlated over some ms along the last axis, time."""
    smooth = gaussian_filter1d(rng.standard_normal(shape), 4.0 / SAMPLING_STEP, axis=-1)  # ms
    return np.asarray(smooth * (sd / smooth.std()))
