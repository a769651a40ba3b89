"""Text tables: a time column and one column per lead, or one row per lead and time."""

from __future__ import annotations

import codecs
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line, printable
from fascicle.core.leads import LEADS
from fascicle.recording.readers import names
from fascicle.recording.readers.read import Channel, RawRecording, narrowest_passband, without_fill
from fascicle.recording.recording import Recording, missing_rate, missing_time_unit

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class _Column:
    """A column: its name and unit as spelt in the file, the lead that it holds, and its cells.

    `quantity` is the name without the unit, in small letters with blanks for underscores; `rhythm`
    says that the name is that of a rhythm strip, which may repeat a lead.
    """

    name: str
    quantity: str
    unit: str | None
    lead: str | None
    rhythm: bool
    cells: pd.Series

    @property
    def per_second(self) -> float | None:
        """Number of the column's units in a second; None where it has no unit of time."""
        return names.PER_SECOND.get(
            names.plain_unit(self.quantity if self.unit is None else self.unit)
        )

    def numbers(self, path: Path) -> Floats:
        """Cells as numbers (n,); empty cells are NaN."""
        values = np.full(len(self.cells), np.nan)
        if self.cells.dtype.kind in "iuf":  # else at least one cell is not a number
            values = self.cells.to_numpy(dtype=np.float64)
        wrong = ~np.isfinite(values) & self.cells.notna().to_numpy()
        if wrong.any():
            number = r"\s*[+-]?(?:\d{1,300}(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,2})?\s*"
            wrong &= ~self.cells.astype(str).str.fullmatch(number).to_numpy()
            row = int(np.argmax(wrong))
            raise InputError(
                f"{path}: column '{self.name}' holds '{str(self.cells.iloc[row])[:40]}' in row "
                f"{row + 1} of samples; every cell must be a number, all with the same decimal "
                "mark, or empty"
            )
        return values


# Columns that count samples; the last is what pandas calls a column without a name
COUNTERS = ("sample", "samples", "sample #", "samp #", "sample number", "index", "unnamed: 0")


