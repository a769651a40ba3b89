"""Without a card: one line that says so. And the source is CUDA that compiles."""

import shutil
import subprocess
import sys
from types import ModuleType, SimpleNamespace

import pytest
from emulated import drawn
from test_networks import assert_same

from fascicle.core.errors import InputError
from fascicle.forward.beat import Beat
from fascicle.forward.device.backend import GpuBackend
from fascicle.forward.device.batch import Simulator
from fascicle.forward.device.card import OPTIONS, THREADS, card_number, source
from fascicle.forward.primitives import InactiveRoot
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
        monkeypatch.setattr("fascicle.core.errors.find_spec", lambda name: name)

    return install


@pytest.mark.parametrize("name", ["", "gpu", "cuda:", "cuda:x", "cuda:-1", "cuda:0001", "opencl"])
def test_unknown_devices(name):
    with pytest.raises(InputError, match=f"unknown device '{name}'; give cuda, or cuda:1"):
        card_number(name)


def test_without_cupy(monkeypatch):
    monkeypatch.setattr("fascicle.core.errors.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs cupy; .* 'fascicle-ecg\[cuda\]'"):
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
    """On the card, in order; what is too large for it here."""
    monkeypatch.setattr(Simulator, "most_sites", 250)
    networks = drawn(12)
    beats = crtdemo_model.simulate_many(networks, backend=GpuBackend.on(emulated, 5))
    for network, beat in zip(networks, beats, strict=True):
        expected = crtdemo_model.simulate(network)
        if hasattr(expected, "leads"):
            assert_same(beat, expected)
        else:
            assert beat.reason == expected.reason
    here = [isinstance(beat, Beat) and len(beat.coupled.trees) > 0 for beat in beats]
    assert 0 < sum(here) < len(here)


def test_what_the_card_does_not_know_is_simulated_here(crtdemo_model, emulated):
    backend = GpuBackend.on(emulated, 5)
    for scenario, more, reason in (
        (Scenario([InactiveRoot("rv")]), {}, "scenario"),
        (None, {"anisotropy_ratio": 2.0}, "anisotropy_ratio"),
    ):
        networks = [n | more for n in drawn(2)]
        with pytest.warns(UserWarning, match=reason):
            found = crtdemo_model.simulate_many(networks, scenario=scenario, backend=backend)
        expected = [crtdemo_model.simulate(network, scenario) for network in networks]
        assert [hasattr(each, "coupled") for each in found] == [
            hasattr(each, "coupled") for each in expected
        ]


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
