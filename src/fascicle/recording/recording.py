"""Recordings of twelve leads and additional ones, checked, and errors about missing metadata."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import CHEST_LEADS, LEADS, LIMB_LEADS, limb_leads_from
from fascicle.core.ranges import RANGES, check_array, number, short_repr


@dataclass(frozen=True)
class Filters:
    """Filters that the recorder has applied, as far as the file says (Hz)."""

    highpass: float | None = None
    lowpass: float | None = None
    notch: float | None = None


@dataclass(frozen=True)
class Recording:
    """Twelve leads of one recording, and additional ones that were recorded with them.

    Attributes
    ----------
    signal : (12, n) array
        Potential (mV), leads in the order of `fascicle.core.leads.LEADS`. A lead that was not
        recorded is NaN throughout. Where leads were recorded one group after another, as on paper,
        each is NaN outside its own stretch.
    sampling_rate : float
        Samples per second (Hz).
    source : str
        Origin, usually the file name; error messages start with it.
    provenance : dict
        Text about the file: its format, its hash; ``checksums`` is ``agree`` where they are right.
    remarks : tuple of str
        Remarks of the reader and of the checks: faults of the file and how they were mended.
    from_file, amplitude_stated : bool
        Whether the signal is that of a file, and whether the user has stated its unit or gain.
    filters : Filters
        Filters that the recorder applied to the signal.
    digits_per_millivolt : (12,) array, optional
        Gain of each lead as the file states it; NaN where it does not.
    derived : tuple of str
        Limb leads that were computed from two others.
    ignored : tuple of str
        Channels of the file that are no leads, or were not selected.
    additional : dict of str to (n,) array
        Potential (mV) of additional leads, by their names, over all of the time or, where the
        twelve were recorded one group after another, NaN outside a stretch.
    """

    signal: Floats
    sampling_rate: float
    source: str
    provenance: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    from_file: bool = False
    amplitude_stated: bool = False
    filters: Filters = field(default_factory=Filters)
    digits_per_millivolt: Floats | None = None
    derived: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    additional: dict[str, Floats] = field(default_factory=dict)

    shortest: ClassVar[float] = 0.4  # s; less does not hold a beat

    __repr__ = short_repr

    def __post_init__(self) -> None:
        signal = np.asarray(self.signal, dtype=np.float64)
        object.__setattr__(self, "signal", signal)
        if signal.ndim != 2 or signal.shape[0] != len(LEADS):
            raise InputError(
                f"{self.source}: signal has shape {signal.shape}; it must be (12, samples), with "
                f"leads in the order {', '.join(LEADS)}"
            )
        check_extent(signal.shape[1], self.sampling_rate, self.source)
        check_array("potential", signal, f"{self.source}: a sample (is its unit right?)")
        for lead, values in self.additional.items():
            stretch = is_span(values, values.size) or (not self.simultaneous and is_span(values, 1))
            if lead in LEADS or values.shape != signal.shape[1:] or not stretch:
                raise InputError(
                    f"{self.source}: lead {lead} has no number for each of the {signal.shape[1]} "
                    "samples (or of one stretch, where leads are in groups), or the name of "
                    "another; correct or leave it out"
                )
            check_array("potential", values, f"{self.source}: lead {lead} (is its unit right?)")
        if not self.recorded.any():
            raise InputError(f"{self.source}: no lead holds a sample; give another recording")
        _check_gaps(self)

    @property
    def duration(self) -> float:
        """Length of the recording (s)."""
        return float(self.signal.shape[1] / self.sampling_rate)

    @cached_property
    def recorded(self) -> Booleans:
        """Whether each of the twelve leads was recorded, shape (12,)."""
        return np.asarray(np.isfinite(self.signal).any(axis=1))

    @cached_property
    def measured_leads(self) -> tuple[str, ...]:
        """Names of the leads that were recorded, not computed from others."""
        pairs = zip(LEADS, self.recorded, strict=True)
        return tuple(lead for lead, recorded in pairs if recorded and lead not in self.derived)

    @cached_property
    def spans(self) -> Integers:
        """First sample of each lead and the one after its last, shape (12, 2); zeros if absent."""
        return lead_spans(self.signal)

    @property
    def simultaneous(self) -> bool:
        """True if all leads were recorded over the same time, as they are by digital recorders."""
        spans = self.spans[self.recorded]
        return bool((spans == spans[0]).all())


def derive_limb_leads(signal: Floats, recorded: Collection[str]) -> tuple[Floats, tuple[str, ...]]:
    """Fill the limb leads of a signal (12, n) that were not recorded, and name them.

    By Einthoven's and Goldberger's laws; NaN, and no names, where fewer than two were recorded.
    """
    matrix = limb_leads_from(recorded)
    rows = [k for k, lead in enumerate(LIMB_LEADS) if lead not in recorded]
    filled = signal.copy()
    filled[rows] = np.nan
    if matrix is None or not rows:
        return filled, ()
    used = np.flatnonzero(matrix.any(axis=0))
    filled[rows] = matrix[rows][:, used] @ signal[used]
    return filled, tuple(LIMB_LEADS[k] for k in rows)


def check_extent(samples: int, sampling_rate: float, source: str) -> None:
    """Refuse a sampling rate (Hz) or a number of samples that cannot be used, before they are read.

    Messages begin with the `source`.
    """
    rate, possible = number(sampling_rate, f"{source}: sampling rate"), RANGES["sampling rate"]
    if rate not in possible:
        raise InputError(
            f"{source}: sampling rate is {rate:.4g} Hz; at least {possible.low:g} Hz is needed to "
            f"see the QRS, and {possible.high:g} Hz is the most; correct it, or export the "
            "recording at its full rate"
        )
    seconds, longest = samples / sampling_rate, 1800.0  # s; more takes much memory
    if seconds < Recording.shortest:
        raise InputError(
            f"{source}: recording is {seconds:.2f} s long; at least {Recording.shortest:g} s are "
            "needed for one beat, give 10 s"
        )
    if seconds > longest or samples > 5_000_000:
        raise InputError(
            f"{source}: recording is {seconds:.0f} s long, with {samples} samples a lead; cut it "
            f"to {longest:.0f} s and 5,000,000 samples or less, 10 s are enough"
        )


def bridge_gaps(
    signal: Floats, rate: float, leads: Sequence[str], longest: float = 10.0
) -> tuple[Floats, list[str]]:
    """Interpolate a few lost samples of leads (n_leads, n), and cut off ragged ends.

    A cubic spline bridges gaps of at most `longest` ms where no more than 1 % of the lead is lost:
    where a QRS is steepest, 10 ms move the mean of ten beats by 0.02 mV, less than beats vary.
    Where leads begin or end at different times, the time that they share is kept if it is 90 % of
    the recording. Returned are the leads, and a line for each of these changes.
    """
    from scipy.interpolate import CubicSpline

    filled, bridged = signal.copy(), []
    for lead, values in zip(leads, filled, strict=True):
        recorded = np.flatnonzero(np.isfinite(values))
        lengths = np.diff(recorded) - 1
        lost = int(lengths.sum())
        if not 0 < lost <= 0.01 * len(recorded) or lengths.max() * 1000.0 > longest * rate:
            continue
        missing = np.setdiff1d(np.arange(recorded[0], recorded[-1]), recorded)
        values[missing] = CubicSpline(recorded, values[recorded])(missing)
        count = f"{lost} sample{'s' * (lost > 1)}"
        bridged.append(f"{count} of lead {lead} (at {missing[0] / rate:.3f} s)")
    notes = [f"missing samples were interpolated: {', '.join(bridged)}"] if bridged else []
    spans = lead_spans(filled)
    present = spans[:, 1] > 0
    first, stop = spans[present, 0].max(initial=0), spans[present, 1].min(initial=signal.shape[1])
    if signal.shape[1] > stop - first >= 0.9 * signal.shape[1]:
        filled = filled[:, first:stop]
        notes.append(
            f"cut to {first / rate:.3f} to {stop / rate:.3f} s of the file, where all leads are"
        )
    return filled, notes


def leave_out_pulses(signal: Floats, rate: float) -> tuple[Floats, list[str]]:
    """Cut calibration pulses, jumps that are the same in all leads, off the ends of leads (12, n).

    By Einthoven's law, the leads of a heart are never the same, unless all are 0. Returned are the
    leads, and a line that says what was cut.
    """
    leads = signal[np.isfinite(signal).any(axis=1)]
    apart = np.flatnonzero(~(np.ptp(leads, axis=0) <= 0.011))  # mV; two digits of 5 uV
    n = signal.shape[1]
    if len(leads) < 3 or len(apart) < n / 2:
        return signal, []
    ends = (0, int(apart[0])), (int(apart[-1]) + 1, n)
    # mV; pulses are of 1 mV
    cut = [(a, b) for a, b in ends if a < b and np.ptp(leads[0, a:b]) >= 0.5]
    pulses = [f"{first / rate:.3f} to {stop / rate:.3f} s" for first, stop in cut]
    notes = [f"calibration pulse left out: {', '.join(pulses)}"] if pulses else []
    begin, end = (ends[0][1] if ends[0] in cut else 0), (ends[1][0] if ends[1] in cut else n)
    return signal[:, begin:end], notes


def lead_spans(signal: Floats) -> Integers:
    """First sample of each lead (12, n) and the one after its last, (12, 2); zeros if absent."""
    finite = np.isfinite(signal)
    first = np.argmax(finite, axis=1)
    stop = finite.shape[1] - np.argmax(finite[:, ::-1], axis=1)
    present = finite.any(axis=1, keepdims=True)
    return np.where(present, np.stack([first, stop], axis=1), 0)


def is_span(values: Floats, least: int) -> bool:
    """Whether the finite ones of (n,) values have no gaps, and are `least` or more."""
    finite = np.flatnonzero(np.isfinite(values))
    return finite.size >= max(least, 1) and finite[-1] - finite[0] + 1 == finite.size


def in_groups(spans: Integers, rate: float) -> bool:
    """True if leads of spans (12, 2) were recorded one group after another, not all together."""
    first, stop = spans[spans[:, 1] > 0].T
    return bool(stop.min() <= first.max() + rate * 0.1)  # groups may overlap by 0.1 s


def _check_gaps(recording: Recording) -> None:
    """Refuse missing samples, unless they come from recording one group of leads after another."""
    source, rate = recording.source, recording.sampling_rate
    present = np.flatnonzero(recording.recorded)
    first, stop = recording.spans[present].T
    missing: Booleans = ~np.isfinite(recording.signal[present])
    one_by_one = in_groups(recording.spans, rate)
    if one_by_one:
        sample = np.arange(missing.shape[1])
        missing &= (sample >= first[:, None]) & (sample < stop[:, None])
    for row, gaps, begin, end in zip(present, missing, first, stop, strict=True):
        if gaps.any():
            gap_free, part = [LEADS[k] for k in present[~missing.any(axis=1)]], [0, 0]
            if not one_by_one:  # the longest run of samples without gaps
                ends = np.diff(~missing.any(axis=0), prepend=False, append=False)
                runs = np.flatnonzero(ends).reshape(-1, 2).tolist()
                part = max(runs, key=lambda run: run[1] - run[0], default=part)
            leads = [lead for lead in recording.measured_leads if lead in gap_free]
            remedies = []
            if limb_leads_from(leads) is not None and set(leads) & set(CHEST_LEADS):
                remedies.append(f"go on without: --leads {','.join(leads)}")
            part_start, part_end = (sample / rate for sample in part)
            if part_end - part_start >= 2.0:  # s; less holds hardly a beat
                remedies.append(
                    f"cut the recording to {part_start:.3f} to {part_end:.3f} s, which has no gaps"
                )
            lost, remedy = int(np.argmax(gaps)), ", or ".join(remedies)
            raise InputError(
                f"{source}: lead {LEADS[row]} lacks {gaps.sum()} samples (first: sample {lost}, "
                f"at {lost / rate:.3f} s); {remedy or 'give another recording'}"
            )
        if (end - begin) / rate < recording.shortest:
            raise InputError(
                f"{source}: lead {LEADS[row]} covers only {(end - begin) / rate:.2f} s; at least "
                f"{recording.shortest:g} s of each lead are needed"
            )


class MissingMetadataError(InputError):
    """A file lacks metadata that are needed: their `name` as a Python argument, and a `guess`.

    The guess is None where nothing suggests one.
    """

    def __init__(
        self, message: str, name: str, guess: str | float | None = None, why: str = ""
    ) -> None:
        self.name, self.guess = name, guess
        written = guess if isinstance(guess, str) or guess is None else f"{guess:g}"
        option = "--" + name.replace("_", "-")
        hint = f"; {option} {written} is a guess: {why}" if guess is not None else ""
        super().__init__(message + hint)


def missing_unit(message: str, leads: Sequence[Floats]) -> MissingMetadataError:
    """Ask for the unit of leads, each of shape (n,), and guess it: they usually span 1.5 mV."""
    spans = [float(np.ptp(lead[np.isfinite(lead)])) for lead in leads if np.isfinite(lead).any()]
    span = float(np.median(spans)) if spans else 0.0
    units = {"nV": 1e-6, "uV": 1e-3, "mV": 1.0, "V": 1e3}  # mV
    possible = {unit: span * mv for unit, mv in units.items() if 0.2 <= span * mv <= 15.0}
    if not possible:
        return MissingMetadataError(message, "unit")
    unit = min(possible, key=lambda name: abs(math.log(possible[name] / 1.5)))
    why = f"leads then span {possible[unit]:.2g} mV (median)"
    return MissingMetadataError(message, "unit", unit, why)


def missing_rate(message: str, samples: int) -> MissingMetadataError:
    """Error that asks for the sampling rate, with a guess from the usual duration of 10 s."""
    common = (500.0, 1000.0, 250.0, 400.0, 300.0, 2000.0)  # Hz
    usual = 500.0 if samples > 2000 else 1000.0
    rate = next((rate for rate in common if samples / rate == 10.0), usual)
    why = f"its {samples} samples then last {samples / rate:.3g} s"
    return MissingMetadataError(message, "sampling_rate", rate, why)


def missing_time_unit(message: str, step: float) -> MissingMetadataError:
    """Ask for the sampling rate where times step by so much in an unknown unit, s or ms."""
    if not 0 < step < math.inf:
        return MissingMetadataError(message, "sampling_rate")
    rate, unit = (1 / step, "s") if step < 0.1 else (1000 / step, "ms")
    why = f"times then step by {step:g} {unit}"
    return MissingMetadataError(message, "sampling_rate", rate, why)