def read_table(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read a table of samples by the schema in ``docs/recordings.md``.

    Of columns other than the twelve leads, those of numbers are channels. Where there are a lead
    and a rhythm strip of the same lead, the longer one is the lead.
    """
    columns, metadata = _parsed(path)
    names.check_physical(metadata, path)
    missing = names.fill_values(metadata)
    stated = {
        "by --sampling-rate": sampling_rate,
        "by a comment": names.declared_rate(metadata, path),
    }
    # tables that this package writes are in mV
    from_fascicle = [column.name for column in columns][: 1 + len(LEADS)] == ["time_ms", *LEADS]
    leads = [column for column in columns if column.lead is not None]
    clocks = ("time", "t", "timestamp", "elapsed time")
    # a name may be that of a unit of time alone, such as seconds
    times = [c for c in columns if c.quantity in clocks or (c.unit is None and c.per_second)]
    times = times or [column for column in columns if column.quantity in COUNTERS]
    shown = ", ".join(f"'{column.name[:30]}'" for column in columns[:4])
    if not leads:
        named = {column.quantity: column for column in columns}
        places = ("lead", "leads", "lead name", "channel")
        values = ("value", "values", "voltage", "amplitude", "potential", "signal", "ecg")
        place = next((named[name] for name in places if name in named), None)
        value = next((named[name] for name in values if name in named), None)
        if place is None or value is None or not times:
            raise InputError(
                f"{path}: no lead among the columns {shown}; name them I, II, V1 to V6 with their "
                "unit (I_mV)"
            )
        unit = _unit(value, from_fascicle, metadata, path)
        return _read_long(path, place, times[0], value, unit, missing, stated)
    numbers = np.array([column.numbers(path) for column in [*leads, *times]])
    # spreadsheets end with empty rows
    kept = ~np.isnan(numbers).all(axis=0) if times else np.full(numbers.shape[1], True)
    numbers = numbers[:, kept]
    stated_rate = _agreed_rate(path, stated)
    rates: dict[str, float | None] = {
        f"in the column '{column.name}'": _rate_of(path, column, clock, stated_rate, "")
        for column, clock in zip(times, numbers[len(leads) :], strict=True)
    }
    rate = _agreed_rate(path, stated | rates)
    if rate is None:
        raise missing_rate(
            f"{path}: no time column among {shown}; add one named time_ms or time_s, or give the "
            "rate in Hz by --sampling-rate",
            numbers.shape[1],
        )
    channels = [
        Channel(c.name, row, _unit(c, from_fascicle, metadata, path), c.lead, missing=missing)
        for c, row in zip(leads, numbers, strict=False)
    ]
    extra = [c for c in columns if c not in leads and c not in times]
    not_numbers = [c.name for c in extra if c.cells.dtype.kind not in "iuf"]
    table = _without_strips(channels, [c.rhythm for c in leads], rate, not_numbers, "table")
    more = []
    for c in (c for c in extra if c.name not in not_numbers):
        unit = c.unit if c.unit is not None else _unit(c, from_fascicle, metadata, path)
        lead, values = names.additional_lead_name(c.quantity), c.numbers(path)[kept]
        more.append(Channel(c.name, values, unit, lead, missing=missing))
    return _with_rest_around(replace(table, channels=[*table.channels, *more]))


def read_labsystem(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read the text export of the LabSystem Pro (Bard, Boston Scientific), of an EP laboratory.

    The channels follow one another in a header. Their digits, of 16 bits, are interleaved; 32768
    are the range of the channel.
    """
    header, _, data = path.read_text("latin-1").partition("[Data]")
    sections = [dict(re.findall(r"^\s*([^:\n]+):[ \t]*(.*?)\s*$", text, re.MULTILINE))
                for text in header.split("Channel #:")[1:]]  # fmt: skip
    digits = np.array(re.split(r"[\s,]+", data.strip(" ,\r\n")), float)
    digits = digits.reshape(-1, len(sections)).T

    def numbers(key: str) -> list[float]:
        """Numbers of a field, in Hz or mV, of all channels."""
        texts = (re.sub("(?i)hz|mv", "", section[key]).strip() for section in sections)
        return [float(text.replace("k", "")) * (1000.0 if "k" in text else 1.0) for text in texts]

    rates = set(numbers("Sample rate"))
    if len(rates) > 1:
        raise InputError(f"{path}: channels at {sorted(rates)} Hz; export all at one rate")
    channels = [
        Channel(printable(section["Label"]), x * span / 32768, "mV", gain=32768 / span)
        for section, x, span in zip(sections, digits, numbers("Range"), strict=True)
    ]
    are_leads = [names.lead_name(channel.name) is not None for channel in channels]
    low, high = (np.extract(are_leads, numbers(key)).tolist() for key in ("Low", "High"))
    return RawRecording(channels, rates.pop(), filters=narrowest_passband(low, high, []))


def _with_rest_around(table: RawRecording) -> RawRecording:
    """Add isoelectric samples around a single beat that begins and ends at 0 (simulated).

    The first sample of a paced beat is a thousandth of its amplitude at most.
    """
    rate = table.sampling_rate or 0.0
    signals = [channel.values for channel in table.channels]
    most = 1e-3 * max((float(np.abs(values).max(initial=0.0)) for values in signals), default=0.0)
    if any(
        len(values) >= Recording.shortest * rate or max(abs(values[[0, -1]])) > most
        for values in signals
    ):
        return table
    before = round(0.5 * rate)  # s
    channels = [c.placed(before, 2 * before + len(c.values), 0.0) for c in table.channels]
    remark = "holds one beat that begins and ends at 0 mV; isoelectric before and after it"
    return replace(table, channels=channels, remarks=(*table.remarks, remark))


def _parsed(path: Path) -> tuple[list[_Column], list[names.Entry]]:
    """Read the columns of a table, and what its comments declare."""
    import pandas as pd

    content = path.read_bytes()
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # "Unicode" of Excel
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # has the letter µ at the same code as Windows
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\0\x1a")  # ends of old files
    text = re.sub(r"\Asep=.\n", "", text)  # of Excel
    comments = re.findall(r"^[ \t]*#+[ \t]*(.*)$", text, re.MULTILINE)
    body = _one_header(re.sub(r"^[ \t]*#.*\n?", "", text, flags=re.MULTILINE).lstrip("\n"))
    header, _, cells = body.partition("\n")
    separator = next((mark for mark in "\t;," if mark in header), None)
    if single := re.search(r"^Lead,(Lead \w+)", text, re.MULTILINE):
        raise InputError(
            f"{path}: one lead alone ({single[1]}), as a watch records it; give a recording of I, "
            "II and V1 to V6"
        )
    if separator is None or header.count(separator) > 256 or "\0" in text:
        advice = "separated by commas, semicolons or tabs, such as time_ms,I_mV,II_mV"
        if re.fullmatch(r"[\d\s.eE+-]+", header):
            advice += (
                "; in an export of GE CardioLab put commas for blanks, and add the labels of its "
                ".inf file as first line (sample,I_mV,II_mV)"
            )
        raise InputError(
            f"{path}: no table of samples (its first line is '{header[:40]}'); the first line must "
            f"name the columns, {advice}"
        )
    # where a table holds both 1,5 and 0.5, one of them is not a number
    commas = separator != "," and re.search(r"\d,\d", cells) and not re.search(r"\d\.\d", cells)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # more cells than in the header
        try:
            frame = pd.read_csv(
                StringIO(body),
                sep=separator,
                decimal="," if commas else ".",
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
                # the other ways crash at 1e4000000000000001 (pandas issue 63089)
                float_precision="round_trip",
            )
        except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
            raise InputError(
                f"{path}: not a readable table ({one_line(error)}); give every row the cells of "
                "the header, and separate numbers with decimal commas by semicolons"
            ) from error
    for _, column in frame.select_dtypes(object).items():
        if column.astype(str).str.contains("\n", regex=False).any():
            raise InputError(f"{path}: a quotation mark is not closed in its line; remove it")
    spelt = [str(name) for name in frame.columns]
    columns = [_column(name, spelt, frame.iloc[:, k]) for k, name in enumerate(spelt)]
    # "fs: 500"
    matches = (re.fullmatch(r"([\w -]{1,40}?)\s*[:=]\s*(\S.{0,40}?)\s*", line) for line in comments)
    entries = (names.entry_of(match[1], match[2]) for match in matches if match is not None)
    return columns, [entry for entry in entries if entry is not None]


def _one_header(text: str) -> str:
    """Join the names and units that PhysioNet's ``rdsamp`` writes in two rows of single quotes.

    Its clock times (``'0:10.002'``) become seconds.
    """
    clock = re.compile(r"^'(?:(\d{1,4}):)?(\d{1,4}):(\d{1,4}\.\d{1,9})'", re.ASCII | re.MULTILINE)
    first, _, rows = text.partition("\n")
    if not first.startswith("'"):
        return text
    if rows.startswith("'") and not clock.match(rows):
        units, _, rows = rows.replace("hh:mm:ss.mmm", "s", 1).partition("\n")
        pairs = zip(first.split(","), units.split(","), strict=False)
        first = ",".join(f"{name} [{unit}]" for name, unit in pairs)
    rows = clock.sub(lambda at: f"{60 * (60 * int(at[1] or 0) + int(at[2])) + float(at[3])}", rows)
    return first.replace("'", "") + "\n" + rows


def _column(spelt: str, others: Sequence[str], cells: pd.Series) -> _Column:
    name, unit = spelt[:100].strip(), None  # bounds what matching takes
    renamed = re.fullmatch(r"(.+)\.\d+", name)  # pandas numbers columns of the same name
    name = renamed[1] if renamed and renamed[1] in others else name
    lead, rhythm = _lead_or_rhythm(name)
    if lead is None:  # "V1 (Wilson)" has no unit
        brackets = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\])]*?)\s*[\])]", name)  # "V1 [uV]"
        tail = re.fullmatch(r"(.+?)(?:[_ ]in[_ ]|[_ ]|\s*/\s*)([^_ /]+)", name)  # "V1_uV", "V1/uV"
        match = brackets or tail
        ending = names.plain_unit(match[2]) if match else ""
        if match and (brackets or names.millivolts(ending) or ending in names.PER_SECOND):
            name, unit = match[1], printable(match[2])
            lead, rhythm = _lead_or_rhythm(name)
    return _Column(printable(spelt), name.lower().replace("_", " "), unit, lead, rhythm, cells)


