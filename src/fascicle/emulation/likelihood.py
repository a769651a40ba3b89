"""Likelihood of a study's target by an emulator of the heart, with the emulator's residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS, independent_rows
from fascicle.core.ranges import short_repr
from fascicle.emulation.ecg_emulator import EcgEmulator, cosines_of, tissue_inputs
from fascicle.emulation.predictive import LEAST_EXPLAINED, LEAST_IN_TORSO, Checks
from fascicle.forward.beat import Signals
from fascicle.forward.likelihood import (
    MARGIN,
    Likelihood,
    QrsLikelihood,
    beat_noise,
    cosines,
    discrepancy_in_time,
    lead_pattern,
    separable,
)
from fascicle.forward.loss import placed
from fascicle.inference.emulator import Singles
from fascicle.networks.prior_simulations import BEFORE
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network
from fascicle.recording.target import Target


def likelihood_of(target: Target, emulator: EcgEmulator, gain_sd: float) -> QrsLikelihood:
    """Make the likelihood of a target; `gain_sd` is the standard deviation of the gain about 1.

    The residuals of the emulator are scaled by the recorded QRS, whatever the gain.
    """
    rows, modes = independent_rows(target.used), cosines(target.qrs.shape[1])
    size = np.sqrt((target.qrs[rows] ** 2).sum())
    residuals = size * emulator.residual_leads[:, rows, BEFORE - MARGIN :][:, :, : len(modes)]
    coefficients = (residuals @ modes[: residuals.shape[2]]).reshape(len(residuals), -1)
    covariance = beat_noise(target) + coefficients.T @ coefficients
    discrepancy = separable(lead_pattern(residuals), discrepancy_in_time(len(modes)), modes)
    return QrsLikelihood(
        target, covariance, discrepancy, gain_sd, emulator.torso_modes_of_all_leads
    )


@dataclass(frozen=True)
class EmulatedLikelihood:
    """Log-likelihoods of one recording at points of the unit cube, by an emulator."""

    simulator: PointSimulator
    emulator: EcgEmulator
    likelihood: Likelihood

    __repr__ = short_repr

    def __call__(self, points: Floats) -> Floats:
        """Log-likelihoods (n,) of points (n, d)."""
        inputs, gain = self.inputs(points)
        scores: Any = self.emulator.scores(inputs)
        if isinstance(self.likelihood, QrsLikelihood):
            intercept = np.ones((len(scores), 1), scores.dtype)
            factors = gain.astype(scores.dtype)[:, None] * np.concatenate(
                [intercept, scores], axis=1
            )
            log_likelihoods = self.likelihood.of_sums(self._parts, np.ascontiguousarray(factors.T))
        else:
            log_likelihoods = self._one_by_one(scores, gain)
        return np.asarray(log_likelihoods + self.emulator.log_validity(inputs))

    def inputs(self, points: Floats) -> tuple[Singles, Floats]:
        """Standardised inputs (n, p) of the emulator at points (n, d), and gains (n,)."""
        prior = self.simulator.prior
        values = prior.columns(points)
        inputs = self.emulator.inputs(values, self._tissues[prior.tissue(points)])
        return inputs, values.get("gain", np.ones(len(points)))

    def energies(self, networks: Sequence[Network]) -> tuple[float, float]:
        """Energy of the emulator's errors in networks' ECGs, and energy of the ECGs.

        Only frequencies that the emulator covers count; in a normal QRS higher ones make up a
        seventh, root mean square.
        """
        emulator, tissues = self.emulator, self.simulator.prior.averaged.tissues
        rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(emulator.mean_leads))]
        columns = {
            n: np.array([network.parameters[n] for network in networks]) for n in emulator.names
        }
        varied = {name for tissue in tissues for name in tissue}
        network_tissues = [
            {n: v for n, v in network.parameters.items() if n in varied} for network in networks
        ]
        places = [tissues.index(tissue) for tissue in network_tissues]
        scores: Any = emulator.scores(emulator.inputs(columns, self._tissues[places]))
        errors = energy = 0.0
        for network, emulated in zip(networks, emulator.cosines(scores), strict=True):
            signals = network.beat.signals
            begin = signals.first_activation - BEFORE
            leads = placed(signals.leads, begin, emulator.length)[rows]
            true = cosines_of(leads, emulated.shape[-1])
            gain = network.parameters.get("gain", 1.0)
            errors, energy = (
                errors + ((true - gain * emulated) ** 2).sum(),
                energy + (true**2).sum(),
            )
        return float(errors), float(energy)

    @classmethod
    def each(
        cls,
        emulators: Sequence[EcgEmulator],
        simulator: PointSimulator,
        targets: Sequence[Target],
        gain_sd: float,
    ) -> list[EmulatedLikelihood]:
        """Make the likelihoods of several recordings, each with an emulator of its own."""
        return [
            cls(simulator, emulator, likelihood_of(target, emulator, gain_sd))
            for emulator, target in zip(emulators, targets, strict=True)
        ]

    def _one_by_one(self, scores: Floats, gains: Floats) -> Floats:
        """Log-likelihoods (n,) by a user's likelihood, which takes one ECG at a time."""
        emulator, junctions = self.emulator, 10_000  # so many that no likelihood finds them too few
        log_likelihoods = np.empty(len(scores))
        for k, (components, gain) in enumerate(zip(scores, gains, strict=True)):
            leads = emulator.mean_leads + np.tensordot(components, emulator.series, 1)
            signals = Signals(gain * leads, float(BEFORE), (junctions, junctions))
            log_likelihoods[k] = self.likelihood.log_likelihood(signals)
        return log_likelihoods

    @cached_property
    def _parts(self) -> Any:
        """Mean and components of the emulator's ECG as whitened coefficients of the likelihood."""
        assert isinstance(self.likelihood, QrsLikelihood)
        parts = [self.emulator.mean_leads, *self.emulator.series]
        coefficients = np.array([self.likelihood.whitened(leads, float(BEFORE)) for leads in parts])
        return np.ascontiguousarray(coefficients.transpose(3, 1, 2, 0), dtype=np.float32)

    @cached_property
    def _tissues(self) -> Floats:
        ratio = float(np.divide(*self.simulator.model.conduction.speeds))
        return tissue_inputs(self.simulator.prior.averaged, ratio)


def checked(
    checks: Checks, emulated: Sequence[EmulatedLikelihood], networks: Sequence[Network]
) -> Checks:
    """Add the emulators' errors, and the least explained share of the QRS, to checks.

    `emulated` holds the likelihood that belongs to each network.
    """
    errors = energy = expected = 0.0
    for likelihood in {id(candidate): candidate for candidate in emulated}.values():
        pairs = zip(networks, emulated, strict=True)
        of_state = likelihood.energies([n for n, candidate in pairs if candidate is likelihood])
        errors, energy = errors + of_state[0], energy + of_state[1]
        expected += likelihood.emulator.expected_error**2 * of_state[1]
    in_torso = emulated[0].simulator.model.heart.lead_fields is not None
    return replace(
        checks,
        emulator=[float(np.sqrt(errors / energy)), float(np.sqrt(expected / energy))],
        least_explained=LEAST_IN_TORSO if in_torso else LEAST_EXPLAINED,
    )
