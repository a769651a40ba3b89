"""What every reader must do with files that it cannot use."""

import pytest

from fascicle.core.errors import InputError
from fascicle.recording.readers.read import read_recording


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
