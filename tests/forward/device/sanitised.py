"""Runs networks on the emulated card in a process of its own, where a sanitiser watches.

    python sanitised.py MODEL.npz NETWORKS.npz OPTION...

The first two are written by `test_races`; the rest compiles the kernels.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from emulated import RANDOM, Emulated

from fascicle.forward.cable.template import default_template
from fascicle.forward.device.model import DeviceModel
from fascicle.forward.preparation import load
from fascicle.heart.conduction import Conduction
from fascicle.purkinje.growth import GrowthRules

if __name__ == "__main__":
    model, written, *options = sys.argv[1:]
    heart, prepared = load(Path(model), default_template())
    with np.load(written) as file:
        names, values, expected = file["names"], file["values"], file["activation"]
    device = DeviceModel(
        Emulated(*options, order=RANDOM), prepared, prepared.electrocardiograph,
        Conduction.of(heart), GrowthRules(), len(values),
    )  # fmt: skip
    networks = [dict(zip(names.tolist(), row, strict=True)) for row in values]
    found = [beat.activation for beat in device.beats(networks)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)
