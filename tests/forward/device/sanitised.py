"""Runs networks on the emulated card in a process of its own, where a sanitiser watches.

    python sanitised.py MODEL.npz NETWORKS.npz OPTION...

The first two are written by `test_races`; the rest compiles the kernels.
"""

import sys

import numpy as np
from emulated import RANDOM, Emulated

from fascicle.forward.device.backend import GpuBackend
from fascicle.forward.model import ForwardModel
from fascicle.forward.preparation import from_arrays
from fascicle.forward.template import default_template

if __name__ == "__main__":
    model, written, *options = sys.argv[1:]
    with np.load(model) as arrays:
        heart, prepared = from_arrays(arrays, default_template())
    with np.load(written) as file:
        names, values, expected = file["names"], file["values"], file["activation"]
    model = ForwardModel(heart, prepared=prepared)
    networks = [dict(zip(names.tolist(), row, strict=True)) for row in values]
    backend = GpuBackend.on(Emulated(*options, order=RANDOM), len(networks))
    found = [beat.activation for beat in backend.beats(model, networks)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)
