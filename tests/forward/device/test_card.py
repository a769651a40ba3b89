"""Without a card: one line that says so. And the source is CUDA that compiles."""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import partial
from types import ModuleType, SimpleNamespace

import pytest
from emulated import drawn
from test_networks import assert_same

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward import model as model_module
from fascicle.forward.device import batch
from fascicle.forward.device import card as card_module
from fascicle.forward.device.card import OPTIONS, THREADS, card_number
from fascicle.forward.device.model import DeviceModel
from fascicle.forward.device.source import source
from fascicle.forward.scenario import Scenario


class NoDriverError(RuntimeError):
    pass


@pytest.fixture
def cupy(monkeypatch):
    """CuPy on a machine with so many cards."""

    def install(cards):
        def count():
            if cards is None:
                raise NoDriverError("cudaErrorInsufficientDriver:\nno driver")
            return cards

        runtime = SimpleNamespace(getDeviceCount=count, CUDARuntimeError=NoDriverError)
        module = ModuleType("cupy")
        module.cuda = SimpleNamespace(runtime=runtime)
        monkeypatch.setitem(sys.modules, "cupy", module)
        monkeypatch.setattr(card_module, "find_spec", lambda name: name)

    return install


@pytest.mark.parametrize("name", ["", "gpu", "cuda:", "cuda:x", "cuda:-1", "cuda:0001", "opencl"])
def test_unknown_devices(name):
    with pytest.raises(InputError, match=f"unknown device '{name}'; give cuda, or cuda:1"):
        card_number(name)


def test_without_cupy(monkeypatch):
    monkeypatch.setattr(card_module, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs CuPy; install it: pip install 'cupy-cuda12x"):
        card_number("cuda")


def test_without_a_driver(cupy):
    cupy(None)
    with pytest.raises(InputError, match=r"no NVIDIA card can be used \(cudaError.*: no driver\)"):
        card_number("cuda")


def test_fewer_cards_than_asked_for(cupy):
    cupy(2)
    with pytest.raises(InputError, match="'cuda:2': the cards of this machine end at cuda:1"):
        card_number("cuda:2")
    assert (card_number("cuda"), card_number("cuda:1")) == (0, 1)


def test_simulate_many(crtdemo_model, emulated, monkeypatch):
    """On the card, in order; what is too large for it here, and the card is prepared once."""
    made = []
    monkeypatch.setattr(card_module, "Card", lambda name: made.append(name) or emulated)
    monkeypatch.setattr(model_module, "DeviceModel", partial(DeviceModel, networks=5))
    monkeypatch.setattr(batch, "MOST_SITES", 250)
    networks = drawn(12)
    beats = crtdemo_model.simulate_many(networks, device="cuda:3")
    for network, beat in zip(networks, beats, strict=True):
        expected = crtdemo_model.simulate(network)
        if hasattr(expected, "leads"):
            assert_same(beat, expected)
        else:
            assert beat.reason == expected.reason
    crtdemo_model.simulate_many(networks[:1], device="cuda:3")
    assert made == ["cuda:3"]
    here = [hasattr(beat, "coupled") for beat in beats]
    assert 0 < sum(here) < len(here)
    crtdemo_model._device_model.cache_clear()


def test_what_cannot_be_both(crtdemo_model):
    with pytest.raises(InputError, match="'cuda' simulates intrinsic beats, on its own; leave"):
        crtdemo_model.simulate_many([EXAMPLE_PARAMETERS], None, Scenario(), device="cuda")
    with pytest.raises(InputError, match="give an executor, or a device such as 'cuda'"):
        crtdemo_model.simulate_many([EXAMPLE_PARAMETERS])


def test_the_source_compiles_for_cards(tmp_path):
    """Within the registers and the shared memory of a block."""
    if shutil.which("nvcc") is None:
        pytest.skip("no CUDA compiler (nvcc)")
    (tmp_path / "kernels.cu").write_text(source(), encoding="utf-8")
    ended = subprocess.run(
        ["nvcc", *OPTIONS, "-arch=sm_80", "-Xptxas=-v,-warn-spills", "-cubin", "kernels.cu"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert set(THREADS) <= set(ended.stderr.replace("'", " ").split())
    for line in ended.stderr.splitlines():
        if "registers" in line:
            registers = int(line.split("Used ")[1].split()[0])
            assert registers * max(THREADS.values()) <= 65_536
