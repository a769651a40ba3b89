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
    from fascicle.core.errors import InputError
    from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
    from fascicle.forward.model import ForwardModel
    from fascicle.forward.scenario import Scenario, Slowing, Stimulus
    from fascicle.forward.simulation import Simulation
    from fascicle.heart.conduction import Conduction, Region
    from fascicle.heart.folder import load_heart
    from fascicle.heart.heart import Heart
    from fascicle.purkinje.growth import GrowthRules
    from fascicle.purkinje.tree import InvalidTree, PurkinjeTree
    from fascicle.recording.choices import Choices
    from fascicle.recording.pipeline import analyse, make_target
    from fascicle.recording.readers.read import read_recording
    from fascicle.recording.target_files import read_target
    from fascicle.study.fit import fit, load_study
    from fascicle.study.settings import FitSettings

__version__ = version("fascicle")

# Loaded when first used: the package imports in milliseconds, its numerics do not.
_HOMES = {
    "Choices": "fascicle.recording.choices",
    "Conduction": "fascicle.heart.conduction",
    "EXAMPLE_PARAMETERS": "fascicle.core.parameters",
    "FitSettings": "fascicle.study.settings",
    "ForwardModel": "fascicle.forward.model",
    "GrowthRules": "fascicle.purkinje.growth",
    "Heart": "fascicle.heart.heart",
    "InputError": "fascicle.core.errors",
    "InvalidTree": "fascicle.purkinje.tree",
    "NETWORK_SPACE": "fascicle.core.parameters",
    "PurkinjeTree": "fascicle.purkinje.tree",
    "Simulation": "fascicle.forward.simulation",
    "Region": "fascicle.heart.conduction",
    "Scenario": "fascicle.forward.scenario",
    "Slowing": "fascicle.forward.scenario",
    "Stimulus": "fascicle.forward.scenario",
    "analyse": "fascicle.recording.pipeline",
    "fit": "fascicle.study.fit",
    "load_heart": "fascicle.heart.folder",
    "load_study": "fascicle.study.fit",
    "make_target": "fascicle.recording.pipeline",
    "read_recording": "fascicle.recording.readers.read",
    "read_target": "fascicle.recording.target_files",
}

__all__ = [
    "EXAMPLE_PARAMETERS",
    "NETWORK_SPACE",
    "Choices",
    "Conduction",
    "FitSettings",
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
