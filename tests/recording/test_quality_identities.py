"""Broken laws of Einthoven and Goldberger are found and explained."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from quality_recordings import beating, fatal, row, warned, with_lead

from fascicle.core.leads import LIMB_LEADS
from fascicle.recording.quality.check_result import Severity
from fascicle.recording.quality.identities import check_identities
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording


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


def test_one_figure_per_law_and_none_is_broken(good: Recording, disturbed: Recording) -> None:
    clean = check_identities(good)
    assert [finding.check.name.split(" ", 1)[1] for finding in clean] == [
        "I + III - II", "aVR + (I + II)/2", "aVL - (I - III)/2", "aVF - (II + III)/2",
    ]  # fmt: skip
    assert max(finding.value for finding in clean) < 1e-12
    noisy = check_identities(disturbed)
    assert {finding.severity for finding in noisy} == {Severity.FINE}
    assert 0.005 < max(finding.value for finding in noisy) < 0.05


def test_the_figure_is_the_misfit_in_millivolts(good: Recording) -> None:
    # a lead 1.3 times too high is off by 0.3 of its own (filtered) height
    found = check_identities(with_lead(good, "II", 1.3 * row(good, "II")))
    more = check_identities(with_lead(good, "II", 1.6 * row(good, "II")))
    assert more[0].value == pytest.approx(2 * found[0].value, rel=1e-6)
    assert 0.15 < found[0].value < 0.3 * np.ptp(row(good, "II"))


@pytest.mark.parametrize("lead", LIMB_LEADS)
def test_inverted_lead(disturbed: Recording, lead: str) -> None:
    found = fatal(check_identities(with_lead(disturbed, lead, -row(disturbed, lead))))
    assert found[0].endswith(f"lead {lead} is upside down, give --invert {lead}")


@pytest.mark.parametrize("lead", LIMB_LEADS)
def test_lead_with_another_gain(good: Recording, disturbed: Recording, lead: str) -> None:
    exact = fatal(check_identities(with_lead(good, lead, 1.8 * row(good, lead))))
    assert f"lead {lead} is 1.80 times what the other limb leads say" in exact[0]
    found = fatal(check_identities(with_lead(disturbed, lead, 1.8 * row(disturbed, lead))))
    assert f"lead {lead} " in found[0]
    assert f"--leads {','.join(name for name in LIMB_LEADS if name != lead)},V1" in found[0]


def test_exchanged_leads(disturbed: Recording) -> None:
    for one, other in combinations(LIMB_LEADS, 2):
        exchanged = with_lead(disturbed, one, row(disturbed, other))
        exchanged = with_lead(exchanged, other, row(disturbed, one))
        assert fatal(check_identities(exchanged))[0].endswith(f"give --swap {one}-{other}")


def test_lead_that_is_something_else(disturbed: Recording) -> None:
    other = np.roll(row(disturbed, "aVL"), 200)
    found = fatal(check_identities(with_lead(disturbed, "aVL", other)))
    assert "lead aVL does not follow from the other limb leads; leave it out" in found[0]


def test_exchanged_electrodes_break_nothing(good: Recording) -> None:
    order, sign = [0, 2, 1, 4, 3, 5], np.array([-1, 1, 1, 1, 1, 1])
    signal = good.signal.copy()
    signal[:6] = sign[:, None] * signal[order]
    assert fatal(check_identities(replace(good, signal=signal))) == []


def test_gain_of_its_own_for_each_lead(good: Recording, disturbed: Recording) -> None:
    gain = np.array([1.0, 1.5, 0.7, 1.2, 2.0, 0.8, *[1.0] * 6])
    noisy = replace(disturbed, signal=gain[:, None] * disturbed.signal)
    assert "each lead has a gain of its own" in fatal(check_identities(noisy))[0]
    found = fatal(check_identities(replace(good, signal=gain[:, None] * good.signal)))
    ratios = dict(part.split() for part in found[0].split("(")[-1].split(")")[0].split(", "))
    assert [float(ratios[lead]) for lead in LIMB_LEADS] == pytest.approx(gain[:6], abs=0.01)


def test_digits_tell_that_the_gains_are_wrong(good: Recording) -> None:
    gains = np.array([1012.0, 1280, 930, 988, 692, 1086, 2834, 2867, 2817, 1715, 2102, 1842])
    digits = np.round(1000 * good.signal)
    wrong = replace(good, signal=digits / gains[:, None], digits_per_millivolt=gains)
    assert (
        "the raw digits satisfy the identities; read it with --shared-gain"
        in fatal(check_identities(wrong))[0]
    )
    # gains that differ and are right
    digits = np.round(gains[:, None] * good.signal)
    right = replace(good, signal=digits / gains[:, None], digits_per_millivolt=gains)
    assert fatal(check_identities(right)) == []


def test_small_limb_leads_do_not_hide_wrong_gains(good: Recording) -> None:
    gains = np.array([1012.0, 1280, 930, 988, 692, 1086, 2834, 2867, 2817, 1715, 2102, 1842])
    digits = np.round(120 * good.signal)
    small = replace(good, signal=digits / gains[:, None], digits_per_millivolt=gains)
    findings = check_identities(small)
    assert max(finding.value for finding in findings[1:]) < 0.05
    assert "--shared-gain" in fatal(findings)[0]


def test_three_leads_leave_a_choice(good: Recording) -> None:
    signal = good.signal.copy()
    signal[3:6] = np.nan
    signal[2] *= -1
    (message,) = fatal(check_identities(replace(good, signal=signal)))
    assert "--invert III, or leads I and II are exchanged, give --swap I-II" in message


def test_computed_leads_prove_nothing(good: Recording) -> None:
    wrong = with_lead(good, "II", 1.8 * row(good, "II"))
    derived = replace(wrong, derived=("III", "aVR", "aVL", "aVF"))
    (finding,) = check_identities(derived)
    assert np.isnan(finding.value)
    assert finding.message == "not checked: no three limb leads were recorded at the same time"


def test_lead_groups_are_compared_where_they_overlap(good: Recording) -> None:
    signal, quarter = good.signal.copy(), good.signal.shape[1] // 4
    for group in range(4):
        rows = slice(3 * group, 3 * group + 3)
        signal[rows, : group * quarter] = np.nan
        signal[rows, (group + 1) * quarter :] = np.nan
    groups = replace(good, signal=signal)
    assert [finding.check.name for finding in check_identities(groups)] == [
        "Einthoven I + III - II", "identity aVF from aVR and aVL",
    ]  # fmt: skip
    signal[4] *= 3
    broken = check_identities(replace(good, signal=signal))
    assert [finding.severity for finding in broken] == [Severity.FINE, Severity.FATAL]


def test_chaos_has_no_explanation(good: Recording) -> None:
    shifted = np.stack([np.roll(lead, 37 * k) for k, lead in enumerate(good.signal)])
    findings = check_identities(replace(good, signal=shifted))
    assert fatal(findings) == []
    assert "no single lead, gain or exchange explains it" in warned(findings)[0]


@pytest.mark.parametrize("record", ["23", "24", "119"])
def test_real_headers_with_wrong_gains(data_folder: Path, record: str) -> None:
    folder = data_folder / "ecg" / "ludb"
    wrong = check_identities(read_recording(folder / f"{record}.hea"))
    assert "--shared-gain" in fatal(wrong)[0]
    right = check_identities(read_recording(folder / f"{record}_common.hea"))
    assert max(finding.value for finding in right if finding.check.unit == "mV") < 0.002
    assert fatal(right) == []
