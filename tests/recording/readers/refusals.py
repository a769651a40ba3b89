"""What every reader must do with files that it cannot use."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from fascicle.core.errors import InputError
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording


def fuzzing(examples, *more):
    """Settings of a test that damages files: bounded, the same in every run, with `tmp_path`.

    `more` are health checks of Hypothesis that the test must do without, too.
    """
    return settings(
        max_examples=examples, deadline=None, derandomize=True,
        suppress_health_check=[HealthCheck.function_scoped_fixture, *more],
    )  # fmt: skip


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


def outcome(path, content=None):
    """Read a file, or some bytes under its name: a recording, or None once it is refused.

    Anything but one line of refusal or finite leads fails.
    """
    if content is not None:
        path.write_bytes(content)
    recording, message = None, f"{path}: "
    try:
        recording = read_recording(path)
    except InputError as error:
        message = str(error)
    assert message.startswith(f"{path}: ")
    assert message.isprintable()
    if recording is None:
        return None
    assert isinstance(recording, Recording)
    assert np.isfinite(recording.sampling_rate)
    assert np.isfinite(recording.signal[recording.recorded]).any(axis=1).all()
    return recording
