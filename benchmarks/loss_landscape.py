"""Resolution of the loss among networks that explain nothing: how many it cannot tell apart.

    python -m benchmarks.loss_landscape --data DATA_FOLDER [--only demo|ludb24|dti004|...]
                                        [--draws 300] [--out FOLDER]

Networks are drawn from the paper's ranges, gain fixed, and compared with an ECG by the loss and by
the same integral over the QRS window alone, in which a simulation may slide out of the window.
Printed are the share of draws within 0.1 % of a flat line's mismatch by each of the two (on such a
plateau there is nothing to learn), how many different values the loss takes, and its least.

The cases are those of `benchmarks.fits`, and the ECG of a known network on the packaged heart and,
with --data, on crtdemo. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.signal

import fascicle
from benchmarks.fits import CASES
from benchmarks.forward import _heart, build_case
from examples.recover_known_network import TRUTH, synthetic_target
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.forward.loss import placed
from fascicle.networks.target_comparison import TargetComparison
from fascicle.recording.target import Target

Array = npt.NDArray[np.float64]
NEAR = 1e-3  # of the mismatch of a flat line
SEED = 1


def window_alone(simulated: Array, recorded: Array) -> float:
    """Least mismatch (mV²) over all shifts that leave an overlap, in the window alone."""
    length = recorded.shape[1]
    padded = np.pad(simulated, ((0, 0), (length - 1, length - 1)))
    product = sum(
        scipy.signal.correlate(p, r, mode="valid") for p, r in zip(padded, recorded, strict=True)
    )
    running = np.concatenate([[0.0], np.cumsum((padded**2).sum(axis=0))])
    energy = running[length:] - running[:-length]
    return float(((recorded**2).sum() - 2 * product + energy).min() / length)


def draws(model: fascicle.ForwardModel, count: int) -> list[fascicle.Beat]:
    """Valid networks, simulated."""
    rng, networks = np.random.default_rng(SEED), []
    while len(networks) < count:
        outcome = model.simulate(NETWORK_SPACE.from_unit(rng.random(len(NETWORK_SPACE))))
        if isinstance(outcome, fascicle.Beat):
            networks.append(outcome)
    return networks


def row(
    name: str, model: fascicle.ForwardModel, target: Target, networks: list[fascicle.Beat]
) -> str:
    """Row of the table."""
    comparison = TargetComparison(target)
    recorded = target.qrs[comparison.compared]
    losses = np.array([comparison.align(network.leads).loss for network in networks])
    alone = [
        window_alone(
            placed(n.leads[comparison.compared], 0.0, n.leads.shape[1], target.response), recorded
        )
        for n in networks
    ]
    near_alone, near = (
        np.mean(np.abs(values / comparison.null_loss - 1) < NEAR)
        for values in (np.array(alone), losses)
    )
    different = len(np.unique(losses.round(6)))
    return (
        f"{name:<20} {comparison.null_loss:6.2f} {near_alone:12.1%} {near:10.1%} "
        f"{different:6d} of {len(losses)} {min(alone):9.3f} {losses.min():9.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--only", action="append")
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--out", type=Path, default=Path("fits"))
    arguments = parser.parse_args()
    print(f"{'':<20} {'flat':>6} {'window alone':>12} {'near flat':>10} different, least of each")
    models = {"default": fascicle.ForwardModel(fascicle.load_heart("default"))}
    if arguments.data is not None:
        crtdemo = _heart(build_case(arguments.data / "hearts" / "crtdemo"))
        models["crtdemo"] = fascicle.ForwardModel(crtdemo)
    for name, model in models.items():
        if arguments.only is None or name in arguments.only:
            networks, simulation = draws(model, arguments.draws), model.simulate(TRUTH)
            assert isinstance(simulation, fascicle.Beat)
            target = synthetic_target(simulation.leads, np.random.default_rng(0))
            print(row(f"known, {name}", model, target, networks), flush=True)
    for name, case in CASES.items() if arguments.data is not None else ():
        if arguments.only is None or name in arguments.only:
            model = fascicle.ForwardModel(case.heart(arguments.data, arguments.out))
            target = case.target(arguments.data)
            print(row(name, model, target, draws(model, arguments.draws)), flush=True)


if __name__ == "__main__":
    main()
