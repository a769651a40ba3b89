"""Learn a patient's Purkinje network, with its uncertainty, from a heart model and an ECG.

>>> import fascicle
>>> heart = fascicle.load_heart("default")
>>> model = fascicle.ForwardModel(heart)
>>> outcome = model.simulate(fascicle.EXAMPLE_PARAMETERS)
>>> outcome.ecg.dims
('lead', 'time')
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fascicle.eikonal.scenario import Scenario, Slowing, Stimulus
    from fascicle.errors import InputError
    from fascicle.fitting import fit, load_study
    from fascicle.forward import ForwardModel, Simulation
    from fascicle.geometry.conduction import Conduction, Region
    from fascicle.geometry.heart import Heart
    from fascicle.io.hearts import load_heart
    from fascicle.io.recordings import read_recording
    from fascicle.io.targets import read_target
    from fascicle.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
    from fascicle.recording.choices import Choices
    from fascicle.recording.making import analyse, make_target
    from fascicle.tree.grow import GrowthRules
    from fascicle.tree.purkinje import InvalidTree, PurkinjeTree

__version__ = version("fascicle")

# Loaded when first used: the package imports in milliseconds, its numerics do not.
_HOMES = {
    "Choices": "fascicle.recording.choices",
    "Conduction": "fascicle.geometry.conduction",
    "EXAMPLE_PARAMETERS": "fascicle.parameters",
    "ForwardModel": "fascicle.forward",
    "GrowthRules": "fascicle.tree.grow",
    "Heart": "fascicle.geometry.heart",
    "InputError": "fascicle.errors",
    "InvalidTree": "fascicle.tree.purkinje",
    "NETWORK_SPACE": "fascicle.parameters",
    "PurkinjeTree": "fascicle.tree.purkinje",
    "Simulation": "fascicle.forward",
    "Region": "fascicle.geometry.conduction",
    "Scenario": "fascicle.eikonal.scenario",
    "Slowing": "fascicle.eikonal.scenario",
    "Stimulus": "fascicle.eikonal.scenario",
    "analyse": "fascicle.recording.making",
    "fit": "fascicle.fitting",
    "load_heart": "fascicle.io.hearts",
    "load_study": "fascicle.fitting",
    "make_target": "fascicle.recording.making",
    "read_recording": "fascicle.io.recordings",
    "read_target": "fascicle.io.targets",
}

__all__ = [
    "EXAMPLE_PARAMETERS",
    "NETWORK_SPACE",
    "Choices",
    "Conduction",
    "ForwardModel",
    "GrowthRules",
    "Heart",
    "InputError",
    "InvalidTree",
    "PurkinjeTree",
    "Region",
    "Scenario",
    "Simulation",
    "Slowing",
    "Stimulus",
    "analyse",
    "fit",
    "load_heart",
    "load_study",
    "make_target",
    "read_recording",
    "read_target",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'fascicle' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
