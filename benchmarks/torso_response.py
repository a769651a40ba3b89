"""The ECG as a function of the torso: its error against finite elements, its cost, what moves it.

    python -m benchmarks.torso_response [--heart FOLDER] [--network TOML] [--torsos 20]
                                       [--scale 1.0] [--table] [--figure FILE]

Random torsos are drawn uniformly from the whole range (times --scale about the neutral one), those
in which the heart would touch the skin left out. The reference solves each of them by finite
elements on the heart's mesh, to 1e-7. Errors are in the gradients of the lead fields in the heart
(in the norm of their energy) and in their values about the mean, over the eight independent leads,
and in the ECG of a network (the example's if no other is given), all as parts of the reference. The
table says how far each quantity alone moves that ECG from the neutral torso's; the figure draws it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import fascicle
from fascicle.core.leads import INDEPENDENT_ROWS, lead_matrix
from fascicle.core.parameters import Infeasible, read_parameters
from fascicle.core.quantities import QUANTITIES, TORSO_QUANTITIES, parameter_name
from fascicle.forward.electrocardiogram import (
    SAMPLE_STEP,
    build_electrocardiograph,
    nodal_gradients,
)
from fascicle.forward.loss import align
from fascicle.mesh.measures import barycentric_gradients
from fascicle.recording.window import qrs_window
from fascicle.reporting.style import Colour, new_figure, save, styled
from fascicle.torso.conductor import Conductor, TorsoState, build_conductor, torso_of
from fascicle.torso.lead_fields import assemble_stiffness
from fascicle.torso.training import electrode_places, solve_torso

Values = Mapping[str, float]
Array = NDArray[np.float64]


def random_values(
    conductor: Conductor, count: int, scale: float
) -> tuple[list[dict[str, float]], float]:
    """Possible torsos, electrodes at places of the grid, and the share of those drawn."""
    rng, possible, drawn = np.random.default_rng(2026), [], 0
    while len(possible) < count:
        drawn += 1
        values = {}
        for name in TORSO_QUANTITIES:
            quantity = QUANTITIES[name]
            low, high = quantity.prior_range
            part = scale * rng.uniform(-1, 1)
            if name.endswith("_conductivity"):
                values[name] = float(high**part)
            else:
                values[name] = float((low + high) / 2 + part * (high - low) / 2)
        if conductor.is_possible(TorsoState.of(values)):
            possible.append(values)
    return possible, len(possible) / drawn


def on_grid(values: dict[str, float]) -> dict[str, float]:
    """Torso with chest electrodes at the nearest places that the reference is solved for."""
    size, together = values["chest_size"], values["chest_electrodes_up"]
    moved = dict(values)
    for k in range(1, 7):
        left, up = values[f"v{k}_left"], values[f"v{k}_up"] + together
        moved[f"v{k}_left"] = min(24.0, max(-24.0, 6.0 * round(left / size / 6.0))) * size
        moved[f"v{k}_up"] = 6.0 * round(up / size / 6.0) * size - together
    return moved


def direct(conductor: Conductor, values: Values) -> Array:
    """Lead fields (9, n) in the heart over the myocardium's factor, by finite elements."""
    state = TorsoState.of(values)
    fields = solve_torso(conductor, electrode_places(conductor), state, 1e-7, 500)
    return fields[: len(conductor.heart.vertices)].T


