"""What stands in for a card, and a card where there is one."""

import pytest
from emulated import BACKWARD, FORWARD, RANDOM, Emulated

SHARED = {"h100": 227 * 1024, "none": 4096}  # bytes; with few, times and bins lie elsewhere


def _card():
    try:
        import cupy

        cupy.cuda.runtime.getDeviceCount()
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"no NVIDIA card with CuPy ({error})")
    from fascicle.forward.device.card import Card

    return Card("cuda")


DEVICES = {
    "forward": lambda: Emulated(order=FORWARD),
    "backward": lambda: Emulated(order=BACKWARD),
    "random": lambda: Emulated(order=RANDOM),
    "without shared memory": lambda: Emulated(order=RANDOM, shared_bytes=SHARED["none"]),
    "card": _card,
}


@pytest.fixture(scope="session", params=DEVICES)
def device(request):
    return DEVICES[request.param]()
