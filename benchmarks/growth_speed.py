"""Time of growth a node, with two fascicles a side and with four.

    python -m benchmarks.growth_speed --data CRTDEMO_FOLDER

The baseline is two fascicles a side, drawn from the paper's ranges; for four, two more are drawn
from the same ranges. More fascicles mean more branches that grow at once; each node's searches must
not take longer for it. Trees with two and with four are grown in turn, each timed as the least of
`REPEATS` runs after a warm-up, and the times added up over all trees.

Without --data only the packaged heart is measured. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.forward import pin_to_one_core
from benchmarks.growth_refinement import RULES, hearts
from fascicle.core.parameters import NETWORK_SPACE, Infeasible
from fascicle.heart.endocardium import Endocardium
from fascicle.purkinje.chart import Chart, build_chart
from fascicle.purkinje.growth import Seed, find_seed, grow_from_parameters

REPEATS = 5


def with_four_fascicles(
    two: Mapping[str, float], other_two: Mapping[str, float]
) -> dict[str, float]:
    """A network with the fascicles of two draws, and all else of the first."""
    four = dict(two)
    for name, value in other_two.items():
        if "_fascicle_" in name:
            stem, number = name.rsplit("_", 1)
            four[f"{stem}_{int(number) + 2}"] = value
    return four


def seconds_and_nodes(
    side: str, chart: Chart, seed: Seed, parameters: Mapping[str, float]
) -> tuple[float, int] | None:
    """Time to grow a tree and its number of nodes, or None where it does not fit."""
    seconds = []
    for _ in range(1 + REPEATS):
        begin = time.perf_counter()
        tree = grow_from_parameters(side, chart, seed, parameters, RULES)
        seconds.append(time.perf_counter() - begin)
        if isinstance(tree, Infeasible):
            return None
    return min(seconds[1:]), len(tree.nodes)


def measure(endocardium: Endocardium, trees: int) -> tuple[list[float], list[float]]:
    """Nanoseconds a node and nodes a tree, with two fascicles and with four."""
    chart = build_chart(endocardium)
    seed = find_seed(endocardium, chart)
    rng = np.random.default_rng(0)
    pairs: list[tuple[tuple[float, int], tuple[float, int]]] = []
    while len(pairs) < trees:
        two, other_two = (NETWORK_SPACE.from_unit(u) for u in rng.random((2, len(NETWORK_SPACE))))
        four = with_four_fascicles(two, other_two)
        pair = [seconds_and_nodes(endocardium.side, chart, seed, p) for p in (two, four)]
        if pair[0] is not None and pair[1] is not None:
            pairs.append((pair[0], pair[1]))
    seconds, nodes = np.array(pairs).sum(axis=0).T
    return list(1e9 * seconds / nodes), list(nodes / trees)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    parser.add_argument("--trees", type=int, default=50, help="trees a side")
    arguments = parser.parse_args(argv)
    pin_to_one_core()
    print(f"{'':<14}{'nodes a tree':>16}{'ns a node':>16}{'ratio':>8}")
    print(f"{'':<14}" + f"{'two':>8}{'four':>8}" * 2)
    for name, endocardium in hearts(arguments.data):
        (two, four), nodes = measure(endocardium, arguments.trees)
        label = f"{name} {endocardium.side}"
        print(
            f"{label:<14}{nodes[0]:>8.0f}{nodes[1]:>8.0f}{two:>8.0f}{four:>8.0f}{four / two:>8.2f}"
        )


if __name__ == "__main__":
    main()
