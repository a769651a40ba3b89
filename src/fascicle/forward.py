"""From parameters to the ECG: the stages, chained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fascicle.ecg.action_potential import ActionPotential, Upstroke
from fascicle.ecg.electrocardiogram import STEP, build_electrocardiograph, first_sample
from fascicle.ecg.lead_field import unbounded_gradients
from fascicle.eikonal.activation import Activation, default_ball_radius, solve
from fascicle.eikonal.tissue import build_tissue
from fascicle.errors import InputError
from fascicle.geometry.conduction import Conduction
from fascicle.geometry.heart import Heart
from fascicle.harmonic.chart import build_chart
from fascicle.leads import LEADS
from fascicle.parameters import NETWORK_SPACE, check_names
from fascicle.recording.window import qrs_window
from fascicle.tree.grow import GrowthRules, find_seed, grow_from_parameters
from fascicle.tree.purkinje import InvalidTree, PurkinjeTree


@dataclass(frozen=True)
class Simulation:
    """What one run of the forward model gives.

    Attributes
    ----------
    ecg : xarray.DataArray
        Twelve leads (mV), dimensions ``lead`` and ``time`` (ms).
    activation : (n,) array
        Activation time of each vertex of the heart (ms).
    trees : tuple of PurkinjeTree
        The trees, left first.
    coupled : Activation
        Times in the trees and how each junction fired.
    """

    ecg: xr.DataArray
    activation: NDArray[np.float64]
    trees: tuple[PurkinjeTree, ...]
    coupled: Activation

    @property
    def total_activation_time(self) -> float:
        """From the first to the last activation in the myocardium (ms)."""
        return float(self.activation.max() - self.activation.min())

    @property
    def qrs_duration(self) -> float:
        """QRS duration (ms), found in the ECG by the rule that finds it in recordings."""
        onset, offset = qrs_window(self.ecg.to_numpy(), STEP)
        return (offset - onset) * STEP


class ForwardModel:
    """The forward model of one heart; construction does all that depends on the heart alone.

    Parameters
    ----------
    heart : Heart
        The heart.
    conduction : Conduction, optional
        Conductivities and speeds of the myocardium.
    rules : GrowthRules, optional
        What is held fixed while trees grow.
    action_potential : ActionPotential, optional
        The template U.

    Examples
    --------
    >>> import fascicle
    >>> model = fascicle.ForwardModel(fascicle.load_heart("default"))
    >>> simulation = model.simulate(fascicle.EXAMPLE_PARAMETERS)
    >>> simulation.ecg.sel(lead="V1").max().item()  # doctest: +SKIP
    """

    def __init__(
        self,
        heart: Heart,
        conduction: Conduction | None = None,
        rules: GrowthRules | None = None,
        action_potential: ActionPotential | None = None,
    ) -> None:
        self.heart = heart
        self.conduction = conduction if conduction is not None else Conduction()
        self.rules = rules if rules is not None else GrowthRules()
        self.charts = {e.side: build_chart(e) for e in heart.endocardia}
        self.seeds = {e.side: find_seed(e, self.charts[e.side]) for e in heart.endocardia}
        self.tissue = build_tissue(heart, self.conduction)
        self.electrocardiograph = build_electrocardiograph(
            self.tissue.corners,
            self.tissue.gradients,
            heart.volumes,
            self.conduction.intracellular(heart.fibres),
            unbounded_gradients(
                heart.vertices, self.tissue.corners, heart.electrodes, self.conduction.torso
            ),
            action_potential if action_potential is not None else Upstroke(),
        )

    def grow(self, parameters: Mapping[str, float]) -> tuple[PurkinjeTree, ...] | InvalidTree:
        """Grow both trees, left first, or say which one does not fit."""
        trees = []
        for side, chart in self.charts.items():
            tree = grow_from_parameters(side, chart, self.seeds[side], parameters, self.rules)
            if isinstance(tree, InvalidTree):
                return tree
            trees.append(tree)
        return tuple(trees)

    def simulate(self, parameters: Mapping[str, float]) -> Simulation | InvalidTree:
        """Grow the trees, activate the heart, compute the ECG.

        Parameters
        ----------
        parameters : mapping of name to float
            The twelve parameters of `fascicle.parameters.NETWORK_SPACE`, in its units.

        Returns
        -------
        Simulation or InvalidTree
            `InvalidTree` where a bundle or fascicle would leave its endocardium.

        Raises
        ------
        InputError
            If a parameter is unknown, missing or not finite, or a length or speed not positive.
        """
        check_names(parameters, NETWORK_SPACE.names)
        for name, value in parameters.items():
            if (name == "cv" or "_length" in name) and value <= 0:
                raise InputError(f"parameter '{name}' is {value}; it must be positive")
        trees = self.grow(parameters)
        if isinstance(trees, InvalidTree):
            return trees
        return self.activate(trees, parameters["root_time"], parameters["cv"])

    def activate(self, trees: Sequence[PurkinjeTree], root_time: float, cv: float) -> Simulation:
        """Activate the heart through given trees and compute the ECG.

        Parameters
        ----------
        trees : sequence of two PurkinjeTree
            Left, right.
        root_time : float
            t_RV − t_LV (ms); the earlier root fires at time 0.
        cv : float
            Speed in the trees (mm/ms).
        """
        roots = (max(0.0, -root_time), max(0.0, root_time))
        radius = default_ball_radius(self.heart.edge_length)
        coupled = solve(self.tissue, trees, roots, cv, ball_radius=radius)
        values = self.electrocardiograph.leads(coupled.myocardium)
        time = first_sample(coupled.myocardium) + np.arange(values.shape[1]) * STEP
        ecg = xr.DataArray(
            values,
            coords={"lead": list(LEADS), "time": time},
            dims=("lead", "time"),
            name="ecg",
            attrs={"units": "mV"},
        )
        ecg["time"].attrs["units"] = "ms"
        return Simulation(ecg, coupled.myocardium, tuple(trees), coupled)
