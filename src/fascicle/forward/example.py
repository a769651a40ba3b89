"""The example network, scaled to any heart."""

from __future__ import annotations

import math

from fascicle.core.errors import InputError
from fascicle.core.parameters import Infeasible
from fascicle.core.ranges import check_kind
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart
from fascicle.purkinje.tree import FEW_JUNCTIONS


def example_parameters(model: ForwardModel) -> dict[str, float]:
    """Parameters of a network with a plausible ECG, that grows on the heart of a model.

    A heart may have its own (`fascicle.Heart.example`), such as the packaged ones, which activate
    the ventricles in the sequence of mapped human hearts. On others it is the network of
    ``camps-dti004``, with lengths times the root of the endocardium's area over that of
    ``camps-dti004``; what then leaves the endocardium is shortened, and so is a bundle whose tree
    has few junctions: below 50, or fewer on an endocardium of less than half the area, which has
    less room. Where no length gives as many, it is the network with the most.

    Raises
    ------
    InputError
        If no network fits.

    Examples
    --------
    >>> import fascicle
    >>> model = fascicle.ForwardModel(fascicle.load_heart("default"))
    >>> fascicle.example_parameters(model)["interventricular_delay"]
    4.2
    """
    check_kind(model, ForwardModel, "model", "a fascicle.ForwardModel")
    if model.heart.example:
        return dict(model.heart.example)
    # its network is of human anatomy, and its ECG is normal
    subject = load_heart("camps-dti004")
    parameters, few = dict(subject.example), {}
    for endocardium, of_subject in zip(model.heart.endocardia, subject.endocardia, strict=True):
        side, share = endocardium.side, endocardium.area / of_subject.area
        factor, few[side] = round(math.sqrt(share), 2), FEW_JUNCTIONS * min(1.0, 2 * share)
        for name in parameters:
            if name.startswith(f"{side}_") and "length" in name:
                parameters[name] *= factor
    best, most = dict(parameters), 0
    shorter = 0.9  # share of the length that fits
    for _ in range(40):
        grown = model.grow(parameters)
        if isinstance(grown, Infeasible):
            parameters[grown.quantity] = max(shorter * grown.most, 0.1)  # mm
            continue
        junctions = {tree.side: len(tree.junctions) for tree in grown}
        if min(junctions.values()) > most:
            best, most = dict(parameters), min(junctions.values())
        sparse = [side for side, count in junctions.items() if count < few[side]]
        if not sparse:
            return parameters
        for side in sparse:  # tree that ends close to the base, with no room for branches
            parameters[f"{side}_initial_length"] *= shorter
    if most:
        return best
    raise InputError(
        f"{model.heart.name}: no example network was found that fits; choose other roots and "
        "directions for the bundles, or give parameters"
    )
