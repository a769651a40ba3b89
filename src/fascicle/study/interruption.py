"""Ctrl-C that waits for what is running."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Let Ctrl-C end the block only when it is done; a second one does not wait.

    Nothing is changed where Ctrl-C is ignored, nor in any thread but the main one, which alone
    hears of it.
    """
    here = threading.current_thread() is threading.main_thread()
    if not here or not callable(signal.getsignal(signal.SIGINT)):
        yield
        return
    pressed = False

    def remember(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        signal.raise_signal(signal.SIGINT)  # as whoever listened before wants it
