"""The template of the ECG, and its file."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward import template as module
from fascicle.forward.cable import max_upstroke, simulate_cable
from fascicle.forward.electrocardiogram import bin_response
from fascicle.forward.template import TAPER, CableTemplate, stored_template, template_of
from fascicle.kernels.ten_tusscher import CELLS


@pytest.fixture(scope="module")
def template():
    """Endocardial, from a shorter and coarser cable than the default's."""
    run = simulate_cable(CELLS["endocardial"], length=10.0, duration=450.0, spacing=0.1, step=0.02)
    return template_of(run, "endocardial")


@pytest.fixture
def folder(tmp_path, monkeypatch, template):
    """An empty cache, and a simulation that is counted instead of made."""
    made = []

    def make(cell):
        made.append(cell.name)
        return template

    monkeypatch.setenv("FASCICLE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "simulate_cable", make)
    monkeypatch.setattr(module, "template_of", lambda run, cell: run)
    return tmp_path / "cache", made


def test_time_zero_is_the_maximum_upstroke(template):
    time = np.linspace(-2, 2, 40001)
    slope, when = max_upstroke(time, template(time))
    assert when == pytest.approx(0.0, abs=2e-3)
    assert slope == pytest.approx(207, rel=0.06)


def test_template_is_the_record_between_its_windows(template):
    """What the opening leaves out is the diastole's drift, and nothing of the front."""
    time = np.linspace(-2.0, template.until - TAPER, 5000)
    difference = template(time) - template.full(time)
    assert np.ptp(difference) < 5e-4
    assert np.abs(difference).max() < 5e-4
    assert np.ptp(template(time)) > 110


def test_template_stays_outside_its_span_and_has_no_kink(template):
    begin, end = template.span
    assert (begin, end) == (-4.0, 60.0)
    for edge, outside in ((begin, -1000.0), (end, 1000.0)):
        assert template(np.array([outside]))[0] == template(np.array([edge]))[0]
    time = np.arange(end - 2 * TAPER, end + 1, 0.05)
    bends = np.diff(template(time), 2) / 0.05**2
    assert np.abs(bends).max() < 0.02  # mV/ms²; a cut would make it 0.8
    assert np.ptp(template(time)) > 0.1


def test_record_repolarises(template):
    assert template.full(np.array([400.0]))[0] < -80
    assert template(np.array([400.0]))[0] > 15


def test_content_decides_equality(template):
    same = CableTemplate("endocardial", template.times.copy(), template.potentials, template.speed)
    assert same == template
    assert hash(same) == hash(template)
    assert pickle.loads(pickle.dumps(template)) == template
    changed = template.potentials.copy()
    changed[100] += 1e-9
    for other in (
        replace(template, potentials=changed),
        replace(template, until=50.0),
        replace(template, cell="epicardial"),
    ):
        assert other != template
        assert repr(other) != repr(template)
    assert "endocardial" in repr(template)


@pytest.mark.parametrize("until", [5.0, 1000.0])
def test_until_must_lie_in_the_record(template, until):
    with pytest.raises(InputError, match="template until"):
        replace(template, until=until)


def test_response_to_a_bin_carries_the_whole_rise(template):
    """Bins of 0.5 ms, as the ECG uses; U has come to rest at the end of its ringing."""
    _, kernel = bin_response(template, 0.5)
    rise = template(np.array([60.0]))[0] - template(np.array([-4.0]))[0]
    assert kernel.sum() * 0.5 == pytest.approx(rise, abs=1e-6)
    assert np.abs(kernel[[0, -1]]).max() < 1e-6 * np.abs(kernel).max()


def test_qrs_does_not_feel_where_the_template_stops(default_model, template):
    """Against the record until 350 ms; what repolarises before that does so after the QRS."""
    activation = default_model.simulate(EXAMPLE_PARAMETERS).activation
    last = int(activation.max())
    leads = []
    for until in (60.0, 350.0):
        cut = replace(template, until=until)
        electrocardiograph = replace(default_model.electrocardiograph, action_potential=cut)
        leads.append(electrocardiograph.leads(activation)[:, : last + 1])
    assert np.abs(leads[0]).max() > 1.5
    assert np.abs(leads[0] - leads[1]).max() < 0.02
    assert np.abs(leads[0] - leads[1]).max() > 1e-5


def test_template_is_simulated_once(folder, template):
    cache, made = folder
    assert stored_template("endocardial") == template
    assert stored_template("endocardial") == template
    assert made == ["endocardial"]
    assert len(list(cache.iterdir())) == 1
    stored_template("epicardial")
    assert made == ["endocardial", "epicardial"]
    assert len(list(cache.iterdir())) == 2


def test_key_changes_with_version_and_code(folder, template, monkeypatch, tmp_path):
    cache, made = folder
    stored_template("endocardial")
    monkeypatch.setattr("fascicle.core.files.VERSION", "0.0.0")
    stored_template("endocardial")
    source = tmp_path / "other.py"
    source.write_text("G_NA = 15.0")
    monkeypatch.setattr(module, "SOURCES", [source])
    stored_template("endocardial")
    assert len(made) == 3
    assert len(list(cache.iterdir())) == 3


def test_figure_and_table(folder, template):
    """All three cells from the fake simulation, so every row is the same."""
    from fascicle.reporting.ecg import template_figure

    module.default_template.cache_clear()
    reports = []
    figure, table = template_figure(lambda *report: reports.append(report))
    module.default_template.cache_clear()
    assert [report[1:3] for report in reports] == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert set(table) == {"endocardial", "midmyocardial", "epicardial"}
    row = table["endocardial"]
    assert row["resting_potential"] == pytest.approx(-86.0, abs=0.3)
    assert row["overshoot"] == pytest.approx(30.0, abs=0.5)
    assert row["apd90"] == pytest.approx(299.0, abs=1.5)
    assert row["conduction_velocity"] == pytest.approx(0.78, abs=0.01)
    assert len(figure.axes) == 2
    assert all("(ms)" in axes.get_xlabel() and "(mV)" in axes.get_ylabel() for axes in figure.axes)
