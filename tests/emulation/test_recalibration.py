"""Recalibration of the atlas's conduction states on labelled people."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logit

from benchmarks.atlas import CODES, atlas_classifier, digest_of_classifier, learnt, states_of
from fascicle.core.conduction_states import FASCICULAR_BLOCKS, told_apart
from fascicle.core.leads import INDEPENDENT_LEADS, limb_leads_from
from fascicle.emulation import recalibration as module
from fascicle.emulation.recalibration import BUNDLES, as_simulated, measurements, recalibration_of
from fascicle.emulation.state_classifier import probabilities
from fascicle.networks.prior import state_label
from fascicle.recording.target import Target

ANTERIOR, POSTERIOR = FASCICULAR_BLOCKS
PACKAGED = module.packaged_recalibration()


def qrs_of(axis, rng):
    """QRS (12, 100) with this frontal axis (degrees)."""
    limb = np.cos(np.radians(axis - np.array([0, 60])))[:, None]  # I and II
    leads = rng.normal(0, 0.01, (12, 100))
    leads[:6] = limb_leads_from(INDEPENDENT_LEADS)[:, :2] @ (limb * np.hanning(100))
    return leads


@pytest.fixture
def target():
    time = np.arange(-100.0, 200.0)
    beats = np.zeros((2, 12, len(time)))
    beats[:, :, 60:160] = qrs_of(-60, np.random.default_rng(0))
    return Target(beats, time, -40.0, 60.0, 60.0)


def test_the_coefficients_belong_to_the_packaged_classifier():
    assert PACKAGED.classifier == digest_of_classifier(atlas_classifier()), (
        "the classifier of the atlas has changed; run python -m benchmarks.atlas recalibrate"
    )


def test_coefficients_of_labelled_people_are_recovered():
    """Of states drawn from a recalibration; right blocks have fascicular blocks beside them."""
    rng, count = np.random.default_rng(1), 40_000
    names = ("left", "right", "right block", "superior", "leftward", "net II", "late V1")
    features = {name: rng.normal(0, 1, count) for name in names} | {
        "duration": rng.normal(120, 20, count)
    }
    codes = [set() for _ in range(count)]
    for model in (PACKAGED.bundles, PACKAGED.fascicles):
        below = np.cumsum([*model.probabilities(features).values()], axis=0)
        for person, k in zip(codes, (rng.random(count) > below[:-1]).sum(axis=0), strict=True):
            person.update(code for code, name in CODES.items() if name == model.states[k])
    again = learnt(features, codes, np.arange(101.0))
    assert again.farthest == 99
    for known, fitted in zip(
        PACKAGED.bundles.terms + PACKAGED.fascicles.terms,
        again.bundles.terms + again.fascicles.terms, strict=True,
    ):  # fmt: skip
        assert fitted.coefficient == pytest.approx(known.coefficient, abs=0.35)
    expected, truth = again.probabilities(features), np.array(states_of(codes))
    np.testing.assert_allclose(sum(expected.values()), 1)
    for name, p in expected.items():
        if not name.startswith("left bundle"):  # learnt only where the left branch conducts
            assert p.mean() == pytest.approx((truth == name).mean(), abs=0.006)


def test_a_left_axis_raises_the_anterior_block_and_a_right_one_the_posterior():
    rng = np.random.default_rng(2)
    blocks = {
        axis: PACKAGED.fascicles.probabilities(measurements(qrs_of(axis, rng)))
        for axis in (-60, 45, 120)
    }
    assert blocks[-60][ANTERIOR] > 0.5 > 10 * blocks[45][ANTERIOR]
    assert blocks[120][POSTERIOR] > 10 * blocks[45][POSTERIOR]
    assert blocks[120][ANTERIOR] < blocks[45][ANTERIOR]


def test_probabilities_of_a_recording_add_up_and_follow_the_priors(target):
    """An uncertain classifier of a recording with an axis of -60 degrees, and narrow."""
    classifier = SimpleNamespace(
        probabilities=lambda _: np.array([0.7, 0.02, 0.05, 0.1, 0.1, 0.03])
    )
    default = {state.name: state.probability for state in told_apart()}
    usual = probabilities(classifier, BUNDLES, default, target, PACKAGED)
    assert sum(usual.values()) == pytest.approx(1)
    assert [*usual] == ["normal", *FASCICULAR_BLOCKS, *BUNDLES[1:]]
    assert max(usual, key=usual.__getitem__) == ANTERIOR
    features = module.features_of(
        target, dict(zip(BUNDLES, classifier.probabilities(0), strict=True))
    )
    assert features["duration"] == target.qrs_duration
    (anywhere,) = PACKAGED.fascicular(features)[ANTERIOR]
    assert anywhere > usual[ANTERIOR]  # with a right bundle branch block, too
    right = "right bundle branch block"
    doubled = probabilities(
        classifier, BUNDLES, default | {right: 2 * default[right]}, target, PACKAGED
    )
    assert logit(doubled[right]) - logit(usual[right]) == pytest.approx(np.log(2))
    some = probabilities(classifier, BUNDLES, {"normal": 1.0, right: 1.0}, target, PACKAGED)
    assert {*some} == {"normal", *FASCICULAR_BLOCKS, right}
    assert some[ANTERIOR] / some["normal"] == pytest.approx(usual[ANTERIOR] / usual["normal"])
    simulated = as_simulated(usual)
    assert [*simulated] == [*BUNDLES]
    assert simulated["normal"] == pytest.approx(sum([*usual.values()][:3]))
    assert state_label("normal", usual) == "normal"
    assert state_label("normal", simulated) == "normal or fascicular block"


def test_only_the_atlas_is_recalibrated_and_only_by_all_leads(target):
    atlas, person = SimpleNamespace(atlas=object()), SimpleNamespace(atlas=None)
    assert recalibration_of(atlas, target, BUNDLES) is PACKAGED
    assert recalibration_of(person, target, BUNDLES) is None
    assert recalibration_of(atlas, target, BUNDLES[:5]) is None
    beats = target.beats.copy()
    beats[:, 6] = np.nan
    assert recalibration_of(atlas, replace(target, beats=beats), BUNDLES) is None
