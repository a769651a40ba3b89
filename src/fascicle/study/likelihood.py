"""The likelihood of a study's target, with what an emulator of the heart does not say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS, independent_rows
from fascicle.core.ranges import short_repr
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
from fascicle.forward.simulation import Signals
from fascicle.inference.emulator import Singles
from fascicle.recording.target import Target
from fascicle.study.ecg_emulator import EcgEmulator, cosines_of, tissue_inputs
from fascicle.study.predictive import LEAST_EXPLAINED, LEAST_IN_TORSO, Checks
from fascicle.study.prior_simulations import BEFORE
from fascicle.study.simulator import PointSimulator
from fascicle.study.target_comparison import Network


def likelihood_of(target: Target, emulator: EcgEmulator, gain_sd: float) -> QrsLikelihood:
    """Make the likelihood of a target; `gain_sd` is the standard deviation of the gain about 1.

    What the emulator does not say is in proportion to the recorded QRS, whatever the gain.
    """
    rows, modes = independent_rows(target.used), cosines(target.qrs.shape[1])
    size = np.sqrt((target.qrs[rows] ** 2).sum())
    left = size * emulator.left_leads[:, rows, BEFORE - MARGIN :][:, :, : len(modes)]
    seen = (left @ modes[: left.shape[2]]).reshape(len(left), -1)
    known = beat_noise(target) + seen.T @ seen
    outside = separable(lead_pattern(left), discrepancy_in_time(len(modes)), modes)
    return QrsLikelihood(target, known, outside, gain_sd, emulator.bodies_of_all_leads)


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
            ones = np.ones((len(scores), 1), scores.dtype)
            factors = gain.astype(scores.dtype)[:, None] * np.concatenate([ones, scores], axis=1)
            found = self.likelihood.of_sums(self._parts, np.ascontiguousarray(factors.T))
        else:
            found = self._one_by_one(scores, gain)
        return np.asarray(found + self.emulator.log_validity(inputs))

    def inputs(self, points: Floats) -> tuple[Singles, Floats]:
        """Inputs (n, p) of the emulator at points, and gains (n,)."""
        simulator = self.simulator
        learnt, rest = np.split(points, [len(simulator.space)], axis=1)
        values: dict[str, Floats] = {n: np.full(len(points), v) for n, v in simulator.fixed.items()}
        values |= simulator.space.columns(learnt) | simulator.averaged.columns(rest)
        inputs = self.emulator.inputs(values, self._tissues[simulator.averaged.tissue(rest)])
        return inputs, values.get("gain", np.ones(len(points)))

    def energies(self, networks: Sequence[Network]) -> tuple[float, float]:
        """Energy of what is emulated falsely of networks' ECGs, and that of the ECGs.

        Of the frequencies that are emulated: of a normal QRS a seventh, root mean square, is above.
        """
        emulator, tissues = self.emulator, self.simulator.averaged.tissues
        rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(emulator.mean_leads))]
        columns = {n: np.array([each.parameters[n] for each in networks]) for n in emulator.names}
        varied = {name for tissue in tissues for name in tissue}
        own = [{n: v for n, v in each.parameters.items() if n in varied} for each in networks]
        places = [tissues.index(tissue) for tissue in own]
        scores: Any = emulator.scores(emulator.inputs(columns, self._tissues[places]))
        off = whole = 0.0
        for network, emulated in zip(networks, emulator.cosines(scores), strict=True):
            signals = Signals.of(network.simulation)
            begin = signals.first_activation - BEFORE
            leads = placed(signals.leads, begin, emulator.length)[rows]
            true = cosines_of(leads, emulated.shape[-1])
            gain = network.parameters.get("gain", 1.0)
            off, whole = off + ((true - gain * emulated) ** 2).sum(), whole + (true**2).sum()
        return float(off), float(whole)

    @classmethod
    def each(
        cls,
        emulators: Sequence[EcgEmulator],
        simulator: PointSimulator,
        targets: Sequence[Target],
        gain_sd: float,
    ) -> list[EmulatedLikelihood]:
        """Those of recordings, by an emulator of each."""
        return [
            cls(simulator, emulator, likelihood_of(target, emulator, gain_sd))
            for emulator, target in zip(emulators, targets, strict=True)
        ]

    def _one_by_one(self, scores: Floats, gains: Floats) -> Floats:
        """By a likelihood that takes one simulation at a time."""
        emulator, most = self.emulator, 10_000  # junctions, of which there are enough
        found = np.empty(len(scores))
        for k, (each, gain) in enumerate(zip(scores, gains, strict=True)):
            leads = emulator.mean_leads + np.tensordot(each, emulator.series, 1)
            signals = Signals(gain * leads, float(BEFORE), (most, most))
            found[k] = self.likelihood.log_likelihood(signals)
        return found

    @cached_property
    def _parts(self) -> Any:
        """Mean and components of the emulator as the likelihood sees them."""
        assert isinstance(self.likelihood, QrsLikelihood)
        both = [self.emulator.mean_leads, *self.emulator.series]
        seen = np.array([self.likelihood.whitened(leads, float(BEFORE)) for leads in both])
        return np.ascontiguousarray(seen.transpose(3, 1, 2, 0), dtype=np.float32)

    @cached_property
    def _tissues(self) -> Floats:
        ratio = float(np.divide(*self.simulator.model.conduction.speeds))
        return tissue_inputs(self.simulator.averaged, ratio)


def checked(
    checks: Checks, emulated: Sequence[EmulatedLikelihood], networks: Sequence[Network]
) -> Checks:
    """Add to checks how far the emulators are off, and what must be explained.

    `emulated` are of each network.
    """
    off = whole = expected = 0.0
    for each in {id(one): one for one in emulated}.values():
        its = [n for n, one in zip(networks, emulated, strict=True) if one is each]
        false, energy = each.energies(its)
        off, whole = off + false, whole + energy
        expected += each.emulator.expected_error**2 * energy
    in_torso = emulated[0].simulator.model.heart.lead_fields is not None
    return replace(
        checks,
        emulator=[float(np.sqrt(off / whole)), float(np.sqrt(expected / whole))],
        least_explained=LEAST_IN_TORSO if in_torso else LEAST_EXPLAINED,
    )
