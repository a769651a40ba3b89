"""Intervals of the posterior hold truths as often as they say, and are narrower than the prior's.

One run of the sampler on the emulator of the prior gives each posterior, and the truths are in the
plain torso: `benchmarks.calibration` has whole fits, and other torsos and physics.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from builders import recorded

from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.emulation.heart_emulator import emulator_of, simulations_for, usual_prior
from fascicle.emulation.likelihood import EmulatedLikelihood, likelihood_of, sampled
from fascicle.forward.beat import Beat
from fascicle.forward.scenario_files import read_scenarios
from fascicle.networks.settings import FitSettings
from fascicle.networks.simulator import PointSimulator

TRUTHS, DRAWS = 20, 30
PACING = read_scenarios("rv-apical-pacing")["rv-apical-pacing"]


def prolongation(model, values, own):
    """By how much pacing the apex of the right ventricle prolongs activation (ms)."""
    paced = model.activate(own.trees, scenario=PACING, **values)
    return paced.total_activation_time - own.total_activation_time


def networks(simulator, points):
    """Networks of the prior at points: their values and intrinsic beats."""
    for point in points:
        values = simulator.prior.from_unit(point)
        own = simulator.model.simulate(values)
        if isinstance(own, Beat) and simulator.prior.keeps(point, simulator.model.surfaces, own):
            yield values, own


def holds(draws, truth):
    low, high = np.percentile(draws, (5, 95), axis=0)
    return (low <= truth) & (truth <= high)


@pytest.mark.slow
def test_intervals_hold_truths(default_model, tmp_path):
    """Of 20 truths, 90 % intervals of parameters and of a prediction of pacing."""
    model, rng = default_model, np.random.default_rng(5)
    prior = usual_prior(model.heart, CONDUCTION_STATES["normal"])
    simulator, gain_sd = PointSimulator(model, prior), FitSettings().gain_sd
    simulations = simulations_for(model, prior, tmp_path)
    emulator = emulator_of(simulations, FitSettings().prior_simulations, simulator.pool)
    truths = networks(simulator, prior.sample(rng, 400))
    parameters, predictions, of_prior = [], [], []
    for values, own in islice(truths, TRUTHS):
        gain = 1 + gain_sd * rng.standard_normal()
        target = recorded(replace(own, leads=gain * own.leads))
        likelihood = likelihood_of(target, emulator, gain_sd)
        emulated = EmulatedLikelihood(simulator, emulator, likelihood)
        (run,) = sampled([emulated], prior.dimension, [rng], 300, "", None)
        columns = prior.learnt_columns(run.points)
        draws = np.column_stack([columns[name] for name in prior.names])
        parameters.append(holds(draws, [values[name] for name in prior.names]))
        widths = [parameter.upper - parameter.lower for parameter in prior.learnt.parameters]
        of_prior.append(np.ptp(np.percentile(draws, (5, 95), axis=0), axis=0) / widths)
        drawn = networks(simulator, rng.permutation(run.points))
        times = [prolongation(model, *network) for network in islice(drawn, DRAWS)]
        predictions.append(holds(times, prolongation(model, values, own)))

    assert 0.8 < np.mean(parameters) < 0.97
    assert np.mean(predictions) >= 0.65  # of few draws, whose percentiles lie too close together
    assert np.mean(of_prior) < 0.8  # of 0.9 in the prior
    assert np.mean(of_prior, axis=0).min() < 0.5
