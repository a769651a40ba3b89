"""`fascicle target`: from a recording to a target, and the page that shows it."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fascicle.cli.arguments import FormatOption
from fascicle.cli.output import Result
from fascicle.core.errors import InputError
from fascicle.recording.readers.formats import known_formats

if TYPE_CHECKING:
    from fascicle.recording.analysis import Analysis
    from fascicle.recording.quality.check_result import CheckResult
    from fascicle.recording.recording import Recording
    from fascicle.recording.target import Target

_RANGE = re.compile(r"(\d+)(?:-(\d+))?")
_MOST_BEATS = 100_000  # of the longest recording, by far
_WIDTH = 15  # of the first column


RecordingArgument = Annotated[Path, typer.Argument(help=f"One of {known_formats()}.")]
TargetOption = Annotated[
    Path, typer.Option("--out", help="Target to write (netCDF, .nc); a .png goes beside it.")
]
Onset = Annotated[float | None, typer.Option(help="QRS onset (ms from R, negative).")]
Offset = Annotated[float | None, typer.Option(help="QRS offset (ms from R).")]
BeatClass = Annotated[
    str | None, typer.Option("--class", help="Class of the beats to use; A has the most.")
]
Beats = Annotated[str | None, typer.Option(help="Numbers of the beats to use, such as 1-4,7.")]
ExcludeBeat = Annotated[
    list[str] | None, typer.Option(help="Numbers of beats to leave out, such as 3 or 3,8-9.")
]
Leads = Annotated[
    str | None,
    typer.Option(help="Leads to use, such as I,II,V1-V5; limb leads are computed from two."),
]
Invert = Annotated[list[str] | None, typer.Option(help="Lead that was recorded upside down.")]
Swap = Annotated[
    list[str] | None, typer.Option(help="Reversed electrodes or leads, such as RA-LA or V1-V2.")
]
SharedGain = Annotated[
    bool,
    typer.Option("--shared-gain", help="All leads share one gain, whatever the file says of each."),
]
DigitsPerMv = Annotated[
    float | None,
    typer.Option(min=1.0, help="That gain: the file's numbers per mV.", show_default="1000"),
]
Noise = Annotated[float | None, typer.Option(help="Standard deviation of a single beat (mV).")]
SamplingRate = Annotated[
    float | None, typer.Option(help="Samples per second (Hz), if the file does not say.")
]
Unit = Annotated[
    str | None, typer.Option(help="Unit of the leads (nV, uV, mV, V), if the file does not.")
]
RecorderLowpass = Annotated[
    float | None,
    typer.Option(
        help="The recorder's own low-pass (Hz, -3 dB), if the file does not say; estimated from "
        "the spectrum by default."
    ),
]
Lowpass = Annotated[float | None, typer.Option(help="Zero-phase low-pass (Hz); none by default.")]
Notch = Annotated[
    float | None,
    typer.Option(help="Power-line interference to remove, 50 or 60 (Hz); none by default."),
]


def target(
    recording: RecordingArgument,
    out: TargetOption,
    onset: Onset = None,
    offset: Offset = None,
    beat_class: BeatClass = None,
    beats: Beats = None,
    exclude_beat: ExcludeBeat = None,
    leads: Leads = None,
    invert: Invert = None,
    swap: Swap = None,
    shared_gain: SharedGain = False,
    digits_per_mv: DigitsPerMv = None,
    noise: Noise = None,
    sampling_rate: SamplingRate = None,
    unit: Unit = None,
    lowpass: Lowpass = None,
    notch: Notch = None,
    recorder_lowpass: RecorderLowpass = None,
    kind: FormatOption = "png",
) -> Result:
    """Turn a recording into a target: aligned beats, their mean and spread, the QRS window.

    Beats are found, sorted by shape and aligned; those of the commonest shape (class A) make the
    target. A page beside it (.png) shows the recording with every beat's number and class, the
    beats on top of one another, and the QRS window. Look at it, and change what you would have
    drawn differently:

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
    from fascicle.cli.output import TerminalProgress
    from fascicle.recording.pipeline import analyse
    from fascicle.recording.readers.read import read_recording
    from fascicle.recording.target_files import write_target
    from fascicle.recording.target_options import TargetOptions
    from fascicle.reporting.figures import save
    from fascicle.reporting.recording import recording_figure

    picture = _picture_beside(out, recording, kind)
    choices = TargetOptions(
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
    gain = _gain(shared_gain, digits_per_mv)
    with TerminalProgress() as progress:
        progress("recording", 0, 3, "reading")
        wanted = None if leads is None else _leads(leads)
        read = read_recording(recording, leads=wanted, sampling_rate=sampling_rate, unit=unit)
        progress("recording", 1, 3, "beats")
        analysis = analyse(_corrected(read, gain, invert or (), swap or ()), choices)
        progress("recording", 2, 3, "picture")
        save(recording_figure(analysis), picture)
        write_target(analysis.target, out)
        progress("recording", 3, 3, "")
    print_analysis(analysis)
    _line("target", str(out))
    _line("picture", str(picture))
    return {"target": out, "picture": picture} | _result(analysis)


def _corrected(
    recording: Recording, gain: float | None, inverted: Sequence[str], swapped: Sequence[str]
) -> Recording:
    """Recording after the gain (digits per mV), then polarity, then exchanges are set right."""
    from fascicle.recording.corrections import invert, share_gain, swap
    from fascicle.recording.readers.names import lead_name

    if gain is not None:
        recording = share_gain(recording, gain)
    for text in inverted:
        for lead in _leads(text):
            recording = invert(recording, lead)
    for text in swapped:
        names = [part.strip() for part in re.split(r"[-,]", text)]
        if len(names) != 2:
            raise InputError(f"--swap {text}: give two names, such as RA-LA or V1-V2")
        # leads by their standard names, electrodes in capitals
        one, other = (lead_name(name) or name.upper() for name in names)
        recording = swap(recording, one, other)
    return recording


def _gain(shared: bool, digits_per_mv: float | None) -> float | None:
    """Digits per mV that all leads share; None where each has its own."""
    if digits_per_mv is not None and not shared:
        raise InputError("--digits-per-mv is the gain of --shared-gain; give both or neither")
    if not shared:
        return None
    return digits_per_mv if digits_per_mv is not None else 1000.0


def print_analysis(analysis: Analysis) -> None:
    """Print what was found in a recording, every check with its figure, and the warnings."""
    from fascicle.recording.analysis import Unused

    recording = analysis.recording
    _line(
        "recording",
        f"{Path(recording.source).name}, {recording.provenance.get('format', 'in memory')}, "
        f"{recording.duration:.1f} s at {recording.sampling_rate:g} Hz",
    )
    if recording.derived:
        _line("computed leads", ", ".join(recording.derived))
    if analysis.read_with:
        _line("read with", "; ".join(analysis.read_with))
    if recording.ignored:
        _line("ignored", ", ".join(recording.ignored))
    print(f"{'checks':<{_WIDTH}}{'':<34}{'found':>8}{'limit':>10}")
    for finding in analysis.findings:
        print(
            f"{'':<{_WIDTH}}{finding.check.name:<34}{_figure(finding.value):>8}"
            f"{_limit(finding):>10} {finding.check.unit:<3} {_outcome(finding)}"
        )
    for group in analysis.classes:
        notable = f": {group.description}" if group.description else ""
        _line(
            f"class {group.label}", f"{group.count} beat{'s' if group.count != 1 else ''}{notable}"
        )
    for beat in analysis.beats:
        if beat.unused not in (None, Unused.OTHER_CLASS):
            _line(
                f"beat {beat.number}",
                f"at {beat.time:.2f} s, class {beat.label}: {beat.why_unused}",
            )
    _print_target(analysis.target)


def _result(analysis: Analysis) -> dict[str, object]:
    """What is printed of a target, as a program wants it."""
    target = analysis.target
    return {
        "read_with": analysis.read_with,
        "beats_used": len(target.beats),
        "beats_found": len(analysis.beats),
        "heart_rate_bpm": target.heart_rate,
        "qrs_onset_ms": target.qrs_onset,
        "qrs_offset_ms": target.qrs_offset,
        "qrs_duration_ms": target.qrs_duration,
        "global_qrs_onset_ms": target.global_qrs[0],
        "global_qrs_offset_ms": target.global_qrs[1],
        "global_qrs_duration_ms": target.global_qrs_duration,
        "noise_mV": target.noise,
        "filters": [str(one) for one in target.filters],
        "checks": {
            finding.check.name: {
                "value": finding.value,
                "limit": finding.check.limit,
                "unit": finding.check.unit,
                "severity": finding.severity.value,
            }
            for finding in analysis.findings
        },
        "warnings": target.provenance.get("warnings", "").splitlines(),
    }


def _print_target(target: Target) -> None:
    """Print the figures of a target; its warnings go to the standard error."""
    import numpy as np

    for k, one in enumerate(target.filters):
        _line("" if k else "filters", str(one))
    if not target.filters:
        _line("filters", "none known")
    rate = f" at {target.heart_rate:.0f} per minute" if target.heart_rate is not None else ""
    _line("beats", f"{len(target.beats)} used{rate}")
    width_sd = float(np.hypot(target.onset_sd, target.offset_sd))
    _line(
        "QRS",
        f"{target.qrs_duration:.0f} ± {width_sd:.0f} ms, from {target.qrs_onset:.0f} ± "
        f"{target.onset_sd:.0f} to {target.qrs_offset:.0f} ± {target.offset_sd:.0f} ms about R "
        "(all leads together)",
    )
    first, last = target.global_qrs
    _line(
        "global QRS",
        f"{target.global_qrs_duration:.0f} ms, from {first:.0f} to {last:.0f} ms about R "
        "(outermost leads, as clinics measure it)",
    )
    if target.noise is not None:
        _line("noise", f"{target.noise:.3g} mV, as stated")
    else:
        spread = np.nanmean(target.standard_deviation[:, target.qrs_samples])
        _line("beat to beat", f"{spread:.3f} mV (mean standard deviation in the QRS)")
    for warning in target.provenance.get("warnings", "").splitlines():
        print(f"warning: {warning}", file=sys.stderr)


def _figure(value: float) -> str:
    """Four digits at most, or a dash for what the file does not say."""
    if math.isnan(value):
        return "-"
    if abs(value) >= 1e6:
        return f"{value:.1e}"
    return f"{value:.4f}".rstrip("0").rstrip(".") if abs(value) < 100 else f"{value:.0f}"


def _limit(finding: CheckResult) -> str:
    """The limit, and on which side of it all is fine."""
    limit = finding.check.limit
    if math.isnan(limit):
        return "-"
    below, fine = finding.value < limit, finding.severity.value == "ok"
    unknown = math.isnan(finding.value)
    return ("" if unknown else "≤ " if below == fine else "≥ ") + _figure(limit)


def _outcome(finding: CheckResult) -> str:
    """How serious it is; of what the recording is too short for, or lacks, that it was not made."""
    made = not math.isnan(finding.value) or finding.severity.value != "ok"
    return finding.severity.value if made else "not checked"


def _line(what: str, text: str) -> None:
    print(f"{what:<{_WIDTH}}{text}")


def _picture_beside(out: Path, recording: Path, kind: str) -> Path:
    """Name of the page; both it and the target must be fit to be written."""
    if not out.name:
        raise InputError(f"{out}: is no file name; give a target's, such as target.nc")
    picture = out.with_suffix(f".{kind}")
    if picture == out:
        raise InputError(f"{out}: is the name of the picture; give a target's, such as target.nc")
    for path in (out, picture):
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the name of a file, such as target.nc")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not an ordinary file; give another name to write to")
        if path.exists() and recording.exists() and path.samefile(recording):
            raise InputError(f"{path}: is the recording itself; give another name to write to")
    return picture


def _leads(text: str) -> list[str]:
    """Leads of a list such as ``I,II,V1-V6``."""
    from fascicle.core.leads import LEADS
    from fascicle.recording.readers.names import lead_name

    leads: list[str] = []
    for part in text.split(","):
        ends = [lead_name(end) for end in part.split("-")]
        if None in ends or len(ends) > 2:
            raise InputError(f"lead '{part.strip()}' is unknown; leads are {', '.join(LEADS)}")
        first, last = LEADS.index(str(ends[0])), LEADS.index(str(ends[-1]))
        if first > last:
            raise InputError(f"leads '{part.strip()}': the first comes after the last")
        leads += [lead for lead in LEADS[first : last + 1] if lead not in leads]
    return leads


def _numbers(text: str) -> tuple[int, ...]:
    """Beat numbers of a list such as ``1-4,7``."""
    numbers: list[int] = []
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise InputError(f"beats '{text}': give numbers such as 3 or 1-4,7")
        first, last = int(match[1]), int(match[2] or match[1])
        if not first <= last <= _MOST_BEATS:
            raise InputError(f"beats '{text}': {first} to {last} is no range of beats")
        numbers += range(first, last + 1)
    return tuple(numbers)
