"""Indices of activations and ECGs whose values are known by hand."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import box, case

from fascicle.core.leads import LEADS
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.heart.fibres import Wall
from fascicle.heart.sites import APEX, Places, places
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.indices import Territories, indices, vectorcardiogram
from fascicle.recording.window import qrs_window

LENGTH, SPEED = 180.0, 0.9  # mm, mm/ms: a plane front takes 200 ms
CELLS = 18  # slabs of 10 mm: segment 0 (right ventricle), 1, …, 17, of 100/9 ms each
SLAB = LENGTH / SPEED / CELLS  # ms


@pytest.fixture(scope="module")
def bar():
    """A bar that is cut into slabs: the right ventricle, then the segments one after the other."""
    return box((LENGTH, 10.0, 10.0), (2 * CELLS, 2, 2))


@pytest.fixture(scope="module")
def territories(bar):
    x = bar.vertices[bar.tetrahedra].mean(axis=1)[:, 0]
    segment = np.floor(x / LENGTH * CELLS).astype(np.int64)
    wall = np.select([segment == 0, segment <= 9], [Wall.RV, Wall.SEPTUM], Wall.LV)
    return Territories.of(bar, Places(segment, wall, x, x, x))


def segment_times(activation, territories):
    return territories.segment_means(territories.times(activation))[1:]


def simulated(activation, leads=None, onset=0.0):
    if leads is None:
        leads = wave({"V6": 60.0})
    return Beat(leads, onset, (), Activation(activation))


def wave(peaks, width=12.0, size=1.0, length=200):
    """Half a sine in each lead, of a width (ms) to either side of its peak (ms).

    V3 and V4 have all of them: one lead alone is no QRS.
    """
    leads, time = np.zeros((12, length)), np.arange(length)
    for name, peak in peaks.items():
        away = np.abs(time - peak)
        sine = size * np.where(away < width, np.cos(np.pi * away / 2 / width), 0)
        leads[LEADS.index(name)] = sine
        leads[8:10] += sine
    return leads


class TestActivation:
    def test_of_a_plane_front(self, bar, territories):
        times = bar.vertices[:, 0] / SPEED + 7.0
        found = indices(simulated(times), territories)
        assert set(found) == set(INDICES)
        whole = LENGTH / SPEED
        assert found["total_activation_time"] == pytest.approx(whole)
        assert found["rv_activation_time"] == pytest.approx(SLAB)
        assert found["lv_activation_time"] == pytest.approx(whole)
        # an element counts as active at its mean time
        assert found["activation_time_90"] == pytest.approx(0.9 * whole, abs=SLAB / 2)
        assert found["activation_time_95"] == pytest.approx(0.95 * whole, abs=SLAB / 2)
        # from the middle of the first slab to the middle of the last eight
        assert found["lv_rv_delay"] == pytest.approx(13.5 * SLAB)
        assert found["lv_dyssynchrony"] == pytest.approx(SLAB * np.std(np.arange(APEX)))
        assert found["latest_segment"] == 17
        np.testing.assert_allclose(
            segment_times(times, territories), 7.0 + SLAB * (np.arange(APEX) + 1.5)
        )

    def test_of_a_front_from_the_other_end(self, bar, territories):
        found = indices(simulated((LENGTH - bar.vertices[:, 0]) / SPEED), territories)
        assert found["latest_segment"] == 1
        assert found["lv_rv_delay"] == pytest.approx(-13.5 * SLAB)

    def test_scar_takes_no_part(self, bar, territories):
        """The last two segments are never reached, nor what touches them."""
        x = bar.vertices[:, 0]
        scar = x > LENGTH * 16 / 18 + 1e-9
        found = indices(simulated(np.where(scar, np.inf, x / SPEED)), territories)
        assert found["total_activation_time"] == pytest.approx(16 * SLAB)
        assert found["latest_segment"] == 15
        times = segment_times(np.where(scar, np.inf, x / SPEED), territories)
        assert np.isnan(times[15:]).all()
        assert np.isfinite(times[:15]).all()

    def test_segments_without_tissue_are_left_out(self, default_heart):
        found = Territories.of(default_heart, places(default_heart))
        without = replace(found, segment=np.where(found.segment == 17, 16, found.segment))
        times = default_heart.vertices[:, 2] - default_heart.vertices[:, 2].min()
        assert np.isnan(segment_times(times, without)[-1])
        assert np.isfinite(indices(simulated(times), without)["lv_dyssynchrony"])


class TestEcg:
    @pytest.fixture
    def flat(self, bar):
        return bar.vertices[:, 0] / SPEED

    def test_peaks_are_counted_from_the_stimulus(self, flat, territories):
        leads = wave({"V6": 80.0, "V1": 113.0})
        found = indices(simulated(flat, leads, onset=-20.0), territories, stimulus=-15.0)
        assert found["v6_r_wave_peak_time"] == pytest.approx(80 - 20 + 15)
        assert found["v6_v1_interpeak_interval"] == pytest.approx(33.0)
        first, last = qrs_window(leads)
        assert found["qrs_duration"] == last - first
        assert found["qrs_from_stimulus"] == pytest.approx(last - 20 + 15)

    def test_what_is_not_there_is_not_a_number(self, flat, territories):
        found = indices(simulated(flat, wave({"V6": 80.0})), territories)
        for name in ("qrs_from_stimulus", "v6_r_wave_peak_time", "v6_v1_interpeak_interval"):
            assert np.isnan(found[name])
        assert np.isfinite(found["qrs_area"])

    @pytest.mark.parametrize(
        ("lead", "expected"), [("V6", (0.67, 0.14, -0.03)), ("II", (0.06, 0.94, -0.57))]
    )
    def test_area_of_one_wave(self, flat, territories, lead, expected):
        """Expected are the sums of the lead's, V3's and V4's weights in Kors' table."""
        leads = wave({lead: 100.0}, width=40.0, size=1.5)
        area = 1.5 * 2 * 40 * 2 / np.pi  # mV ms: of half a sine
        found = indices(simulated(flat, leads), territories)
        assert found["qrs_area"] == pytest.approx(area * np.linalg.norm(expected), rel=0.01)
        loop = vectorcardiogram(leads)
        np.testing.assert_allclose(loop[:, 100], 1.5 * np.array(expected))

    def test_area_of_opposite_waves_is_none(self, flat, territories):
        leads = wave({"V6": 60.0}) - wave({"V6": 110.0})
        assert indices(simulated(flat, leads), territories)["qrs_area"] == pytest.approx(0, abs=0.5)


def test_left_bundle_branch_block_as_clinics_know_it(default_model, default_heart):
    """Wide QRS, a late left and lateral wall, a large area; a right block is late on the right."""
    from fascicle.core.parameters import EXAMPLE_PARAMETERS
    from fascicle.forward.primitives import His

    territories = Territories.of(default_heart, places(default_heart))
    normal, left, right = (
        indices(default_model.simulate(EXAMPLE_PARAMETERS, case(his=his)), territories)
        for his in (His(), His(left=0.0), His(right=0.0))
    )
    assert left["qrs_duration"] > 120 > normal["qrs_duration"]
    assert left["lv_rv_delay"] > normal["lv_rv_delay"] + 20 > right["lv_rv_delay"] + 40
    assert left["qrs_area"] > 102 > normal["qrs_area"]
    assert left["latest_segment"] in (5, 6, 11, 12, 16)
    assert right["v6_v1_interpeak_interval"] > 0 > left["v6_v1_interpeak_interval"]


def test_documentation_says_what_they_are():
    page = (Path(__file__).parents[2] / "docs" / "predictions.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \|", page, flags=re.MULTILINE)
    assert dict(rows) == INDICES
