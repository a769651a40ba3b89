"""The twelve leads: sum rules, no common potential, the template."""

import numpy as np
import pytest

from fascicle.core.leads import ELECTRODES, FRANK_ELECTRODES, LEADS, additional_leads, lead_matrix


@pytest.fixture
def leads():
    potentials = np.random.default_rng(0).normal(size=(9, 50))
    return dict(zip(LEADS, lead_matrix() @ potentials, strict=True)), potentials


def test_einthoven_and_goldberger(leads):
    lead, _ = leads
    np.testing.assert_allclose(lead["I"] + lead["III"], lead["II"], atol=1e-14)
    np.testing.assert_allclose(lead["aVR"] + lead["aVL"] + lead["aVF"], 0.0, atol=1e-14)
    np.testing.assert_allclose(lead["aVR"], -(lead["I"] + lead["II"]) / 2, atol=1e-14)
    np.testing.assert_allclose(lead["aVL"], (lead["I"] - lead["III"]) / 2, atol=1e-14)
    np.testing.assert_allclose(lead["aVF"], (lead["II"] + lead["III"]) / 2, atol=1e-14)


def test_each_lead_has_its_positive_electrode(leads):
    """A potential at one electrode only; lead I positive at LA, II and III at LL, Vn at Vn."""
    positive = {"I": "LA", "II": "LL", "III": "LL", "aVR": "RA", "aVL": "LA", "aVF": "LL"}
    positive |= {f"V{k}": f"V{k}" for k in range(1, 7)}
    matrix = lead_matrix()
    for row, lead in zip(matrix, LEADS, strict=True):
        assert row.argmax() == ELECTRODES.index(positive[lead])
        assert row.max() == 1.0


def test_no_lead_sees_a_common_potential():
    matrix = lead_matrix()
    np.testing.assert_allclose(matrix.sum(axis=1), 0.0, atol=1e-15)
    assert np.linalg.matrix_rank(matrix) == 8  # twelve leads, eight independent


def test_additional_electrodes_make_rows_after_the_twelve():
    """Unipolar leads against Wilson's terminal, then Frank's, whose weights add up to nothing."""
    electrodes = ("V7", *FRANK_ELECTRODES, "E12")
    assert [*additional_leads(electrodes)] == ["V7", "E12", "X", "Y", "Z"]
    potentials = np.random.default_rng(0).normal(size=(9 + len(electrodes), 50))
    at = dict(zip((*ELECTRODES, *electrodes), potentials, strict=True))
    matrix = lead_matrix(electrodes)
    np.testing.assert_allclose(matrix.sum(axis=1), 0.0, atol=1e-15)
    np.testing.assert_array_equal(matrix[:12, :9], lead_matrix())
    leads = matrix @ potentials
    np.testing.assert_allclose(leads[:12], lead_matrix() @ potentials[:9], atol=1e-14)
    wilson = potentials[:3].mean(axis=0)
    np.testing.assert_allclose(leads[12:14], [at["V7"] - wilson, at["E12"] - wilson], atol=1e-14)
    # as another device states Frank's network, with resistors rounded to two digits:
    # the manual of a stress-test system, http://www.imed.hu, appendix B
    x = 0.78 * (0.78 * at["A"] + 0.22 * at["C"] - at["I"])
    y = 0.35 * at["M"] + 0.65 * at["F"] - at["H"]
    z = 0.87 * (0.15 * at["A"] + 0.85 * at["M"] - 0.30 * at["I"] - 0.43 * at["E"] - 0.27 * at["C"])
    np.testing.assert_allclose(leads[14:], [x, y, z], atol=0.02)


def test_frank_leads_of_a_dipole_are_its_components():
    """X to the left, Y to the feet, Z to the back, in an unbounded conductor, far away."""
    left, back, up = np.eye(3) * 500.0  # mm
    at = {"A": left, "I": -left, "E": -back, "M": back, "C": (left - back) / np.sqrt(2)}
    at |= {"H": up, "F": -up}
    places = [np.zeros(3)] * 9 + [at[name] for name in FRANK_ELECTRODES]
    for axis, moment in zip("XYZ", (left, -up, back), strict=True):
        potentials = [p @ moment / max(np.linalg.norm(p), 1.0) ** 3 for p in places]
        found = dict(zip("XYZ", (lead_matrix(FRANK_ELECTRODES) @ potentials)[12:], strict=True))
        assert max(found, key=found.get) == axis
        assert found[axis] > 3 * max(abs(v) for name, v in found.items() if name != axis)