def accuracy(
    model: fascicle.ForwardModel,
    network: Values,
    conductor: Conductor,
    torsos: list[dict[str, float]],
) -> None:
    """Errors of fields and ECG at some torsos."""
    heart, response = model.heart, model.torso(TORSO_QUANTITIES).response
    conductivity = conductor.conductivity[: len(heart.tetrahedra)]
    stiffness = assemble_stiffness(heart.vertices, heart.tetrahedra, conductivity)
    leads = lead_matrix()[INDEPENDENT_ROWS]
    barycentric = barycentric_gradients(heart.vertices, heart.tetrahedra)

    def norm(fields: Array) -> float:
        return float(np.sqrt(np.sum((leads @ fields) * (stiffness @ (leads @ fields).T).T)))

    activation = simulated(model, network).activation
    neutral = direct(conductor, {})

    def ecg(fields: Array) -> Array:
        gradients = nodal_gradients(fields, heart.tetrahedra, barycentric)
        intracellular = model.conduction.intracellular(heart.fibres)
        return build_electrocardiograph(
            heart.tetrahedra, barycentric, heart.volumes, intracellular, gradients,
            model.action_potential,
        ).channels(activation)  # fmt: skip

    def values_norm(fields: Array) -> float:
        about_mean = leads @ fields
        return float(np.linalg.norm(about_mean - about_mean.mean(axis=1, keepdims=True)))

    weighted = response.modes @ stiffness
    gram = weighted @ response.modes.T
    rows = []
    for values in map(on_grid, torsos):
        reference = direct(conductor, values)
        approximation = response(TorsoState.of(values)) @ response.modes
        best = np.linalg.solve(gram, weighted @ reference.T).T @ response.modes
        size = norm(reference)
        e = ecg(reference)
        rows.append([
            norm(approximation - reference) / size, norm(best - reference) / size,
            norm(neutral - reference) / size,
            values_norm(approximation - reference) / values_norm(reference),
            values_norm(neutral - reference) / values_norm(reference),
            np.linalg.norm(ecg(approximation) - e) / np.linalg.norm(e),
            np.linalg.norm(ecg(neutral) - e) / np.linalg.norm(e),
        ])  # fmt: skip
    names = (
        "gradients", "best of the modes", "gradients, torso ignored",
        "values", "values, torso ignored", "ECG", "ECG, torso ignored",
    )  # fmt: skip
    for name, column in zip(names, np.transpose(rows), strict=True):
        shown = " ".join(
            f"{100 * q:6.1f}" for q in np.quantile(column, [0, 0.25, 0.5, 0.75, 0.9, 1])
        )
        print(f"  {name:24s} least, quartiles, 90 %, largest (%): {shown}")


def cost(model: fascicle.ForwardModel, network: Values, torsos: list[dict[str, float]]) -> None:
    """Milliseconds of the lead fields of a torso, and of an ECG in it."""
    torso = model.torso(TORSO_QUANTITIES)
    electrocardiograph, activation = (
        model.prepared.electrocardiograph,
        simulated(model, network).activation,
    )
    times = []
    for values in 3 * torsos:
        begin = time.perf_counter()
        coefficients = torso.response(TorsoState.of(values))
        if isinstance(coefficients, Infeasible):
            continue
        responded = time.perf_counter()
        coefficients @ torso.response.modes
        fields = time.perf_counter()
        moved = torso.electrocardiograph(electrocardiograph, coefficients[:8])
        weights = time.perf_counter()
        moved.channels(activation)
        end = time.perf_counter()
        electrocardiograph.channels(activation)
        plain = time.perf_counter()
        times.append(
            [responded - begin, fields - responded, weights - fields, end - weights, plain - end]
        )
    names = ("coefficients", "fields at the vertices", "weights of the ECG", "ECG", "plain ECG")
    shown = zip(names, np.median(times, axis=0), strict=True)
    print("ms a torso (median): " + ", ".join(f"{name} {1e3 * t:.2f}" for name, t in shown))


def axis(leads: Array) -> float:
    """Frontal axis (degrees) of the QRS, from the net areas of I and aVF."""
    onset, offset = qrs_window(leads)
    i, avf = leads[[0, 5], onset:offset].sum(axis=1)
    return float(np.degrees(np.arctan2(2 * avf / np.sqrt(3), i)))


def simulated(model: fascicle.ForwardModel, network: Values) -> fascicle.Beat:
    """The network in the neutral torso."""
    outcome = model.simulate(network)
    if not isinstance(outcome, fascicle.Beat):
        raise SystemExit(f"{model.heart.name}: {outcome.reason}; give another --network")
    return outcome


