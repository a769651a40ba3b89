"""Prior simulations: networks of the prior and their ECGs, from which emulators learn.

Prior simulations depend on no recording. Every network has parameters, tissue, growth and delays
drawn from their priors; every tenth one is held out from the training of emulators, and its ECG is
computed in a random torso, too. For the prior of mapped hearts all networks are simulated, and
those that belong to it are marked. The simulations are kept with the heart, in parts that are
written whole or not at all, so that they may be interrupted at any time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.files import ArrayCache
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS
from fascicle.core.parameters import Infeasible
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.quantities import Changes, quantity, torso_values
from fascicle.forward.activation_sequence import LATE_QRS, MAPPED
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.electrocardiogram import (
    Electrocardiograph,
    build_electrocardiograph,
    electrocardiographs_of,
    unbounded_gradients,
)
from fascicle.forward.loss import placed
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.mesh.measures import barycentric_gradients, solid_centroid, unit
from fascicle.networks.prior import UNMAPPED, Prior, growth_and_conduction
from fascicle.pools.pool import Pool
from fascicle.torso.conductor import SkinMotion, TorsoState, torso_axes
from fascicle.torso.electrode_sites import Electrode
from fascicle.torso.training import lead_fields_in_torsos, torsos_of_the_prior

HELD_OUT = 10  # every tenth network is held out
BEFORE = 40  # samples (ms) of an ECG that are kept before the first activation
Arrays = dict[str, NDArray[Any]]


def random_bodies(
    model: ForwardModel,
    rng: np.random.Generator,
    count: int,
    progress: Progress | None = None,
    cache: ArrayCache | None = None,
) -> list[Electrocardiograph]:
    """ECG integrals of a model's heart in random torsos.

    Their quantities of the torso are drawn from their priors (docs/quantities.md); impossible
    torsos are drawn again. In an unbounded conductor electrodes move as with the skin, and
    conductivities, which scale the whole ECG there, do nothing.

    Parameters
    ----------
    model : ForwardModel
        The heart. If it has a torso or lead fields, those of each torso are solved: seconds each.
    rng : numpy.random.Generator
        Generator of the draws: the same state gives the same torsos.
    count : int
        Number of torsos.
    progress : Progress, optional
        Called with the number of torsos solved.
    cache : ArrayCache, optional
        Where the lead fields in these torsos are kept.
    """
    heart, conduction = model.heart, model.conduction
    mesh = heart.vertices, heart.tetrahedra
    intracellular, scale = conduction.intracellular(heart.fibres), conduction.scale(heart)
    parts = heart.tetrahedra, barycentric_gradients(*mesh), heart.volumes, intracellular
    more = [*heart.additional_electrodes]
    if heart.has_torso:
        key = f"{heart.digest} {conduction} {count} {rng.bit_generator.state}"
        arrays = None if cache is None else cache.read(key)
        if arrays is None:
            solved = lead_fields_in_torsos(heart, conduction, rng, count, progress)
            arrays = {"fields": solved[1:].astype(np.float32)}
            if cache is not None:
                cache.keep(key, arrays, most=1)
        in_torsos = electrocardiographs_of(*parts, arrays["fields"], model.action_potential, more)
    else:
        centroid, electrodes = solid_centroid(*mesh), heart.electrode_positions
        states = torsos_of_the_prior(rng, count)
        moved = [moved_electrodes(electrodes, centroid, state) for state in states]
        gradients = (unbounded_gradients(*mesh, places, conduction.torso) for places in moved)
        in_torsos = [
            build_electrocardiograph(*parts, slopes, model.action_potential, more)
            for slopes in gradients
        ]
    return [electrocardiograph.scaled(scale) for electrocardiograph in in_torsos]


def moved_electrodes(electrodes: Floats, centroid: Floats, state: TorsoState) -> Floats:
    """Positions of moved electrodes (9 + a, 3) about a heart's centroid (mm), without a torso.

    V1 to V6 move to the left and up at right angles to the line from the centroid, then all
    electrodes by `SkinMotion`.
    """
    motion = SkinMotion.of(centroid, torso_axes(electrodes), state)
    chest = slice(Electrode.V1, Electrode.V6 + 1)
    outwards = unit(electrodes[chest] - centroid)
    upwards = torso_axes(electrodes)[2]
    up = unit(upwards - (outwards @ upwards)[:, None] * outwards)
    left, lifted = (state.chest / motion.size).T
    placed = electrodes.copy()
    placed[chest] += left[:, None] * np.cross(up, outwards) + lifted[:, None] * up
    return motion(placed)


@dataclass(frozen=True)
class Examples:
    """Prior simulations as arrays: points, which of them are feasible, and ECGs.

    Attributes
    ----------
    points : (n, d) array
        Points of the unit cube.
    feasible, kept : (n,) arrays
        Whether a point gives a network, and whether that network belongs to the prior.
    ecgs : (m, 8 + k, length) array
        Independent leads (mV) of the feasible networks; `BEFORE` samples precede activation.
    in_torsos, torsos : (h, 8 + k, length) and (h,) arrays
        Independent leads (mV) of the feasible held-out networks in a random torso, and the
        torso's number.
    """

    points: Floats
    feasible: Booleans
    kept: Booleans
    ecgs: NDArray[np.float32]
    in_torsos: NDArray[np.float32]
    torsos: Integers

    @property
    def held_out(self) -> Booleans:
        """Whether a point (n,) is held out from training."""
        return np.asarray(np.arange(len(self.points)) % HELD_OUT == HELD_OUT - 1)

    def lasting(self, length: int) -> Examples:
        """Examples whose ECGs have more samples, which are zero."""
        more = [(0, 0), (0, 0), (0, length - self.ecgs.shape[2])]
        return replace(self, ecgs=np.pad(self.ecgs, more), in_torsos=np.pad(self.in_torsos, more))

    @property
    def of_the_prior(self) -> Examples:
        """Examples in which only networks that belong to the prior count as feasible."""
        kept = self.kept[self.feasible]
        held_out = self.kept[self.feasible & self.held_out]
        return replace(
            self,
            feasible=self.kept,
            ecgs=self.ecgs[kept],
            in_torsos=self.in_torsos[held_out],
            torsos=self.torsos[held_out],
        )


@dataclass(frozen=True)
class PriorSimulations:
    """Simulations of one forward model, prior and scenario, as far as they have been made."""

    model: ForwardModel
    prior: Prior
    cache: ArrayCache  # in the heart's folder
    scenario: Scenario | None = None  # None: the intrinsic beat
    drawn: Floats | None = None  # points drawn from a posterior, in place of the prior

    part_size: ClassVar[int] = 500  # networks in a file
    torsos: ClassVar[int] = 24  # random torsos, drawn once for all networks
    seed: ClassVar[int] = 20240  # fixed, so that all studies have the same networks

    @cached_property
    def content(self) -> str:
        """Text that identifies all that the simulations depend on."""
        constants = growth_and_conduction(self.model.heart, self.model.rules)
        prior = self.prior
        varied = prior.learnt.parameters, prior.averaged, sorted(prior.fixed.items())
        scenario = "" if self.scenario is None else repr(self.scenario)
        drawn = "" if self.drawn is None else hashlib.sha256(self.drawn.tobytes()).hexdigest()
        mapped = f" {MAPPED} {UNMAPPED}" if prior.mapped else ""
        mapped += f" {LATE_QRS}" if prior.mapped and prior.averaged.weights else ""
        return (
            f"{self.model.heart.digest} {varied} {sorted(constants.items())} "
            f"{scenario}{drawn}{mapped}"
        )

    def _file(self, number: int) -> Path:
        return self.cache.file(f"{self.content} {number}")

    def points(self, number: int) -> Floats:
        """Points (`part_size`, d) of the unit cube for the networks of a part.

        Quantities that change the conduction velocities of the tissue have one value in a part,
        since the preparation of a tissue takes seconds.
        """
        if self.drawn is not None:
            return self.drawn[number * self.part_size : (number + 1) * self.part_size]
        points = self.prior.sample(np.random.default_rng([self.seed, number]), self.part_size)
        for k, name in enumerate(self.prior.names):
            if quantity(name).changes is Changes.TISSUE:
                points[:, k] = points[0, k]
        return points

    def parameters(self, number: int) -> list[dict[str, float]]:
        """Quantities of each network of a part, by name."""
        networks = [self.prior.from_unit(point) for point in self.points(number)]
        for network in networks:
            network.pop("gain", None)  # a factor on the ECG
        return networks

    def scenarios(self, number: int) -> Sequence[Scenario | None]:
        """Scenario of each network of a part."""
        return [self.scenario] * len(self.points(number))

    def simulate(
        self, count: int, pool: Pool, progress: Progress | None = None, message: str = ""
    ) -> None:
        """Simulate at least `count` networks, as far as they are missing.

        `message` describes them in the progress callback.
        """
        end = -(-count // self.part_size)
        missing = [number for number in range(end) if not self._file(number).is_file()]
        if not missing:
            return
        if self.model.heart.atlas is not None:
            raise InputError(
                f"{self.model.heart.name}: it comes with simulations of intrinsic beats in all "
                "leads with the usual priors, and no others can be made; free or fix less, give a "
                "recording of all leads, or a heart of your own"
            )
        kind, total = (
            ("prior", end * self.part_size)
            if self.drawn is None
            else ("posterior", len(self.drawn))
        )
        report, torsos = stage_progress(progress, f"{kind} simulations", message), []
        # no random torsos if quantities of the torso are learnt, or for draws from a posterior
        if self.drawn is None and not torso_values(dict.fromkeys(self.prior.names, np.nan)):
            rng = np.random.default_rng([self.seed, 0, 2])  # 2: random numbers of the torsos
            in_cache = ArrayCache(self.cache.folder, "torsos")
            torsos = random_bodies(self.model, rng, self.torsos, progress, in_cache)
        rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(self.model.heart.leads))]
        for number in missing:
            items = [*zip(self.parameters(number), self.scenarios(number), strict=True)]
            rng = np.random.default_rng([self.seed, number, 3])  # 3: numbers of a part's choices
            torso_numbers = rng.integers(self.torsos, size=len(items))
            ecgs: list[Floats] = []
            held_out_ecgs: list[Floats] = []
            feasible, kept = np.zeros((2, len(items)), bool)
            points = self.points(number)
            for k, beat in enumerate(pool.map(_beat, items, self.model)):
                report(number * self.part_size + k + 1, total)
                if beat is None:
                    continue
                feasible[k] = True
                kept[k] = self.prior.keeps(points[k], self.model.surfaces, beat)
                ecgs.append(_from_activation(beat.leads[rows], beat))
                if k % HELD_OUT == HELD_OUT - 1:
                    leads = beat.leads
                    if torsos:
                        torso = self.model.with_sources(torsos[torso_numbers[k]], items[k][0])
                        leads = torso.leads(beat.activation)
                    held_out_ecgs.append(_from_activation(leads[rows], beat))
            self.cache.write(
                f"{self.content} {number}",
                {"feasible": feasible, "kept": kept, "bodies": torso_numbers,
                 **_joined("ecg", ecgs, len(rows)), **_joined("body", held_out_ecgs, len(rows))},
                compress=True,
            )  # fmt: skip

    def simulate_enough(
        self, count: int, pool: Pool, progress: Progress | None = None, message: str = ""
    ) -> int:
        """Simulate `count` networks, and more while fewer than a third of `count` are of the prior.

        Returns how many are simulated: eight times `count` at most. Arguments as of `simulate`.
        """
        number = count
        while True:
            self.simulate(number, pool, progress, message)
            if number >= 8 * count or 3 * self.examples(number).kept.sum() >= count:
                return number
            number += self.part_size

    def examples(self, count: int, length: int | None = None) -> Examples:
        """Read at least `count` networks, which must have been simulated.

        ECGs have `length` samples, by default as many as the longest.
        """
        parts = []
        for number in range(-(-count // self.part_size)):
            part = self.cache.read(f"{self.content} {number}")
            if part is None:
                raise InputError(
                    f"{self._file(number)}: damaged; delete it, and the same command makes it again"
                )
            parts.append(part)
        held_out = slice(HELD_OUT - 1, None, HELD_OUT)
        if length is None:
            length = max(int(np.diff(part["ecg_ends"], prepend=0).max(initial=1)) for part in parts)
        return Examples(
            np.concatenate([self.points(number) for number in range(len(parts))]),
            np.concatenate([part["feasible"] for part in parts]),
            np.concatenate([part["kept"] for part in parts]),
            np.concatenate([_separated("ecg", part, length) for part in parts]),
            np.concatenate([_separated("body", part, length) for part in parts]),
            np.concatenate(
                [part["bodies"][held_out][part["feasible"][held_out]] for part in parts]
            ),
        )


def _beat(item: tuple[Mapping[str, float], Scenario | None], model: ForwardModel) -> Beat | None:
    """Simulate a network, and return its beat without the trees; None if it is infeasible."""
    beat = model.simulate(*item)
    if isinstance(beat, Infeasible):
        return None
    return replace(beat, trees=(), coupled=Activation(beat.activation))


def _from_activation(leads: Floats, beat: Beat) -> Floats:
    """Leads (n_leads, n) from `BEFORE` samples before the first activation to their end."""
    begin = beat.first_activation - BEFORE
    return placed(leads, begin, int(np.ceil(leads.shape[1] - begin)) + BEFORE)


def _joined(name: str, ecgs: list[Floats], rows: int) -> Arrays:
    """ECGs of any lengths, joined one after the other, and the end of each."""
    joined = np.concatenate([np.empty((rows, 0)), *ecgs], axis=1)
    ends = np.cumsum([ecg.shape[1] for ecg in ecgs], dtype=int)
    return {name: joined.astype(np.float32), f"{name}_ends": ends}


def _separated(name: str, part: Arrays, length: int) -> NDArray[np.float32]:
    """ECGs (n, n_leads, length) of a part, zero after their ends."""
    ends, joined = part[f"{name}_ends"], part[name]
    ecgs = np.zeros((len(ends), len(joined), length), np.float32)
    for ecg, begin, end in zip(ecgs, np.concatenate([[0], ends])[:-1], ends, strict=True):
        ecg[:, : min(end - begin, length)] = joined[:, begin : min(end, begin + length)]
    return ecgs
