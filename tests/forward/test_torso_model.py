"""Torsos in the forward model. The response is a crude one: its accuracy is tested elsewhere."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from anatomies import NETWORK

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS, Infeasible
from fascicle.core.quantities import QUANTITIES, TORSO_QUANTITIES
from fascicle.networks.prior_simulations import random_bodies
from fascicle.torso.conductor import torso_of
from fascicle.torso.lead_fields import is_up_to_date, lead_fields

TISSUES = ("lung", "blood", "myocardium", "body")


def with_torso(**values):
    return EXAMPLE_PARAMETERS | values


def test_an_unbounded_conductor_has_no_torso(small_model):
    with pytest.raises(InputError, match=r"'heart_up': .* has no torso"):
        small_model.simulate(NETWORK | {"heart_up": 5.0})


def test_neutral_torsos_are_the_plain_model(default_model):
    neutral = {name: QUANTITIES[name].default for name in TORSO_QUANTITIES}
    plain = default_model.simulate(EXAMPLE_PARAMETERS)
    found = default_model.simulate(with_torso(**neutral))
    np.testing.assert_array_equal(found.leads, plain.leads)
    assert default_model._torso is None


@pytest.mark.slow
class TestModel:
    def test_all_conductivities_alike_scale_nothing(self, torso_model):
        plain = torso_model.simulate(EXAMPLE_PARAMETERS)
        alike = torso_model.simulate(
            with_torso(**{f"{name}_conductivity": 1.6 for name in TISSUES})
        )
        np.testing.assert_allclose(alike.leads, plain.leads, rtol=1e-5, atol=1e-6)

    def test_a_torso_that_hardly_differs(self, torso_model):
        plain = torso_model.simulate(EXAMPLE_PARAMETERS).leads
        near = torso_model.simulate(with_torso(heart_up=1e-3)).leads
        far = torso_model.simulate(with_torso(heart_up=15.0)).leads
        assert np.abs(near - plain).max() < 1e-3 * np.abs(plain).max()
        assert np.abs(far - plain).max() > 0.05 * np.abs(plain).max()

    def test_activation_stays(self, torso_model):
        plain = torso_model.simulate(EXAMPLE_PARAMETERS)
        other = torso_model.simulate(with_torso(myocardium_conductivity=0.6, heart_left=9.0))
        np.testing.assert_array_equal(other.activation, plain.activation)

    def test_a_moved_electrode_changes_its_lead_alone(self, torso_model):
        """But for the terminal's reference, which the chest electrodes have no part in."""
        plain = torso_model.simulate(EXAMPLE_PARAMETERS).leads
        moved = torso_model.simulate(with_torso(v3_up=20.0)).leads
        change = np.abs(moved - plain).max(axis=1) / np.abs(plain).max()
        assert change[8] > 0.05
        assert np.delete(change, 8).max() < 1e-6

    def test_additional_electrodes_move_with_the_torso(self, torso_model):
        """Where LA is: LA less Wilson's terminal is 2/3 aVL, in every torso."""
        plain = torso_model.simulate(EXAMPLE_PARAMETERS).leads
        for values in ({"heart_up": 15.0, "chest_size": 1.1}, {"body_conductivity": 0.6}):
            leads = torso_model.simulate(with_torso(**values)).leads
            assert np.abs(leads[12] - plain[12]).max() > 0.01  # mV
            # what the modes do not span is scaled lead by lead
            aside = np.abs(leads[12] - leads[4] * 2 / 3).max()
            assert aside < 0.02 * np.abs(leads[4]).max()

    def test_one_activation_in_other_torsos(self, torso_model):
        bodies = [{"heart_up": 5.0}, {"v1_left": -20.0, "gain": 1.5}, {"chest_size": 1.1}]
        plain = torso_model.simulate(EXAMPLE_PARAMETERS)
        for body in bodies:
            ecg = torso_model.electrocardiograph_in_torso(body)
            found = body.get("gain", 1.0) * ecg.leads(plain.activation)
            np.testing.assert_allclose(
                found, torso_model.simulate(with_torso(**body)).leads, atol=1e-9
            )

    def test_random_bodies(self, torso_model, monkeypatch):
        meshed = torso_of(torso_model.heart)  # once: meshed anew, ECGs differ in the seventh digit
        monkeypatch.setattr("fascicle.torso.training.torso_of", lambda *_: meshed)
        plain = torso_model.simulate(EXAMPLE_PARAMETERS)
        one, again = (random_bodies(torso_model, np.random.default_rng(0), 3) for _ in range(2))
        for body, same in zip(one, again, strict=True):
            found = body.leads(plain.activation)
            np.testing.assert_array_equal(same.leads(plain.activation), found)
            change = np.sqrt(((found - plain.leads) ** 2).mean() / (plain.leads**2).mean())
            assert 0.1 < change < 1.5

    def test_other_processes(self, torso_model):
        networks = [with_torso(heart_up=5.0), EXAMPLE_PARAMETERS]
        with ProcessPoolExecutor(1) as pool:
            found = torso_model.simulate_many(networks, pool)
        for one, network in zip(found, networks, strict=True):
            np.testing.assert_allclose(one.leads, torso_model.simulate(network).leads, atol=1e-9)

    def test_a_heart_at_the_skin_is_an_outcome(self, torso_model):
        corner = {
            "heart_posterior": -20.0,
            "heart_left": 20.0,
            "chest_size": 0.85,
            "heart_up": -20.0,
        }
        corner |= {"heart_rotation_up": 0.349, "heart_rotation_left": -0.349}
        found = torso_model.simulate(with_torso(**corner))
        assert isinstance(found, Infeasible)
        assert "skin" in found.reason

    def test_the_standard_torso_is_that_of_the_lead_fields(self, default_heart):
        """Meshed again, it is no longer the same mesh; its fields differ by two in a hundred."""
        conduction = fascicle.ForwardModel(default_heart).conduction
        assert is_up_to_date(default_heart, conduction)
        kept = default_heart.lead_fields.values
        found = lead_fields(default_heart, torso_of(default_heart), conduction)
        centred = [z - z.mean(axis=1, keepdims=True) for z in (found - kept, kept)]
        assert np.linalg.norm(centred[0]) < 0.03 * np.linalg.norm(centred[1])
