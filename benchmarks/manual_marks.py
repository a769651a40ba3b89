"""Ends of the QRS against manual marks in every lead.

    python -m benchmarks.manual_marks FOLDER

FOLDER holds recordings of the Lobachevsky University Electrocardiography Database (LUDB): for each
N.hea the annotations N.i to N.v6, marked by cardiologists, lead by lead. Leads of one record share
one gain, whatever its header says. Marked ends are, for each lead, the median over the beats of its
marks from the found R peak, and of the leads the earliest onset and the latest offset.

Printed are mean and standard deviation (over the records) of found less marked onset, offset and
duration (ms). Experts begin a QRS earlier and end it later than electrocardiographs do, so that
these means are not zero. Then the records in which not as many beats were found as are marked,
counted from the first marked wave to the last, and those that were refused. Run from the root of
the repository.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.choices import share_gain
from fascicle.recording.detection import r_peaks
from fascicle.recording.filters import resample
from fascicle.recording.pipeline import Analysis
from fascicle.recording.recording import Recording
from fascicle.recording.target import Target

Array = NDArray[np.float64]

SAME_BEAT = 200.0  # ms; marks of several leads closer than this belong to one beat
REACH = 40  # ms by which a detected R peak may be off that of the target
FEWEST = 2  # beats that a lead must be marked in


@dataclass(frozen=True)
class Marks:
    """Manual marks of one record (ms from its beginning).

    Attributes
    ----------
    qrs : mapping of lead to (n_beats, 3) array
        Onset, peak and offset of every QRS marked in it.
    first, last : float
        First and last mark of any wave in any lead.
    """

    qrs: dict[str, Array]
    first: float
    last: float

    @property
    def beats(self) -> int:
        """Number of marked QRS complexes, in whichever leads."""
        peaks = np.sort(np.concatenate([marks[:, 1] for marks in self.qrs.values()]))
        return int(1 + (np.diff(peaks) > SAME_BEAT).sum())

    def ends(self, r_times: Array) -> tuple[float, float] | None:
        """Onset and offset in the outermost leads (ms from R); None where too few are marked."""
        of_leads = [ends for marks in self.qrs.values() if (ends := _median_ends(marks, r_times))]
        if not of_leads:
            return None
        onsets, offsets = np.array(of_leads).T
        return float(onsets.min()), float(offsets.max())


def _median_ends(marks: Array, r_times: Array) -> tuple[float, float] | None:
    """Median onset and offset of one lead (ms from R); None of one marked in too few beats."""
    nearest = r_times[np.argmin(np.abs(marks[:, 1, None] - r_times), axis=1)]
    near = np.abs(marks[:, 1] - nearest) < SAME_BEAT
    if near.sum() < FEWEST:
        return None
    onset, _, offset = np.median(marks[near] - nearest[near, None], axis=0)
    return float(onset), float(offset)


def manual_marks(stem: Path) -> Marks:
    """Read the twelve annotation files of a record."""
    import wfdb

    qrs, all_times = {}, []
    for lead in LEADS:
        annotation = wfdb.rdann(str(stem), lead.lower())
        times, symbols = 1000.0 * annotation.sample / annotation.fs, annotation.symbol
        all_times += list(times)
        qrs[lead] = np.array(
            [
                times[k : k + 3]
                for k in range(len(symbols) - 2)
                if symbols[k : k + 3] == ["(", "N", ")"]
            ]
        ).reshape(-1, 3)
    return Marks(qrs, min(all_times), max(all_times))


def r_times(recording: Recording, target: Target) -> Array:
    """Times (ms) at which time 0 of the target's mean QRS lies in the recording."""
    signal = resample(recording.signal, recording.sampling_rate)
    rows, inside = np.flatnonzero(target.used), target.qrs_samples
    shape = (target.qrs - target.qrs.mean(axis=1, keepdims=True))[rows]
    width, begin = shape.shape[1], int(target.time[inside.start])
    times = []
    for peak in r_peaks(signal, 1000.0):
        near = range(peak + begin - REACH, peak + begin + REACH + 1)
        starts = [start for start in near if 0 <= start < signal.shape[1] - width]
        if starts:
            scores = [np.sum(signal[rows, start : start + width] * shape) for start in starts]
            times.append(float(starts[int(np.argmax(scores))] - begin))
    return np.array(times)


def read_record(header: Path) -> Recording:
    """A record with one gain for all leads."""
    recording = fascicle.read_recording(header)
    gains = recording.digits_per_millivolt
    if gains is None or np.ptp(gains) == 0:
        return recording
    return share_gain(recording)


def records(folder: Path) -> Iterator[Path]:
    """Headers of the records with annotations, by number."""
    headers = [path for path in folder.glob("*.hea") if path.stem.isdecimal()]
    annotated = [path for path in headers if path.with_suffix(".v6").exists()]
    yield from sorted(annotated, key=lambda path: int(path.stem))


def errors(analysis: Analysis, marks: Marks) -> Array | None:
    """Found less marked onset, offset and duration (ms)."""
    target = analysis.target
    marked = marks.ends(r_times(analysis.recording, target))
    if marked is None:
        return None
    onset, offset = np.array([target.qrs_onset, target.qrs_offset]) - marked
    return np.array([onset, offset, offset - onset])


def report(off: Array) -> None:
    """Print errors (n, 3), ms."""
    print(f"{len(off)} records: found less marked (ms), mean ± standard deviation")
    for name, column in zip(("onset", "offset", "duration"), off.T, strict=True):
        print(f"{name:<10}{column.mean():6.1f} ±{column.std():5.1f}")


def on_records(folder: Path) -> None:
    """Print errors on records with manual marks, and where beats were missed or invented."""
    off: list[Array] = []
    miscounted, refused = [], []
    for header in records(folder):
        marks = manual_marks(header.with_suffix(""))
        try:
            analysis = fascicle.analyse(read_record(header))
        except InputError as error:
            refused.append(str(error))
            continue
        times = 1000.0 * np.array([beat.time for beat in analysis.beats])
        count = int(((times >= marks.first) & (times <= marks.last)).sum())
        if count != marks.beats:
            miscounted.append(f"{header.stem}: {count} beats found, {marks.beats} marked")
        found_errors = errors(analysis, marks)
        if found_errors is None:
            refused.append(f"{header.stem}: no lead is marked in {FEWEST} beats")
        else:
            off.append(found_errors)
    report(np.array(off))
    for title, lines in (("other counts of beats", miscounted), ("refused", refused)):
        print(f"{title}: {len(lines)}", *lines, sep="\n  ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="records and annotations of LUDB")
    on_records(parser.parse_args().folder)


if __name__ == "__main__":
    main()
