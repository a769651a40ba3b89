"""`fascicle target`: from a recording to a target, and the page that shows it."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

import fascicle
from fascicle.cli.options import FormatOption, lead_names
from fascicle.cli.output import Result, TerminalProgress, print_row, print_table
from fascicle.core.errors import InputError, OutputError
from fascicle.core.files import check_replaceable
from fascicle.core.ranges import digits
from fascicle.recording.readers.formats import known_formats

if TYPE_CHECKING:
    from fascicle.recording.pipeline import Analysis
    from fascicle.recording.quality import CheckResult
    from fascicle.recording.target import Target


def target(
    recording: Annotated[Path, Argument(help=f"One of {known_formats()}.")],
    out: Annotated[
        Path, Option("--out", help="Target to write (netCDF, .nc), with a picture (.png).")
    ],
    onset: Annotated[float | None, Option(help="QRS onset (ms from R, negative).")] = None,
    offset: Annotated[float | None, Option(help="QRS offset (ms from R).")] = None,
    beat_class: Annotated[
        str | None, Option("--class", help="Class of the beats to use; A has the most.")
    ] = None,
    beats: Annotated[str | None, Option(help="Numbers of the beats to use, such as 1-4,7.")] = None,
    exclude_beat: Annotated[
        list[str] | None,
        Option(
            "--exclude-beat", "--exclude", help="Numbers of beats to leave out, such as 3 or 3,8-9."
        ),
    ] = None,
    leads: Annotated[
        str | None,
        Option(
            help="Leads to use, such as I,II,V1-V5 or I-V6,V7-V9,X-Z,E1-E64, the last by their "
            "names in the file; by default the twelve and others of standard names. Limb leads "
            "are computed from two."
        ),
    ] = None,
    invert: Annotated[list[str] | None, Option(help="Lead that was recorded upside down.")] = None,
    swap: Annotated[
        list[str] | None, Option(help="Reversed electrodes or leads, such as RA-LA or V1-V2.")
    ] = None,
    shared_gain: Annotated[
        bool, Option("--shared-gain", help="Use one gain for all leads, in place of the file's.")
    ] = False,
    digits_per_mv: Annotated[
        float | None,
        Option(min=1.0, help="That gain: the file's numbers per mV.", show_default="1000"),
    ] = None,
    noise: Annotated[float | None, Option(help="Standard deviation of a single beat (mV).")] = None,
    sampling_rate: Annotated[
        float | None, Option(help="Sampling rate (Hz), if the file does not state it.")
    ] = None,
    unit: Annotated[
        str | None,
        Option(
            help="Unit of the leads (nV, uV, mV, V), if the file states none; stated again, it "
            "confirms a size that was asked about."
        ),
    ] = None,
    lowpass: Annotated[
        float | None, Option(help="Zero-phase low-pass (Hz); none by default.")
    ] = None,
    notch: Annotated[
        float | None,
        Option(help="Power-line interference to remove, 50 or 60 (Hz); none by default."),
    ] = None,
    recorder_lowpass: Annotated[
        float | None,
        Option(
            help="The recorder's low-pass (Hz, -3 dB), if the file does not state it; estimated "
            "from the spectrum by default."
        ),
    ] = None,
    kind: FormatOption = "png",
) -> Result:
    """Turn a recording into a target: aligned beats, their mean and spread, the QRS window.

    Beats are detected, grouped by morphology and aligned; those of the largest class (A) make the
    target. A page (.png) shows the recording with every beat's number and class, the beats on top
    of one another, and the QRS window. Look at it, and change what you would have marked
    differently:

    ```
    fascicle target ecg.hea --out t.nc --exclude-beat 3 --onset -52
    fascicle target ecg.hea --out t.nc --class B          # the ectopic beats
    fascicle target ecg.dcm --out t.nc --swap RA-LA       # arm electrodes were reversed
    fascicle target ecg.csv --out t.nc --unit uV --sampling-rate 500
    fascicle target ecg.csv --out t.nc --recorder-lowpass 40
    fascicle target beat.csv --out t.nc --noise 0.03      # a single averaged beat
    ```

    Simulated ECGs pass the filters that the recording has passed: those that the file names or you
    state, otherwise a steep low-pass that shows in the spectrum, and --lowpass and --notch.
    """
    from fascicle.recording.target_files import write_target
    from fascicle.reporting.recording import recording_figure
    from fascicle.reporting.style import save

    picture = _picture_path(out, kind)
    choices = fascicle.TargetOptions(
        onset=onset,
        offset=offset,
        beat_class=beat_class,
        beats=None if beats is None else _numbers(beats),
        exclude=tuple(number for text in exclude_beat or () for number in _numbers(text)),
        noise=noise,
        lowpass=lowpass,
        notch=notch,
        recorder_lowpass=recorder_lowpass,
    )
    with TerminalProgress() as progress:
        progress("recording", 0, 3, "reading")
        read = fascicle.read_recording(
            recording,
            leads=None if leads is None else lead_names(leads),
            sampling_rate=sampling_rate,
            unit=unit,
            shared_gain=shared_gain,
            digits_per_mv=digits_per_mv,
            invert=[lead for text in invert or () for lead in lead_names(text)],
            swap=swap or (),
        )
        progress("recording", 1, 3, "beats")
        analysis = fascicle.analyse(read, choices)
        progress("recording", 2, 3, "picture")
        save(recording_figure(analysis), picture)
        write_target(analysis.target, out)
        progress("recording", 3, 3, "")
    print_analysis(analysis)
    print_row("target", out)
    print_row("picture", picture)
    return {"target": out, "picture": picture} | _result(analysis)


def print_analysis(analysis: Analysis) -> None:
    """Print the analysis of a recording, every check with its value, and the warnings."""
    from fascicle.recording.beats import Unused

    recording = analysis.recording
    name, format = Path(recording.source).name, recording.provenance.get("format", "in memory")
    length = f"{recording.duration:.1f} s at {recording.sampling_rate:g} Hz"
    print_row("recording", f"{name}, {format}, {length}")
    for label, parts in (
        ("computed leads", recording.derived),
        ("additional leads", tuple(recording.additional)),
        ("read with", analysis.read_with),
        ("ignored", recording.ignored),
    ):
        if parts:
            print_row(label, ", ".join(parts))
    if len(spikes := analysis.spikes):
        times = ", ".join(f"{time:.2f}" for time in spikes[:5]) + (", …" if len(spikes) > 5 else "")
        print_row("pacing spikes", f"{len(spikes)}, cut out, at {times} s")
    print_table([("checks", "found", "limit", "unit", ""), *map(_check_row, analysis.findings)])
    for group in analysis.classes:
        notable = f": {group.description}" if group.description else ""
        count = f"{group.count} beat{'s' if group.count != 1 else ''}"
        print_row(f"class {group.label}", count + notable)
    for beat in analysis.beats:
        if beat.unused not in (None, Unused.OTHER_CLASS):
            why = f"at {beat.time:.2f} s, class {beat.label}: {beat.why_unused}"
            print_row(f"beat {beat.number}", why)
    _print_target(analysis.target)


def _check_row(finding: CheckResult) -> tuple[str, ...]:
    """Name, value, limit with the acceptable side, unit and outcome of a check."""
    check, unknown = finding.check, math.isnan(finding.value)
    fine = finding.severity.value == "ok"
    value, limit = ("-" if math.isnan(x) else digits(x) for x in (finding.value, check.limit))
    if not unknown and not math.isnan(check.limit):
        limit = ("≤ " if (finding.value < check.limit) == fine else "≥ ") + limit
    # the recording is too short for it, or lacks what it needs
    outcome = "not checked" if unknown and fine else finding.severity.value
    return check.name, value, limit, check.unit, outcome


def _result(analysis: Analysis) -> dict[str, object]:
    """The printed values of a target, for --json."""
    target = analysis.target
    return {
        "read_with": analysis.read_with,
        "beats_used": len(target.beats),
        "beats_found": len(analysis.beats),
        "heart_rate_bpm": target.heart_rate,
        "qrs_onset_ms": target.qrs_onset,
        "qrs_offset_ms": target.qrs_offset,
        "qrs_duration_ms": target.qrs_duration,
        "qrs_onset_sd_ms": target.onset_sd,
        "qrs_offset_sd_ms": target.offset_sd,
        "conventional_criteria": [asdict(criterion) for criterion in target.conventional_criteria],
        "noise_mV": target.noise,
        "filters": [str(passed) for passed in target.filters],
        "checks": {
            finding.check.name: {
                "value": finding.value,
                "limit": finding.check.limit,
                "unit": finding.check.unit,
                "severity": finding.severity.value,
            }
            for finding in analysis.findings
        },
        "warnings": list(target.warnings),
    }


def _print_target(target: Target) -> None:
    """Print the values of a target; its warnings go to standard error."""
    import numpy as np

    print_row("filters", "; ".join(map(str, target.filters)) or "none known")
    rate = f" at {target.heart_rate:.0f} per minute" if target.heart_rate is not None else ""
    print_row("beats", f"{len(target.beats)} used{rate}")
    first, first_sd = f"{target.qrs_onset:.0f}", f"{target.onset_sd:.0f}"
    last, last_sd = f"{target.qrs_offset:.0f}", f"{target.offset_sd:.0f}"
    width = f"{target.qrs_duration:.0f} ± {np.hypot(target.onset_sd, target.offset_sd):.0f} ms"
    print_row("QRS", f"{width}, from {first} ± {first_sd} to {last} ± {last_sd} ms about R")
    # the conventional criteria that are met, by their sources, and those that lack a lead
    criteria = target.conventional_criteria
    met: dict[str, list[str]] = {criterion.source: [] for criterion in criteria}
    for criterion in criteria:
        if criterion.met:
            met[criterion.source].append(criterion.name)
    lines = [f"{'; '.join(names)} ({source})" for source, names in met.items() if names]
    none = "none of the conventional criteria of bundle branch or fascicular block is met"
    for text in lines or [f"{none} ({', '.join(met)})"]:
        print_row("conventional criteria", text)
    if undecided := [criterion.name for criterion in criteria if criterion.met is None]:
        print_row("not decided", f"{'; '.join(undecided)}: leads are not used")
    if target.noise is not None:
        print_row("noise", f"{target.noise:.3g} mV, as stated")
    else:
        spread = np.nanmean(target.standard_deviation[:, target.qrs_samples])
        print_row("beat to beat", f"{spread:.3f} mV (mean standard deviation in the QRS)")
    for warning in target.warnings:
        print(f"warning: {warning}", file=sys.stderr)


def _picture_path(out: Path, kind: str) -> Path:
    """Path of the page; neither it nor the target may replace a file of the user's."""
    if out.suffix.lower() != ".nc":
        raise OutputError(f"{out}: a target is a netCDF file; give a name such as target.nc")
    picture = out.with_suffix(f".{kind}")
    for path in (out, picture):
        check_replaceable(path)
    return picture


def _numbers(text: str) -> tuple[int, ...]:
    """Beat numbers of a list such as ``1-4,7``."""
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"(\d{1,6})(?:-(\d{1,6}))?", part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last:
            raise InputError(f"beats '{text}': give numbers such as 3 or 1-4,7")
        numbers += range(first, last + 1)
    return tuple(numbers)
