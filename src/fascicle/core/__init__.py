"""Foundations of all packages: leads, units, parameters, errors, files and progress."""

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

DISTRIBUTION = "fascicle-ecg"  # name of the package on an index
VERSION = version(DISTRIBUTION)

# Returns a module of a layer above, for the methods by which objects draw and write themselves:
# imports may not lead upwards. `fascicle/__init__.py`, which stands above all layers and runs
# before any other module, sets it. The module is loaded when the method is called.
above: Callable[[str], Any] = NotImplemented


def html_card(self: object) -> str:
    """Serve as the ``_repr_html_`` of a class, by which notebooks show an object."""
    return str(above("reporting.card").card(self))
