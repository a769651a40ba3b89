"""A processor that stands in for a card: the same source, compiled for it.

Within a phase the threads' items run one after the other, in an order that can be chosen; or, with
`THREADS`, on threads that run at the same time and meet where phases end.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

from fascicle.core.parameters import NETWORK_SPACE
from fascicle.forward.device.card import source

HERE = Path(__file__).resolve().parent
KEPT = Path(tempfile.gettempdir()) / "fascicle-emulated"
FORWARD, BACKWARD, RANDOM = 0, 1, 7  # orders; all above 1 are seeds of random ones


def library(*options):
    """Compile the kernels, or take what was compiled of the same source before."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler (g++)")
    text = (
        source((HERE / "emulated_block.h").read_text()) + (HERE / "emulated_launch.h").read_text()
    )
    # no fused multiply-add, as on a card: every operation rounds as in the kernels of Python
    command = [compiler, "-std=c++20", "-O2", "-Wall", "-Werror", "-Wno-unused-function",
               "-ffp-contract=off", "-shared", "-fPIC", "-x", "c++", *options, "-"]  # fmt: skip
    key = hashlib.sha256(f"{command}{text}".encode()).hexdigest()[:24]
    path = KEPT / f"{key}.so"
    if not path.exists():
        KEPT.mkdir(exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")  # another process may compile it, too
        subprocess.run([*command, "-o", part], input=text.encode(), check=True)
        part.rename(path)
    return ctypes.CDLL(str(path))


class Emulated:
    """A processor in place of a `fascicle.forward.device.card.Card`."""

    def __init__(self, *options, order=FORWARD, shared_bytes=227 * 1024):
        self.library, self.order, self.shared_bytes = library(*options), order, shared_bytes

    def upload(self, values):
        buffer = self.room(len(values))
        buffer[: len(values)] = values
        return buffer

    def room(self, size):
        """Anything: NaN as a number, and far out of every range as an index."""
        return np.full(size // 8 + 1, -1, np.int64).view(np.uint8)

    def address(self, buffer):
        return buffer.ctypes.data

    def download(self, buffer, start, size):
        return buffer[start : start + size].copy()

    def launch(self, kernel, blocks, shared, heart, batch):
        function = ctypes.cast(getattr(self.library, kernel), ctypes.c_void_p)
        structures = (ctypes.c_void_p(self.address(each)) for each in (heart, batch))
        self.library.launch(
            function, blocks, ctypes.c_longlong(shared), ctypes.c_int(self.order), *structures
        )


def drawn(count, seed=1):
    """Networks of the prior."""
    rng = np.random.default_rng(seed)
    return [NETWORK_SPACE.from_unit(rng.uniform(size=len(NETWORK_SPACE))) for _ in range(count)]
