"""A classifier of simulated recordings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import idct

from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.emulation.ecg_classifier import (
    COSINES,
    LENGTH,
    EcgClassifier,
    Recorder,
    RecordingSet,
    in_cosines,
    in_leads,
    learn,
    most_alike,
)
from fascicle.emulation.recalibration import packaged_recalibration
from fascicle.emulation.state_classifier import unlike
from fascicle.networks.prior_simulations import BEFORE
from fascicle.recording.target import Target

ROWS = np.array(INDEPENDENT_ROWS)


def normal(rng, means, count):
    """Recordings whose first coefficient is normal about a mean, which none else depends on."""
    kinds = np.repeat(np.arange(len(means)), count)
    recordings = rng.normal(0, 0.2, (len(kinds), 8, COSINES)).astype(np.float32)
    recordings[:, 0, 0] = rng.normal(np.asarray(means)[kinds], 1.0)
    return RecordingSet(recordings, np.eye(len(means), dtype=np.float32)[kinds])


@pytest.fixture(scope="module")
def classifier():
    rng, means = np.random.default_rng(0), (-1.0, 0.0, 2.0)
    return learn(normal(rng, means, 10_000), normal(rng, means, 2000), ROWS, rng, steps=800)


def test_probabilities_are_those_of_bayes(classifier):
    """Three normal kinds of equal SD: the exact posterior is known."""
    values = np.linspace(-2.5, 3.5, 13)
    recordings = np.zeros((len(values), 8, COSINES))
    recordings[:, 0, 0] = values
    density = np.exp(-0.5 * (values[:, None] - np.array([-1.0, 0.0, 2.0])) ** 2)
    exact = density / density.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(classifier.of_cosines(recordings), exact, atol=0.06)
    roots = np.sqrt(exact) / np.sqrt(exact).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(classifier.tempered(2).of_cosines(recordings), roots, atol=0.06)
    # of the best possible one: cuts at -0.5 and 1
    assert classifier.accuracy == pytest.approx((0.691 + 0.533 + 0.841) / 3, abs=0.02)


def test_it_is_stored_as_it_is(classifier):
    arrays = classifier.arrays()
    again = EcgClassifier.from_arrays(arrays)
    assert again.accuracy == classifier.accuracy
    recordings = np.random.default_rng(1).normal(0, 1, (20, 8, COSINES))
    np.testing.assert_allclose(
        again.of_cosines(recordings), classifier.of_cosines(recordings), atol=0.01
    )
    assert again.most_unexplained == classifier.most_unexplained
    np.testing.assert_allclose(
        again.unexplained(recordings), classifier.unexplained(recordings), atol=1e-5
    )
    without = replace(classifier, most_unexplained=None).arrays()  # as those of origins are kept
    assert "most_outside" not in without
    assert EcgClassifier.from_arrays(without).most_unexplained is None


def test_what_lies_outside_the_components(classifier):
    """Nothing of a sum of components, all of what is orthogonal to them, whatever the size."""
    flat = classifier.components[:3].sum(axis=0)
    inside = flat.reshape(1, 8, COSINES)
    np.testing.assert_allclose(classifier.unexplained(7 * inside), 0, atol=1e-5)
    other = np.random.default_rng(6).normal(size=flat.shape)
    other -= classifier.components.T @ (classifier.components @ other)
    np.testing.assert_allclose(classifier.unexplained(other.reshape(1, 8, COSINES)), 1, atol=1e-5)
    held_out = normal(np.random.default_rng(3), (-1.0, 0.0, 2.0), 2000).recordings
    familiar = (classifier.unexplained(held_out) <= classifier.most_unexplained).mean()
    assert familiar == pytest.approx(0.98, abs=0.01)


def test_the_distance_from_the_training_set_is_that_of_mahalanobis(classifier):
    """Along a component, and outside, where the variance is that of the last; of any size."""
    sds = np.linspace(3.0, 0.5, 80)
    axes = np.eye(8 * COSINES)
    simple = replace(
        classifier, mean=0 * axes[0], components=axes[:80], scale=np.sqrt(sds * sds.max())
    )
    recordings = 7 * axes[[0, 40, 100]].reshape(3, 8, COSINES)
    expected = (sds**2).sum() / sds[[0, 40, 79]] ** 2
    np.testing.assert_allclose(simple.distance(recordings), expected)


def target_of(cosines):
    """A recording whose independent leads are these, in silence before and after."""
    ecg = np.zeros((12, LENGTH))
    ecg[ROWS] = idct(cosines, n=LENGTH, axis=1, norm="ortho")
    time = np.arange(LENGTH) - float(BEFORE)
    return Target(ecg[None], time, time[0] + BEFORE, time[-1], 60.0, {}, 4.0, 5.0)


def test_what_is_unlike_all_simulated_recordings_is_said(classifier):
    """A recording of components alone is like them; noise is unlike them."""
    of_few = replace(classifier, most_unexplained=0.1)
    like = classifier.components[:3].sum(axis=0).reshape(8, COSINES)
    assert unlike(of_few, target_of(like)) == ""
    strange = target_of(3 * np.random.default_rng(8).normal(size=(8, COSINES)))
    (outside,) = of_few.unexplained(of_few.cosines(strange))
    (distance,) = of_few.distance(of_few.cosines(strange))
    people = replace(packaged_recalibration(), farthest=distance + 1)
    assert unlike(of_few, strange, people) == ""
    refused = unlike(of_few, strange, replace(people, farthest=distance - 1))
    assert f"(squared distance {distance:.0f}, in 99% of people {distance - 1:.0f}" in refused
    assert unlike(of_few, strange) == (
        f"the recording is unlike all simulated ones of this heart ({outside:.0%} of its QRS, "
        "10% at most expected)"
    )


def test_a_target_is_seen_from_its_onset_on(classifier):
    """As the simulated ECGs are from the first activation on, and silent after its end."""
    rng = np.random.default_rng(2)
    time = np.arange(-100.0, 200.0)
    beats = rng.normal(0, 1, (3, 12, len(time)))
    target = Target(beats, time, -40.0, 60.0, 60.0, {}, 4.0, 5.0)
    seen = np.zeros((1, 8, LENGTH))
    seen[0, :, BEFORE : BEFORE + 101] = target.mean[ROWS][:, 60:161]
    np.testing.assert_allclose(classifier.cosines(target), in_cosines(seen), atol=1e-12)


@pytest.fixture(scope="module")
def recorder():
    discrepancy = np.eye(8 * COSINES) * np.sqrt(LENGTH / COSINES)  # of unit size in time
    return Recorder(np.zeros((2, 8, 8)), np.zeros((1, 8, COSINES)), discrepancy)


def pulses(count):
    ecgs = np.zeros((count, 8, LENGTH))
    ecgs[:, :, BEFORE : BEFORE + 100] = np.sin(np.linspace(0, np.pi, 100)) ** 2
    return ecgs


def test_recordings_have_other_gains_places_and_discrepancies(recorder):
    rng, ecgs = np.random.default_rng(3), pulses(3000)
    recorded = recorder.recorded(ecgs, rng)
    plain = in_cosines(ecgs[:1])[0]
    gain = recorded.mean(axis=(0, 1))[0] / plain.mean(axis=0)[0]  # a shift leaves the mean
    assert gain == pytest.approx(1, abs=3 * recorder.gain_sd / np.sqrt(3000))
    # with shifts undone, what is left are gain and discrepancy
    still = recorder.recorded(ecgs, rng)[:, :, -1]  # a mode without signal
    size = np.sqrt((ecgs[0] ** 2).mean() * LENGTH / 99)
    shares = still.std() / np.sqrt(LENGTH / COSINES) / size
    assert 0.2 < shares < 0.35  # root mean square of 10 to 40 %, in spread gains
    ecgs = pulses(7)
    count = recorder.chunk + 3
    recordings, chosen = recorder.recordings(ecgs, ROWS, count, np.random.default_rng(4))
    assert recordings.shape == (count, 8, COSINES)
    assert np.ptp(np.bincount(chosen, minlength=7)) <= 1


def test_other_leads_and_what_is_most_alike():
    leads = in_leads(np.array([2, 5, 6]))  # III, aVF, V1
    np.testing.assert_allclose(leads[0, :2], [-1, 1])
    np.testing.assert_allclose(leads[1, :2], [-0.5, 1], atol=1e-6)
    np.testing.assert_allclose(leads[2], np.eye(8)[2])
    rng = np.random.default_rng(5)
    reference = rng.normal(0, 1, (30, 8, COSINES))
    found = most_alike(3 * reference[4:6], reference)
    np.testing.assert_allclose(found, 1)
    assert most_alike(-reference[:1], reference[:1]) == 0
