"""Prior against posterior of each parameter: what the ECG took away."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.names import parameter_name, with_unit

COLUMNS, PANEL = 4, (2.1, 1.35)  # panels in a row; inch
BINS = 24
SHARES = np.linspace(0.005, 0.995, 200)  # of a prior, for its curve


def prior_figure(space: ParameterSpace, values: Mapping[str, Floats]) -> Figure:
    """Histograms of networks over the priors, on the whole ranges.

    Parameters
    ----------
    space : ParameterSpace
        Priors and units.
    values : mapping of name to (n,) array
        Of the networks.
    """
    count = len(space.parameters)
    rows = -(-count // COLUMNS)
    figure = new_figure(COLUMNS * PANEL[0], rows * PANEL[1])
    panels = figure.subplots(rows, COLUMNS, squeeze=False)
    for panel, parameter in zip(panels.flat, space.parameters, strict=False):
        ends = parameter.from_unit(np.array([SHARES[0], SHARES[-1]]))
        edges = np.linspace(ends[0], ends[1], BINS + 1)
        inside = np.clip(values[parameter.name], *ends)  # what lies at an end is shown there
        panel.hist(inside, edges, density=True, color=style.VERMILION, alpha=0.6)
        at = parameter.from_unit(SHARES)
        panel.plot(at, np.gradient(SHARES, at), color=style.GREY, linewidth=style.THICK_LINE)
        style.finish_axes(panel, x=with_unit(parameter_name(parameter.name), parameter.unit))
        panel.set_yticks([])
    for panel in panels.flat[count:]:
        panel.set_axis_off()
    return figure
