"""Each check finds its fault, explains it, and has nothing against good and real recordings."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from quality_recordings import (
    RATE,
    REAL,
    analysed,
    beating,
    fatal,
    on_paper,
    real,
    row,
    warned,
    with_lead,
)

from fascicle.core.arrays import Floats
from fascicle.core.leads import CHEST_LEADS, LEADS, LIMB_LEADS
from fascicle.recording import quality
from fascicle.recording.choices import swap
from fascicle.recording.detection import r_peaks
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.limb_leads import check_identities, check_reversal
from fascicle.recording.pipeline import Analysis, analyse, make_target
from fascicle.recording.quality import CheckResult, Severity, check_leads, check_recording
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording

GAINS = np.array([1012.0, 1280, 930, 988, 692, 1086, 2834, 2867, 2817, 1715, 2102, 1842])


@pytest.fixture(scope="module")
def good() -> Recording:
    return beating()


@pytest.fixture(scope="module")
def disturbed(good: Recording) -> Recording:
    """Each lead has its own offset, slow drift and noise, which break no law."""
    t = np.arange(good.signal.shape[1]) / good.sampling_rate
    lead = np.arange(12)[:, None]
    drift = 0.3 * lead + 0.4 * np.sin(2 * np.pi * 0.15 * t + lead)
    noise = 0.015 * np.random.default_rng(1).standard_normal(good.signal.shape)
    return replace(good, signal=good.signal + drift + noise)


@pytest.fixture(scope="module")
def patients(data_folder: Path) -> dict[str, Recording]:
    return real(data_folder)


def every(recording: Recording, filters: tuple[Filter, ...] = ()) -> list[CheckResult]:
    """All findings, with the R peaks that the detector gives."""
    peaks = r_peaks(recording.signal, recording.sampling_rate)
    limb = (*check_identities(recording), check_reversal(recording, peaks))
    return [*check_leads(recording), *limb, *check_recording(recording, peaks, filters)]


def one(recording: Recording, name: str) -> CheckResult:
    """The finding of the check of leads whose name begins so."""
    (check,) = (check for check in quality.LEAD_CHECKS if check.name.startswith(name))
    return check.of(recording)


def test_nothing_against_good_and_real_recordings(good, patients) -> None:
    findings = every(good)
    assert len({finding.check for finding in findings}) == len(findings) == 14
    for recording in (good, *patients.values()):
        assert fatal(every(recording)) + warned(every(recording)) == []


def test_any_lead_may_be_absent(good) -> None:
    for lead in LEADS:
        findings = every(with_lead(good, lead, np.full(good.signal.shape[1], np.nan)))
        assert fatal(findings) + warned(findings) == []
    alone = np.full_like(good.signal, np.nan)
    alone[7] = good.signal[7]
    findings = every(replace(good, signal=alone))
    assert fatal(findings) + warned(findings) == []
    assert sum(finding.message.startswith("not checked") for finding in findings) == 2


def test_the_most_basic_fault_comes_first(good) -> None:
    inverted = with_lead(good, "II", -row(good, "II"))
    messages = fatal(every(with_lead(inverted, "V3", np.zeros(good.signal.shape[1]))))
    assert "no signal in lead V3" in messages[0]
    assert "--invert II" in messages[1]


def test_flat_leads(good) -> None:
    assert check_leads(good)[0].value == pytest.approx(1e3 * good.signal.std(axis=1).min())
    flat = with_lead(good, "V2", np.full(good.signal.shape[1], 0.3))
    assert fatal(check_leads(flat)) == [
        "no signal in lead V2; go on without: --leads I,II,III,aVR,aVL,aVF,V1,V3,V4,V5,V6"
    ]
    values = row(good, "V2").copy()
    values[1000:2501] = values[1000]
    (message,) = warned(check_leads(with_lead(good, "V2", values)))
    assert message.startswith("no signal in lead V2 for up to 3.0 s")
    signal = good.signal.copy()
    signal[:, 3000:] = 0
    (message,) = fatal(check_leads(replace(good, signal=signal)))
    assert "no signal in any lead for up to 4.0 s" in message


def test_duplicated_leads(good) -> None:
    for sign, words in ((1, "the same;"), (-1, "the same but for the sign;")):
        (message,) = fatal(check_leads(with_lead(good, "V5", sign * row(good, "V1") + 0.2)))
        assert message.startswith(f"leads V1 and V5 are {words}")
    noisy = row(good, "V1") + 0.02 * np.random.default_rng(0).standard_normal(len(row(good, "V1")))
    assert fatal(check_leads(with_lead(good, "V5", noisy))) == []
    # with a flat lead I others are the same by law
    signal = good.signal.copy()
    signal[0] = 0
    signal[2], signal[3], signal[4], signal[5] = signal[1], -signal[1], -signal[1] / 2, signal[1]
    (message,) = fatal(check_leads(replace(good, signal=signal)))
    assert "no signal in lead I" in message


def test_clipped_peaks(good) -> None:
    assert one(good, "clipped").value == 0
    cut = np.minimum(row(good, "V4"), 0.8 * row(good, "V4").max())
    finding = one(with_lead(good, "V4", cut), "clipped")
    assert finding.value == pytest.approx(np.mean(cut == cut.max()), rel=0.2)
    assert finding.message.startswith("peaks of lead V4 are clipped")
    # a plateau near the baseline
    plateau = np.maximum(row(good, "V4"), -0.05)
    assert (plateau == plateau.min()).sum() > 100
    assert one(with_lead(good, "V4", plateau), "clipped").value == 0
    # the rounded tops of coarse digits
    smooth = beating(noise=0.0)
    assert one(replace(good, signal=0.01 * np.round(smooth.signal / 0.01)), "clipped").value == 0


def test_resolution(good) -> None:
    for step, severity in ((0.005, Severity.FINE), (0.04, Severity.WARNING)):
        rounded = step * np.round(good.signal / step)
        finding = one(replace(good, signal=rounded), "amplitude resolution")
        assert finding.value == pytest.approx(1e3 * step)
        assert finding.severity is severity


def test_noise_is_measured_between_the_beats() -> None:
    clean = beating(noise=0.0)
    assert one(clean, "noise").value < 1.0
    white = np.random.default_rng(0).standard_normal(clean.signal.shape[1])
    for size, severity in zip((0.02, 0.1, 0.5), Severity, strict=True):
        finding = one(with_lead(clean, "V3", row(clean, "V3") + size * white), "noise")
        # a moving average of 6 samples leaves 5/6 of the variance
        assert finding.value == pytest.approx(1e3 * size * np.sqrt(5 / 6), rel=0.1)
        assert finding.severity is severity
        assert ("lead V3" in finding.message) == (severity is not Severity.FINE)
        assert ("; go on without: --leads I," in finding.message) == (severity is Severity.FATAL)


@pytest.mark.parametrize("frequency", [49.8, 60.0])
def test_power_line_interference(good, frequency: float) -> None:
    time = np.arange(good.signal.shape[1]) / good.sampling_rate
    name = f"power-line interference, {round(frequency, -1):g} Hz"
    assert one(good, name).value < 5
    wave = 0.06 * np.sin(2 * np.pi * frequency * time) + 0.02 * np.sin(4 * np.pi * frequency * time)
    finding = one(with_lead(good, "aVL", row(good, "aVL") + wave), name)
    assert finding.value == pytest.approx(1e3 * np.hypot(0.06, 0.02), rel=0.05)
    assert "in lead aVL" in finding.message


def test_low_pass_of_the_recorder(good) -> None:
    def found(frequency: float, origin: FilterOrigin, rate: float | None = None) -> CheckResult:
        order = 2.0 if rate else 10.0
        return every(good, (Filter(FilterKind.LOW_PASS, frequency, origin, order, rate),))[-1]

    assert np.isnan(every(good)[-1].value)
    assert found(150.0, FilterOrigin.FILE).severity is Severity.FINE
    assert np.isnan(found(40.0, FilterOrigin.APPLIED, 1000.0).value)
    low = found(40.0, FilterOrigin.ESTIMATED).message
    assert "low-pass at 40 Hz, estimated from the spectrum, strongly smooths the QRS" in low


def test_identities_hold_in_spite_of_drift_and_noise(good, disturbed) -> None:
    clean = check_identities(good)
    assert [finding.check.name.split(" ", 1)[1] for finding in clean] == [
        "I + III - II", "aVR + (I + II)/2", "aVL - (I - III)/2", "aVF - (II + III)/2",
    ]  # fmt: skip
    assert max(finding.value for finding in clean) < 1e-12
    noisy = check_identities(disturbed)
    assert {finding.severity for finding in noisy} == {Severity.FINE}
    assert 0.005 < max(finding.value for finding in noisy) < 0.05


@pytest.mark.parametrize("lead", LIMB_LEADS)
def test_inverted_lead_and_another_gain(good, disturbed, lead: str) -> None:
    found = fatal(check_identities(with_lead(disturbed, lead, -row(disturbed, lead))))
    assert found[0].endswith(f"lead {lead} is upside down, give --invert {lead}")
    wrong, more = (
        check_identities(with_lead(good, lead, gain * row(good, lead))) for gain in (1.8, 2.6)
    )
    figures = [[result.value for result in results] for results in (wrong, more)]
    assert figures[1] == pytest.approx(2 * np.array(figures[0]), rel=1e-6, abs=1e-9)
    assert f"lead {lead} is 1.80 times what the other limb leads say" in fatal(wrong)[0]
    found = fatal(check_identities(with_lead(disturbed, lead, 1.8 * row(disturbed, lead))))
    assert f"lead {lead} " in found[0]
    assert f"--leads {','.join(name for name in LIMB_LEADS if name != lead)},V1" in found[0]


def test_exchanged_leads(disturbed) -> None:
    for lead, other in combinations(LIMB_LEADS, 2):
        exchanged = with_lead(disturbed, lead, row(disturbed, other))
        exchanged = with_lead(exchanged, other, row(disturbed, lead))
        assert fatal(check_identities(exchanged))[0].endswith(f"give --swap {lead}-{other}")


def test_lead_that_is_something_else_and_chaos(good, disturbed) -> None:
    other = np.roll(row(disturbed, "aVL"), 200)
    found = fatal(check_identities(with_lead(disturbed, "aVL", other)))
    assert "lead aVL does not follow from the other limb leads; leave it out" in found[0]
    shifted = np.stack([np.roll(lead, 37 * k) for k, lead in enumerate(good.signal)])
    gains = np.array([1.0, 1.5, 0.7, 1.2, 2.0, 0.8, *[1.0] * 6])[:, None]
    for signal in (shifted, gains * disturbed.signal):  # a gain of its own for each lead
        found = fatal(check_identities(replace(good, signal=signal)))
        assert "no single lead, gain or exchange explains it" in found[0]
        assert found[0].endswith("go on with two of them: --leads I,II,V1,V2,V3,V4,V5,V6")
    late = [np.roll(lead, k) for k, lead in enumerate(good.signal)]  # 2 ms each
    (warning, *_) = warned(check_identities(replace(good, signal=np.stack(late))))
    assert "no single lead, gain or exchange explains it" in warning


@pytest.mark.parametrize("per_millivolt", [1000, 120])
def test_digits_show_that_the_gains_are_wrong(good, per_millivolt: int) -> None:
    """Also where the limb leads are so small that no identity is broken by much."""
    digits = np.round(per_millivolt * good.signal)
    wrong = replace(good, signal=digits / GAINS[:, None], digits_per_millivolt=GAINS)
    message = fatal(check_identities(wrong))[0]
    assert message.endswith("satisfy the identities; read it with --shared-gain")
    assert ("is off by" in message) == (per_millivolt == 1000)  # the broken identity comes first
    digits = np.round(GAINS[:, None] * good.signal)
    right = replace(good, signal=digits / GAINS[:, None], digits_per_millivolt=GAINS)
    assert fatal(check_identities(right)) == []


def test_three_leads_leave_a_choice_and_computed_ones_prove_nothing(good) -> None:
    signal = good.signal.copy()
    signal[3:6] = np.nan
    signal[2] *= -1
    (message,) = fatal(check_identities(replace(good, signal=signal)))
    assert "--invert III, or leads I and II are exchanged, give --swap I-II" in message
    wrong = with_lead(good, "II", 1.8 * row(good, "II"))
    (finding,) = check_identities(replace(wrong, derived=("III", "aVR", "aVL", "aVF")))
    assert np.isnan(finding.value)


def test_lead_groups_are_compared_where_they_overlap(good) -> None:
    groups = on_paper(good)
    assert [finding.check.name for finding in check_identities(groups)] == [
        "Einthoven I + III - II", "identity aVF from aVR and aVL",
    ]  # fmt: skip
    broken = check_identities(with_lead(groups, "aVL", 3 * row(groups, "aVL")))
    assert [finding.severity for finding in broken] == [Severity.FINE, Severity.FATAL]


def test_reversed_electrodes(good, patients: dict[str, Recording]) -> None:
    for recording in (good, *patients.values()):
        peaks = r_peaks(recording.signal, recording.sampling_rate)
        found = check_reversal(recording, peaks)
        assert found.value > 0.3
        assert found.severity is Severity.FINE
        arms = check_reversal(swap(recording, "RA", "LA"), peaks)
        assert arms.value <= -0.4
        assert arms.message.endswith("to undo it: --swap RA-LA")
        assert "the heart lies on the right" in arms.message
        legs = check_reversal(swap(recording, "RA", "LL"), peaks)
        assert legs.message.endswith("--swap RA-LL")
        assert check_identities(recording)[-1].severity is Severity.FINE  # no law is broken


def test_no_reversal_is_advised_for_paced_beats_or_without_p_waves(good) -> None:
    reversed_arms = swap(good, "RA", "LA")
    signal = reversed_arms.signal.copy()
    peaks = r_peaks(signal, good.sampling_rate)
    assert "--swap RA-LA" in check_reversal(reversed_arms, peaks).message
    assert check_reversal(reversed_arms, peaks, paced=True).message.endswith("rhythm is paced")
    for peak in peaks:  # 260 to 100 ms before R
        p_wave = slice(peak - 130, peak - 48)
        signal[:, p_wave] = np.linspace(*signal[:, [p_wave.start, p_wave.stop]].T, 82).T
    finding = check_reversal(replace(good, signal=signal), peaks)
    assert finding.message == "not checked: leads I and II show no P wave"


def test_an_axis_to_the_right_is_no_reversal(good) -> None:
    """Lead I is negative in the QRS, but not in the P wave; V5 serves where there is no V6."""
    signal = good.signal.copy()
    for peak in r_peaks(good.signal, good.sampling_rate):
        qrs = slice(peak - 30, peak + 41)  # 60 ms before R to 80 ms after
        signal[0, qrs] = 2 * signal[0, qrs.start] - signal[0, qrs]
    peaks = r_peaks(good.signal, good.sampling_rate)
    finding = check_reversal(replace(good, signal=signal), peaks)
    assert -0.2 < finding.value < 0.2
    assert finding.severity is Severity.FINE
    without_v6 = with_lead(good, "V6", np.full(good.signal.shape[1], np.nan))
    assert check_reversal(without_v6, peaks).value > 0.8


def mean_beat_checks(analysis: Analysis) -> list[CheckResult]:
    """Both checks of the mean beat."""
    return [
        found for found in analysis.findings if found.check in (quality.FASTEST_QRS, quality.CHEST)
    ]


@pytest.fixture(scope="module")
def qrs(good: Recording) -> Floats:
    return analyse(good).target.qrs


def test_nothing_against_real_mean_beats(data_folder: Path) -> None:
    philips = read_recording(data_folder / "ecg" / "philips" / "129DYPRG.XML")
    for analysis in (analyse(philips), *analysed(data_folder).values()):
        speed, chest = mean_beat_checks(analysis)
        assert speed.severity is chest.severity is Severity.FINE
        assert speed.value > 2 * quality.FASTEST_QRS.limit
        assert chest.value < 0.8 * quality.CHEST.limit


def test_exchanged_and_inverted_chest_leads(qrs: Floats) -> None:
    assert quality.check_chest_leads(qrs).severity is Severity.FINE
    for k, lead in enumerate(CHEST_LEADS):
        wrong = qrs.copy()
        wrong[6 + k] *= -1
        assert quality.check_chest_leads(wrong).message.endswith(f"to undo it: --invert {lead}")
        assert quality.check_chest_leads(3 * wrong).value == pytest.approx(
            quality.check_chest_leads(wrong).value
        )
    for k in range(3):
        wrong = qrs.copy()
        wrong[[6 + k, 7 + k]] = qrs[[7 + k, 6 + k]]
        assert quality.check_chest_leads(wrong).message.endswith(f"--swap V{k + 1}-V{k + 2}")


def test_the_remedy_removes_the_warning_of_a_patient(data_folder: Path) -> None:
    """As recorded there is none: see the test of all real recordings."""
    file = data_folder / "ecg" / REAL["RBBB"]
    recording = read_recording(file)
    for fault, remedy in (
        ({"swap": ["V1-V2"]}, "--swap V1-V2"),
        ({"invert": ["V3"]}, "--invert V3"),
    ):
        (warning,) = make_target(read_recording(file, **fault)).warnings
        assert warning.endswith(f"to undo it: {remedy}")
        undone = read_recording(file, **{name: 2 * twice for name, twice in fault.items()})
        assert (undone.signal == recording.signal).all()


def test_limb_leads_and_absent_leads_raise_no_alarm(qrs: Floats) -> None:
    changed = qrs.copy()
    changed[:6] *= -1
    assert quality.check_chest_leads(changed).value == quality.check_chest_leads(qrs).value
    changed[8] = np.nan
    assert quality.check_chest_leads(changed).severity is Severity.FINE
    assert np.isnan(quality.check_chest_leads(changed).value)


def test_t_waves_alone(good: Recording, qrs: Floats) -> None:
    signal = good.signal.copy()
    for peak in r_peaks(signal, RATE):
        beat = slice(peak - 150, peak + 40)  # P wave and QRS
        signal[:, beat] = np.linspace(signal[:, beat.start], signal[:, beat.stop], 190, axis=1)
    speed, chest = mean_beat_checks(analyse(replace(good, signal=signal)))
    assert speed.value < 0.5 * quality.FASTEST_QRS.limit
    assert "a T or P wave was probably taken for the beat" in speed.message
    assert chest.message == "not checked: no QRS"
    slow = np.repeat(qrs, 3, axis=1)  # as slow as the slowest QRS
    assert quality.check_mean_beat(slow)[0].severity is Severity.FINE


def test_the_right_leg_on_an_arm_is_named(data_folder) -> None:
    """Lead II is then flat. Swapping arms, which would be advised, would make other wrong leads."""
    path = data_folder / "cases" / "right_leg_cable_on_right_arm.csv"
    (warning,) = make_target(read_recording(path)).warnings
    assert warning.startswith("lead II is flat (0.06 mV): RA and RL are probably exchanged")
    assert "--swap" not in warning


def test_one_bad_lead_may_be_left_out(data_folder) -> None:
    """With it, beats fall into four classes; the advice that is given gathers them."""
    path = data_folder / "cases" / "electrode_off_v6.csv"
    target = make_target(read_recording(path))
    assert len(target.beats) < 7
    kept = [lead for lead in LEADS if lead != "V6"]
    assert f"go on without: --leads {','.join(kept)}" in target.warnings[0]
    assert "take it away by --notch 50, or record again" in target.warnings[1]
    (_, hum) = make_target(read_recording(path), notch=50.0).warnings
    assert hum.startswith("power-line interference at 50 Hz in lead V6")
    assert "--notch" not in hum
    assert len(make_target(read_recording(path, leads=kept)).beats) == 7
