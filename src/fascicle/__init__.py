"""Learn a patient's Purkinje network, with its uncertainty, from a heart model and an ECG.

>>> import fascicle
>>> heart = fascicle.load_heart("default")
>>> model = fascicle.ForwardModel(heart)
>>> outcome = model.simulate(fascicle.example_parameters(model))
>>> outcome.ecg.dims
('lead', 'time')
"""

from importlib.metadata import version

import lazy_loader

__version__ = version("fascicle")

# What `__init__.pyi` lists is loaded when first used: the package imports in milliseconds, its
# numerics do not.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
