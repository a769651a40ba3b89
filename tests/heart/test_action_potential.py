"""An action potential from a table, in place of the built-in one."""

import re
from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK

from fascicle import ForwardModel, load_heart, read_action_potential
from fascicle.core.errors import InputError
from fascicle.forward.electrocardiogram import build_electrocardiograph, unbounded_gradients
from fascicle.forward.template import default_template
from fascicle.heart.conduction import Conduction
from fascicle.heart.folder import write_heart
from fascicle.mesh.measures import barycentric_gradients
from tests.builders import box

RISE = [(t, -85.0 if t < 0 else 20.0) for t in range(-5, 10)]


def write(path, rows, header="time_ms,potential_mV"):
    path.write_text("\n".join([header, *(f"{t!s},{u!s}" for t, u in rows)]) + "\n")
    return path


@pytest.fixture(scope="module")
def ecg():
    """The twelve leads (mV) of an oblique front in a block, as a function of U."""
    block, conduction = box((30.0, 20.0, 20.0), (6, 4, 4)), Conduction()
    turn = np.linspace(0.0, 2.0 * np.pi, 9, endpoint=False)
    electrodes = np.column_stack([90 * np.cos(turn), 70 * np.sin(turn), 40 * np.sin(3 * turn)])
    gradients = unbounded_gradients(block.vertices, block.tetrahedra, electrodes, conduction.torso)
    built = build_electrocardiograph(
        block.tetrahedra,
        barycentric_gradients(block.vertices, block.tetrahedra),
        block.volumes,
        conduction.intracellular(block.fibres),
        gradients,
        default_template(),
    )
    activation = block.vertices @ [1.0, 0.5, 0.2]
    return lambda potential: replace(built, action_potential=potential).leads(activation)


def rows_of(potential, times):
    return zip(times.tolist(), potential(times).tolist(), strict=True)


def times_of_the_ecg():
    """Where the ECG takes U, within the span: `bin_response` of bins of 0.5 ms."""
    node, _ = np.polynomial.legendre.leggauss(8)
    begin, end = default_template().span
    at = ((np.arange(2 * begin, 2 * end)[:, None] + (node + 1) / 2) * 0.5).ravel()
    return np.concatenate([[begin], at, [end]])


def test_the_built_in_template_as_a_table_gives_the_same_ecg(tmp_path, ecg):
    built_in = default_template()
    table = write(tmp_path / "u.csv", rows_of(built_in, times_of_the_ecg()))
    read = read_action_potential(table)
    assert read.span == built_in.span
    assert np.abs(ecg(built_in)).max() > 0.01
    assert np.abs(ecg(read) - ecg(built_in)).max() < 1e-9


@pytest.mark.parametrize(("every", "error"), [(0.02, 1e-5), (0.1, 1e-4)])
def test_how_fine_a_table_must_be(tmp_path, ecg, every, error):
    """As a share of the largest deflection; what is lost is the foot and top of the upstroke."""
    built_in = default_template()
    times = np.linspace(-4.0, 60.0, round(64 / every) + 1)
    read = read_action_potential(write(tmp_path / "u.csv", rows_of(built_in, times)))
    difference = np.abs(ecg(read) - ecg(built_in)).max() / np.abs(ecg(built_in)).max()
    assert 0 < difference < error


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (RISE[:9], "9 samples; give 10 or more"),
        ([*RISE, (9, 20)], "from 9 to 9 ms in row 16 of samples; give inc"),
        ([*RISE, (10, "nan")], "row 16 of samples is '10,nan'; give two"),
        ([*RISE, (10, "1,2")], "row 16 of samples is '10,1,2'"),
        ([*RISE, (1e9, 20)], "time_ms reaches 1e+09; give -2000 to 2000"),
        ([(t, u / 1e3) for t, u in RISE], "changes by 0.105 mV in all"),
        ([(t + 40, u) for t, u in RISE], "steepest rise is at 39.5 ms"),
        (None, "its header is 't,u'; give a CSV file with the header time_ms,potential_mV"),
    ],
)
def test_another_table_is_refused(tmp_path, rows, words):
    header = "t,u" if rows is None else "time_ms,potential_mV"
    path = write(tmp_path / "u.csv", rows or RISE, header)
    with pytest.raises(InputError, match=re.escape(words)) as refused:
        read_action_potential(path)
    assert str(refused.value).startswith(str(path))
    assert "; give " in str(refused.value)


def test_a_heart_brings_its_own(tmp_path, small_model, small_heart):
    """A table named in heart.toml: of every model of the heart, of its digest and of copies."""
    write_heart(small_heart, tmp_path / "heart")
    manifest = tmp_path / "heart" / "heart.toml"
    manifest.write_text('action_potential = "u.csv"\n' + manifest.read_text())
    with pytest.raises(InputError, match=re.escape("u.csv")):
        load_heart(tmp_path / "heart")
    write(tmp_path / "heart" / "u.csv", [(t / 3, u) for t, u in RISE])
    heart = load_heart(tmp_path / "heart")
    assert heart.digest != small_heart.digest
    write_heart(heart, tmp_path / "copy")
    copy = load_heart(tmp_path / "copy")
    assert copy.digest == heart.digest
    assert copy.action_potential.times.tobytes() == heart.action_potential.times.tobytes()
    given = read_action_potential(tmp_path / "heart" / "u.csv")
    own = ForwardModel(copy).simulate(NETWORK).ecg
    same = ForwardModel(small_heart, action_potential=given).simulate(NETWORK).ecg
    other = small_model.simulate(NETWORK).ecg
    np.testing.assert_array_equal(own, same)
    assert own.shape != other.shape or not np.allclose(own, other)
