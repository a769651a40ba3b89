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
    from fascicle.core.errors import InputError as InputError
    from fascicle.core.parameters import EXAMPLE_PARAMETERS as EXAMPLE_PARAMETERS
    from fascicle.core.parameters import NETWORK_SPACE as NETWORK_SPACE
    from fascicle.forward.model import ForwardModel as ForwardModel
    from fascicle.forward.scenario import Scenario as Scenario
    from fascicle.forward.scenario import Slowing as Slowing
    from fascicle.forward.scenario import Stimulus as Stimulus
    from fascicle.forward.simulation import Simulation as Simulation
    from fascicle.heart.conduction import Conduction as Conduction
    from fascicle.heart.conduction import Region as Region
    from fascicle.heart.folder import load_heart as load_heart
    from fascicle.heart.heart import Heart as Heart
    from fascicle.purkinje.growth import GrowthRules as GrowthRules
    from fascicle.purkinje.tree import InvalidTree as InvalidTree
    from fascicle.purkinje.tree import PurkinjeTree as PurkinjeTree
    from fascicle.recording.choices import Choices as Choices
    from fascicle.recording.pipeline import analyse as analyse
    from fascicle.recording.pipeline import make_target as make_target
    from fascicle.recording.readers.read import read_recording as read_recording
    from fascicle.recording.target_files import read_target as read_target
    from fascicle.study.fit import fit as fit
    from fascicle.study.fit import load_study as load_study
    from fascicle.study.settings import FitSettings as FitSettings

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

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'fascicle' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
