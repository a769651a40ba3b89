"""An NVIDIA card, through CuPy."""

from __future__ import annotations

import re
from importlib.util import find_spec
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, one_line
from fascicle.core.ranges import check_text
from fascicle.forward.device.source import Bytes, source

# No fused multiply-add: every operation rounds as on a processor, so that trees are the same to the
# last bit.
OPTIONS = ("-std=c++17", "-fmad=false")
THREADS = {"grow": 128, "attach": 256, "solve": 512, "electrocardiogram": 512}  # of a block


def card_number(name: str) -> int:
    """The number of a card: 0 of ``"cuda"``, 1 of ``"cuda:1"``.

    Raises
    ------
    InputError
        If there is none of this name, or no CuPy.
    """
    check_text(name, "device")
    match = re.fullmatch(r"cuda(?::(\d{1,3}))?", name)
    if match is None:
        raise InputError(f"unknown device '{name}'; give cuda, or cuda:1 for the second card")
    if find_spec("cupy") is None:
        raise InputError(f"device '{name}' needs CuPy; install it: pip install 'cupy-cuda12x[ctk]'")
    import cupy

    try:
        count = cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise InputError(
            f"device '{name}': no NVIDIA card can be used ({one_line(error)}); install the card's "
            "driver, or leave the device out"
        ) from error
    number = int(match[1] or 0)
    if number >= count:
        raise InputError(f"device '{name}': the cards of this machine end at cuda:{count - 1}")
    return number


class Card:
    """An NVIDIA card, as a `fascicle.forward.device.batch.Device`.

    Parameters
    ----------
    name : str
        See `card_number`.
    """

    def __init__(self, name: str) -> None:
        number = card_number(name)
        import cupy

        self._cupy, self._device = cupy, cupy.cuda.Device(number)
        with self._device:
            module = cupy.RawModule(code=source(), options=OPTIONS)
            self._kernels = {kernel: module.get_function(kernel) for kernel in THREADS}
            static = max(kernel.shared_size_bytes for kernel in self._kernels.values())
            self.shared_bytes = self._device.attributes["MaxSharedMemoryPerBlockOptin"] - static
            for kernel in self._kernels.values():
                kernel.max_dynamic_shared_size_bytes = self.shared_bytes

    def upload(self, values: Bytes) -> Any:
        """Copy bytes to a new buffer of the card."""
        buffer = self.room(len(values))
        buffer.set(values)
        return buffer

    def room(self, size: int) -> Any:
        """Make an uninitialised buffer of `size` bytes."""
        with self._device:
            try:
                return self._cupy.empty(size, np.uint8)
            except self._cupy.cuda.memory.OutOfMemoryError as error:
                raise InputError(
                    f"the card has no memory left for {size / 1e6:.0f} MB; free some, or leave the "
                    "device out"
                ) from error

    def address(self, buffer: Any) -> int:
        """Address of a buffer."""
        return int(buffer.data.ptr)

    def download(self, buffer: Any, start: int, size: int) -> Bytes:
        """Copy bytes of a buffer, once all kernels have ended."""
        with self._device:
            return np.asarray(self._cupy.asnumpy(buffer[start : start + size]))

    def launch(self, kernel: str, blocks: int, shared: int, heart: Any, batch: Any) -> None:
        """Run a kernel on two structures in `blocks` blocks, each with `shared` bytes of memory."""
        with self._device:
            self._kernels[kernel]((blocks,), (THREADS[kernel],), (heart, batch), shared_mem=shared)
