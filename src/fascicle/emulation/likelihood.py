"""Likelihood of a study's target by an emulator of the heart, and sampling of the posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS, independent_rows
from fascicle.core.progress import Progress
from fascicle.core.ranges import short_repr
from fascicle.emulation.ecg_emulator import EcgEmulator, cosines_of, tissue_inputs
from fascicle.emulation.predictive import Checks
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
from fascicle.inference.tempered_sampling import SamplingRun, State, temper
from fascicle.networks.prior_simulations import BEFORE
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network
from fascicle.recording.target import Target

# Factor on the discrepancy of an atlas, since no person's heart is among its hearts. Chosen on
# recordings simulated on `default` and `camps-dti004` (docs/atlas.md).
ATLAS_DISCREPANCY = 3.0
RUNS = 2  # independent runs, whose difference shows whether they have converged

Emulated = Callable[[Floats], Floats]  # log-likelihoods (n,) of a recording at points (n, d)


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
    factor = ATLAS_DISCREPANCY if len(emulator.hearts) else 1.0
    modes_of_torsos = emulator.torso_modes_of_all_leads
    return QrsLikelihood(target, covariance, discrepancy, gain_sd, modes_of_torsos, factor)


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

        Only frequencies that the emulator covers count. In a normal QRS, higher ones amount to a
        seventh (root mean square).
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
            errors += ((true - gain * emulated) ** 2).sum()
            energy += (true**2).sum()
        return float(errors), float(energy)

    def _one_by_one(self, scores: Floats, gains: Floats) -> Floats:
        """Log-likelihoods (n,) by a user's likelihood, which takes one ECG at a time."""
        emulator, junctions = self.emulator, 10_000  # enough for any likelihood
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
        if len(self.emulator.hearts):
            return self.emulator.hearts
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
        energies = likelihood.energies([n for n, candidate in pairs if candidate is likelihood])
        errors, energy = errors + energies[0], energy + energies[1]
        expected += likelihood.emulator.expected_error**2 * energies[1]
    if emulated[0].simulator.model.heart.lead_fields is not None:
        checks = replace(checks, least_explained=0.75)  # a torso is not quite the patient's
    emulator = [float(np.sqrt(errors / energy)), float(np.sqrt(expected / energy))]
    return replace(checks, emulator=emulator)


def of_all(emulated: Sequence[Emulated], points: Floats) -> Floats:
    """Log-likelihoods (n,) of all recordings together at points (n, d)."""
    return np.asarray(np.sum([log_likelihoods(points) for log_likelihoods in emulated], axis=0))


def sampled(
    emulated: Sequence[Emulated],
    dimension: int,
    rngs: Sequence[np.random.Generator],
    count: int,
    message: str,
    progress: Progress | None,
) -> list[SamplingRun]:
    """Sample the posterior of recordings by runs of `count` particles, one with each generator."""
    first, edges = emulated[0], None
    if isinstance(first, EmulatedLikelihood) and len(first.simulator.prior.averaged.tissues) > 1:
        edges = first.simulator.prior.averaged.edges
    states: dict[int, State] = {}

    def run(number: int, rng: np.random.Generator) -> SamplingRun:
        def report(state: State) -> None:
            states[number] = state
            if progress is None or len(states) < len(rngs):
                return
            evidences = " and ".join(f"{states[k].log_evidence:.1f}" for k in range(len(rngs)))
            # the logarithm of the temperature rises about evenly in time
            coldest = min(state.temperature for state in states.values())
            done = round(100 * (1 + np.log10(max(coldest, 1e-3)) / 3))
            progress("sampling", max(1, done), 100, f"{message}, log evidence {evidences}")

        try:
            sample: SamplingRun = temper(
                partial(of_all, emulated), dimension, rng, count, report, edges
            )
        except ValueError as error:  # hardly any point has a likelihood, as by a user's own
            raise InputError(f"{error}, and the likelihood") from None
        return sample

    with ThreadPoolExecutor(len(rngs)) as pool:
        return list(pool.map(run, range(len(rngs)), rngs))
