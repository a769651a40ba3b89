"""Learn a patient's Purkinje network, with its uncertainty, from a heart model and an ECG.

>>> import fascicle
>>> heart = fascicle.load_heart("default")
>>> model = fascicle.ForwardModel(heart)
>>> outcome = model.simulate(fascicle.example_parameters(model))
>>> outcome.ecg.dims
('lead', 'time')
"""

from importlib import import_module

import lazy_loader

from fascicle import core

__version__ = core.VERSION

# What `__init__.pyi` lists is loaded when first used: the package imports in milliseconds, its
# numerics do not.
core.above = lambda module: import_module(f"fascicle.{module}")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