def _lead_or_rhythm(name: str) -> tuple[str | None, bool]:
    """Return the lead that a name means, and whether it is a rhythm strip."""
    strip = r"[\s_(.-]*(?<![a-z])(?:rhythm(?:[\s_]strip)?|long)(?![a-z])\)?[\s_.-]*"
    base_name, strips = re.subn(strip, "", name, count=1, flags=re.IGNORECASE)
    return names.lead_name(base_name), strips > 0


def _unit(
    column: _Column, from_fascicle: bool, metadata: Sequence[names.Entry], path: Path
) -> str | None:
    """Unit of a lead, which header and comments must agree about; mV in tables of fascicle."""
    commented = names.declared_unit(metadata, path, column.name)
    unit = "mV" if from_fascicle else column.unit
    if unit is not None and commented is not None and not names.same_unit(unit, commented):
        raise InputError(
            f"{path}: column '{column.name}' is in '{unit}', a comment says '{commented}'; correct "
            "the wrong one"
        )
    return commented if unit is None else unit


def _agreed_rate(path: Path, rates: dict[str, float | None]) -> float | None:
    """Rate (Hz) stated by the user, a comment or the times, which must agree; None without any.

    The first one is returned: rates of times may have been rounded.
    """
    stated = [(who, rate) for who, rate in rates.items() if rate is not None]
    for who, rate in stated[1:]:
        if not abs(rate - stated[0][1]) <= 2e-3 * stated[0][1]:  # more is not rounding
            raise InputError(
                f"{path}: sampling rate is {stated[0][1]:g} Hz {stated[0][0]}, {rate:g} Hz {who}; "
                "correct the wrong one"
            )
    return stated[0][1] if stated else None


