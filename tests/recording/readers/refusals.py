"""Signals to write, what every reader must read, and do with files that it cannot use."""

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_ROWS, lead_matrix
from fascicle.recording.readers.read import read_recording


def waves(n, rate=500):
    """(12, n) mV, every lead different, limb leads consistent."""
    t = np.arange(n) / rate
    return lead_matrix() @ np.array([np.sin(2 * np.pi * (1 + k) * t + k) for k in range(9)])


def refused(path, *words, **options):
    """Refuse a recording in one line that begins with its path and holds some words."""
    with pytest.raises(InputError) as info:
        read_recording(path, **options)
    message = str(info.value)
    assert message.startswith(f"{path}: ")
    assert message.isprintable()
    for word in words:
        assert word in message, message
    return message


def read_as(path, signal, tolerance=1e-9, **options):
    """Recording of a file, whose twelve or eight independent leads must be these (mV)."""
    recording = read_recording(path, **options)
    leads = recording.signal[INDEPENDENT_ROWS] if len(signal) == 8 else recording.signal
    np.testing.assert_allclose(leads, signal, rtol=1e-9, atol=tolerance)
    return recording