def table(model: fascicle.ForwardModel, network: Values) -> dict[str, list[float]]:
    """Print changes by each quantity, at one SD and at the ends; returns loss over flat line."""
    plain = simulated(model, network)
    losses: dict[str, list[float]] = {}
    changes = []
    for name in TORSO_QUANTITIES:
        quantity = QUANTITIES[name]
        kind, sd = quantity.default_prior or ("normal", 0.0)
        near = (
            [quantity.default - sd, quantity.default + sd]
            if kind == "normal"
            else np.exp([-sd, sd])
        )
        for value in (quantity.prior_range[0], *near, quantity.prior_range[1]):
            changes.append((name, float(value)))
    print("quantity | value | loss (mV²) | QRS (ms) | axis (degrees)")
    onset, offset = qrs_window(plain.leads)
    recorded = plain.leads[:, onset:offset]
    flat = float((recorded**2).sum() / recorded.shape[1])
    print(
        f"neutral | | 0 (flat line {flat:.2f}) | {plain.qrs_duration:.0f} | {axis(plain.leads):.0f}"
    )
    for name, value in changes:
        ecg = model.electrocardiograph_in_torso({**network, name: value})
        shares = losses.setdefault(name, [])
        if isinstance(ecg, Infeasible):
            print(f"{name} | {value:.3g} | {ecg.reason} | |")
            shares.append(np.nan)
            continue
        leads = network.get("gain", 1.0) * ecg.leads(plain.activation)
        begin, end = qrs_window(leads)
        loss = align(leads, recorded).loss
        shares.append(loss / flat)
        length = (end - begin) * SAMPLE_STEP
        print(f"{name} | {value:.3g} | {loss:.3f} | {length:.0f} | {axis(leads):.0f}")
    return losses


def draw(losses: dict[str, list[float]], title: str, file: Path) -> None:
    """Draw the changes by each quantity, at the ends of its range and at one standard deviation."""
    names = sorted(losses, key=lambda name: np.nanmax(losses[name]))
    ends, near = (
        [100 * np.nanmax([losses[name][k] for k in chosen]) for name in names]
        for chosen in ((0, 3), (1, 2))
    )

    @styled
    def bars() -> Figure:
        figure = new_figure(6.5, 5.0, f"ECG changed by the torso alone, {title}")
        axes = figure.subplots()
        titles = [parameter_name(name) for name in names]
        worse = "at the worse end of its range"
        axes.barh(titles, ends, color=Colour.BLUE, alpha=0.35, label=worse)
        axes.barh(titles, near, color=Colour.BLUE, label="at one standard deviation of its prior")
        axes.legend(loc="lower right")
        axes.set_ylabel("quantity of the torso")
        axes.set_xlabel("mismatch with the ECG in the neutral torso (% of a flat line's)")
        return figure

    save(bars(), file)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", default="default")
    parser.add_argument("--network", type=Path, help="parameters of a network (TOML)")
    parser.add_argument("--torsos", type=int, default=20)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--table", action="store_true", help="what each quantity moves")
    parser.add_argument("--figure", type=Path, help="of the table (PNG)")
    arguments = parser.parse_args()
    heart = fascicle.load_heart(arguments.heart)
    model = fascicle.ForwardModel(heart)
    network: Values = fascicle.example_parameters(model)
    if arguments.network:
        network = read_parameters(arguments.network)
    begin = time.perf_counter()
    response = model.torso(TORSO_QUANTITIES).response
    print(f"{heart.name}: response in {time.perf_counter() - begin:.0f} s (little if it was kept), "
          f"{len(response.modes)} modes, {len(response.solved)} torsos")  # fmt: skip
    torso = torso_of(heart)
    conductor = build_conductor(heart, torso, model.conduction)
    torsos, possible = random_values(conductor, arguments.torsos, arguments.scale)
    print(f"{len(torsos)} random torsos; {100 * (1 - possible):.0f} % of those drawn impossible")
    accuracy(model, network, conductor, torsos)
    cost(model, network, torsos)
    if arguments.table or arguments.figure:
        losses = table(model, network)
        if arguments.figure:
            draw(losses, heart.name, arguments.figure)


if __name__ == "__main__":
    main()