def _rate_of(
    path: Path, column: _Column, times: Floats, stated_rate: float | None, lead: str
) -> float:
    """Rate (Hz) of even times by least squares; the stated one where the column has no unit."""
    where = f"of lead '{lead}'" if lead else f"in the column '{column.name}'"
    step, steps = _step(times), np.diff(times)
    if column.quantity in COUNTERS and stated_rate is None:
        raise missing_rate(
            f"{path}: the column '{column.name}' counts samples; give the sampling rate in Hz by "
            "--sampling-rate",
            len(times),
        )
    if column.per_second is None and stated_rate is None:
        raise missing_time_unit(
            f"{path}: unknown unit of the time column '{column.name}'; name it time_ms or time_s, "
            "or give the sampling rate in Hz by --sampling-rate",
            step,
        )
    # the step is NaN where there are too few times or one is missing or far too large
    if not step > 0 or (steps < 0).any():
        raise InputError(
            f"{path}: times {where} are missing or do not increase from row to row; sort or "
            "correct them"
        )
    scale = column.per_second or step * (stated_rate or 1.0)
    if np.ptp(times - times[0] - step * np.arange(len(times))) > 0.5 * step:
        k = int(np.argmax(np.abs(steps - step)))
        raise InputError(
            f"{path}: samples are not evenly spaced ({1000 * steps[k] / scale:g} ms after "
            f"{times[k] / scale:g} s, {1000 * step / scale:.4g} ms on average); resample, cut the "
            "recording to a part without gaps, or write the times with more digits"
        )
    return round(scale / step, 6)  # more digits are rounding of binary numbers


