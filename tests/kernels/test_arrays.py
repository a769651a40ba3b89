"""Arrays begin where a cache line does."""

import pickle

import numpy as np
import pytest

from fascicle.kernels.arrays import CACHE_LINE, aligned


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_aligned_is_the_same_from_the_start_of_a_cache_line(dtype):
    room = np.arange(1024).astype(np.uint8)
    first = -room.ctypes.data % CACHE_LINE
    for off in (0, 8, 16, 48):
        array = room[first + off :][: 40 * np.dtype(dtype).itemsize].view(dtype).reshape(10, 4)
        found = aligned(array)
        assert found.ctypes.data % CACHE_LINE == 0
        assert (found is array) == (off == 0)
        assert found.dtype == dtype
        assert found.flags.c_contiguous
        assert found.tobytes() == array.tobytes()
    assert aligned(np.empty((0, 3), dtype)).shape == (0, 3)


def test_elements_of_a_heart_are_aligned(default_model):
    """Whether it was prepared here, or sent from another process."""
    for model in (default_model, pickle.loads(pickle.dumps(default_model))):
        assert model.myocardium.mesh.solver.ctypes.data % CACHE_LINE == 0