def _step(times: Floats) -> float:
    """Mean step of times, by least squares; NaN where there is none."""
    order = np.arange(len(times)) - (len(times) - 1) / 2
    if len(times) < 2 or not np.abs(times).max() <= 1e18:  # us since 1970 are below
        return float("nan")
    return float(order @ (times - times[0]) / (order @ order))


def _read_long(
    path: Path,
    place: _Column,
    time: _Column,
    value: _Column,
    unit: str | None,
    missing: tuple[float, ...],
    stated: dict[str, float | None],
) -> RawRecording:
    """Read one row per lead and time, onto common times; NaN where a lead was not recorded."""
    times, values = time.numbers(path), value.numbers(path)
    kept = ~np.isnan(values) & place.cells.notna().to_numpy()
    times, values, leads = times[kept], values[kept], place.cells[kept].astype(str)
    rows = {
        str(name): index
        for name, index in leads.groupby(leads.to_numpy()).indices.items()
        if len(index) > 1
        and (_lead_or_rhythm(str(name))[0] or names.additional_lead_name(str(name)))
    }
    if not rows:
        raise InputError(f"{path}: no lead in the column '{place.name}'; name them I, II, V1 to V6")
    # the longest lead knows the rate best
    ordered = sorted(rows, key=lambda name: -len(rows[name]))
    stated_rate = _agreed_rate(path, stated)
    rates: dict[str, float | None] = {
        f"of lead '{name}'": _rate_of(path, time, times[rows[name]], stated_rate, name)
        for name in ordered
    }
    rate, step = _agreed_rate(path, stated | rates), _step(times[rows[ordered[0]]])
    assert rate is not None  # every lead has one
    samples = {name: times[index] / step for name, index in rows.items()}
    first = {name: at.mean() - (len(at) - 1) / 2 for name, at in samples.items()}
    starts = {name: round(start - min(first.values())) for name, start in first.items()}
    length = max(starts[name] + len(index) for name, index in rows.items())
    channels = []
    for name, index in rows.items():
        if np.ptp(samples[name] - np.arange(len(index))) > 0.5:
            raise InputError(
                f"{path}: lead '{name}' is not sampled at the {rate:g} Hz of the others; resample "
                "all leads at one rate"
            )
        lead = _lead_or_rhythm(name)[0] or names.additional_lead_name(name)
        channel = Channel(printable(name), values[index], unit, lead, missing=missing)
        channels.append(channel.placed(starts[name], length))
    rhythm = [_lead_or_rhythm(name)[1] for name in rows]
    return _without_strips(channels, rhythm, rate, sorted(set(leads) - set(rows)), "long table")


def _without_strips(
    channels: Sequence[Channel],
    rhythm: Sequence[bool],
    rate: float,
    not_numeric: Sequence[str],
    kind: str,
) -> RawRecording:
    """Choose between a lead and a rhythm strip of it: the longer one, as on paper."""
    seconds = [np.isfinite(without_fill(channel, rate)).sum() / rate for channel in channels]
    chosen, choices = list(channels), {}
    for lead in {channel.lead for channel in channels}:
        rivals = [k for k, channel in enumerate(channels) if channel.lead == lead]
        if sorted(rhythm[k] for k in rivals) != [False, True]:
            continue
        best, other = sorted(rivals, key=lambda k: (-seconds[k], rhythm[k]))
        choices[f"strip_of_{lead}"] = (
            f"'{channels[best].name}' ({seconds[best]:.2f} s) is lead {lead}, "
            f"'{channels[other].name}' ({seconds[other]:.2f} s) is left out: the longer one serves"
        )
        name = f"{channels[other].name} (left out)"
        chosen[other] = replace(channels[other], name=name, lead=None)
    chosen += [Channel(name, np.empty(0)) for name in not_numeric]
    return RawRecording(chosen, rate, kind, provenance=choices)
