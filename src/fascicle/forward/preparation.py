"""Work done once: kernels compiled on a machine, and what a heart's networks have in common."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any, TypeVar

import numpy as np

from fascicle.core.files import DISPOSABLE, ArrayCache
from fascicle.core.parameters import Infeasible
from fascicle.core.progress import Progress, stage_progress
from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import Candidates, Myocardium, attach, search_tree
from fascicle.forward.electrocardiogram import (
    ActionPotential,
    Electrocardiograph,
    build_electrocardiograph,
    nodal_gradients,
    unbounded_gradients,
)
from fascicle.forward.template import default_template
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.kernels.arrays import EikonalMesh, TravelTimeTable, aligned
from fascicle.kernels.gaussian import integrated
from fascicle.mesh.measures import barycentric_gradients
from fascicle.purkinje.chart import Chart, build_chart
from fascicle.purkinje.growth import GrowthRules, Seed, find_seed, grow_from_parameters
from fascicle.torso.lead_fields import resolve_lead_fields

ONCE = "once per heart"

Result = TypeVar("Result")


@dataclass(frozen=True)
class Prepared:
    """Everything about a heart that the forward model needs."""

    charts: dict[str, Chart]  # by side, as the seeds
    seeds: dict[str, Seed]
    myocardium: Myocardium
    electrocardiograph: Electrocardiograph  # of healthy tissue


def prepare(
    heart: Heart,
    conduction: Conduction,
    action_potential: ActionPotential,
    progress: Progress | None = None,
) -> Prepared:
    """Compute the preparation of a heart, or read it from the heart's cache.

    The cache is in the folder that the heart was read from, if that is writable. Its keys are the
    content of heart and conduction and the version of this package.
    """
    return cached(
        heart,
        conduction,
        "prepared",
        lambda: build(heart, conduction, action_potential, progress),
        as_arrays,
        lambda arrays: from_arrays(arrays, action_potential, heart)[1],
        most=4,  # entries, one per conduction; the oldest are deleted
    )


def cached(
    heart: Heart,
    conduction: Conduction,
    kind: str,
    make: Callable[[], Result],
    arrays_of: Callable[[Result], Mapping[str, Any]],
    restored: Callable[[Mapping[str, Any]], Result],
    most: int | None = None,
) -> Result:
    """Read a result for heart and conduction from the heart's cache, or compute and store it.

    A result is stored as the arrays that `arrays_of` gives, which `restored` turns back into it. Of
    each `kind` the cache holds at most `most` entries.
    """
    if heart.folder is None or not os.access(heart.folder, os.W_OK):
        return make()
    cache, key = ArrayCache(heart.folder / DISPOSABLE, kind), f"{heart.digest} {conduction}"
    arrays = cache.read(key)
    if arrays is not None:
        with suppress(KeyError, TypeError, ValueError):  # arrays of another layout: compute again
            return restored(arrays)
    prepared = make()
    cache.keep(key, arrays_of(prepared), most)
    return prepared


def share_prepared(heart: Heart, copy: Path) -> None:
    """Hard-link the cached files of a heart into a copy of its folder.

    Where that is impossible, as between two disks, the copy is prepared when it is first used.
    """
    if heart.folder is None or not (heart.folder / DISPOSABLE).is_dir():
        return
    with suppress(OSError):
        (copy / DISPOSABLE).mkdir(exist_ok=True)
        for file in (heart.folder / DISPOSABLE).iterdir():
            finished = file.is_file() and not file.name.startswith(".")
            if finished and not (copy / DISPOSABLE / file.name).exists():
                os.link(file, copy / DISPOSABLE / file.name)


def build(
    heart: Heart,
    conduction: Conduction,
    action_potential: ActionPotential,
    progress: Progress | None = None,
    rays: int = 150,
) -> Prepared:
    """Compute the preparation of a heart without its cache; parameters as for `prepare`.

    `rays` is that of `fascicle.forward.eikonal.build.build_myocardium`.
    """
    charts = {e.side: build_chart(e) for e in heart.endocardia}
    barycentric = barycentric_gradients(heart.vertices, heart.tetrahedra)
    fields = resolve_lead_fields(heart, conduction, stage_progress(progress, "lead fields", ONCE))
    if fields is None:
        electrodes = heart.electrode_positions
        gradients = unbounded_gradients(
            heart.vertices, heart.tetrahedra, electrodes, conduction.torso
        )
    else:
        gradients = nodal_gradients(fields.values, heart.tetrahedra, barycentric)
    electrocardiograph = build_electrocardiograph(
        heart.tetrahedra, barycentric, heart.volumes, conduction.intracellular(heart.fibres),
        gradients, action_potential, [*heart.additional_electrodes],
    )  # fmt: skip
    report = stage_progress(progress, "preparation", ONCE)
    myocardium = build_myocardium(heart, conduction, report, barycentric, rays=rays)
    return Prepared(charts, _seeds(heart, charts), myocardium, electrocardiograph)


def _seeds(heart: Heart, charts: dict[str, Chart]) -> dict[str, Seed]:
    return {e.side: find_seed(e, charts[e.side]) for e in heart.endocardia}


def as_arrays(prepared: Prepared, heart: Heart | None = None) -> dict[str, Any]:
    """Arrays of a preparation by name, and of its heart if that is given."""
    myocardium, ecg = prepared.myocardium, prepared.electrocardiograph
    parts = {
        "mesh": myocardium.mesh._asdict(),
        "travel_times": myocardium.travel_times._asdict(),
        "myocardium": _attributes(myocardium, "order", "conducts", "surface", "owner"),
        "ecg": _attributes(ecg, "corners", "weights"),
        **{side: chart._asdict() for side, chart in prepared.charts.items()},
        **{f"{side} candidates": c._asdict() for side, c in myocardium.candidates.items()},
    }
    if ecg.additional_count:
        parts["ecg"] |= {"additional": np.array(ecg.additional)}
        parts["ecg"] |= _attributes(ecg, "additional_count")
    if heart is not None:
        parts["heart"] = _attributes(heart, "vertices", "tetrahedra", "fibres", "electrodes")
        if heart.regions is not None:
            parts["heart"]["regions"] = heart.regions
        parts["additional electrodes"] = dict(heart.additional_electrodes)
        for e in heart.endocardia:
            surface = _attributes(e, "vertices", "triangles", "root", "direction")
            parts[f"{e.side} endocardium"] = surface
    return {f"{part}.{n}": value for part, values in parts.items() for n, value in values.items()}


def _attributes(part: object, *names: str) -> dict[str, Any]:
    return {name: getattr(part, name) for name in names}


def with_numbers(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays by name, those without dimensions as numbers, for which kernels are compiled."""
    stored = {name: np.asarray(array) for name, array in arrays.items()}
    return {name: array if array.ndim else array.item() for name, array in stored.items()}


def from_arrays(
    arrays: Mapping[str, Any], action_potential: ActionPotential, heart: Heart | None = None
) -> tuple[Heart, Prepared]:
    """Heart and preparation from the arrays of `as_arrays`; the heart, too, unless it is given."""
    parts: defaultdict[str, dict[str, Any]] = defaultdict(dict)
    for key, value in with_numbers(arrays).items():
        part, name = key.split(".", 1)  # names of electrodes may hold points
        parts[part][name] = aligned(value) if name == "solver" else value
    if heart is None:
        lv, rv = (Endocardium(side, **parts[f"{side} endocardium"]) for side in ("lv", "rv"))
        additional = parts["additional electrodes"]
        heart = Heart(lv=lv, rv=rv, additional_electrodes=additional, **parts["heart"])
    charts = {e.side: Chart(**parts[e.side]) for e in heart.endocardia}
    mesh, myocardium = EikonalMesh(**parts["mesh"]), parts["myocardium"]
    tree = search_tree(mesh.vertices, myocardium["surface"])
    table = TravelTimeTable(**parts["travel_times"])
    candidates = {side: Candidates(**parts[f"{side} candidates"]) for side in charts}
    return heart, Prepared(
        charts,
        _seeds(heart, charts),
        Myocardium(mesh, table, **myocardium, tree=tree, candidates=candidates),
        Electrocardiograph(**parts["ecg"], action_potential=action_potential),
    )


_compiled = False  # whether this process has compiled the kernels


def compile_kernels(progress: Progress | None, silence: float = 1.0) -> None:
    """Compute the action potential, and run every kernel on a tiny heart.

    Once in a process; kernels that were compiled on this machine before are read from disk.
    `progress` is called with the steps done, once they take longer than `silence` (s); without it
    kernels are compiled when they are first used.
    """
    global _compiled
    if _compiled or progress is None:
        return
    finished, is_slow = 0, False

    def report() -> None:
        nonlocal is_slow
        is_slow = True
        progress("compilation", finished, 4, "once on this machine")

    timer = Timer(silence, report)
    timer.start()
    try:
        for done in _steps():
            finished = done
            if is_slow:
                report()
    finally:
        timer.cancel()
    _compiled = True


def _steps() -> Iterator[int]:
    template = default_template()
    yield 1
    heart = _smallest_heart()
    prepared = build(heart, Conduction(), template)
    lengths = {"lv_initial_length": 2.0, "lv_fascicle_length_1": 1.0, "lv_fascicle_angle_1": 0.0}
    rules = GrowthRules(branch_length=1.0, segments=2, generations=1)
    tree = grow_from_parameters("lv", prepared.charts["lv"], prepared.seeds["lv"], lengths, rules)
    if isinstance(tree, Infeasible):
        raise RuntimeError(f"the smallest heart has no room for its tree: {tree.reason}")
    yield 2
    activation = solve(attach(prepared.myocardium, [tree]), [0.0], 1.0)
    yield 3
    prepared.electrocardiograph.leads(activation.myocardium)
    for kind in (np.float32, np.float64):  # types of emulated and of simulated ECGs
        models = np.zeros((1, 1, 1), kind)
        integrated(models, kind(0), models[0, 0], models[0], np.zeros(1), np.zeros((1, 1)))
    yield 4


def _smallest_heart() -> Heart:
    """An octahedron of four tetrahedra; its upper half is both endocardia."""
    ring = [[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [-10.0, 0.0, 0.0], [0.0, -10.0, 0.0]]
    vertices = np.array([*ring, [0.0, 0.0, 10.0], [0.0, 0.0, -10.0]])
    around = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    tetrahedra = np.column_stack([around, np.full(4, 4), np.full(4, 5)])[:, [0, 1, 3, 2]]
    face = Endocardium("lv", vertices[:5], np.column_stack([around, np.full(4, 4)]), 4, 0)
    fibres = np.tile([1.0, 0.0, 0.0], (4, 1))
    electrodes = 50.0 * np.random.default_rng(0).normal(size=(9, 3))
    other = Endocardium("rv", face.vertices, face.triangles, 4, 0)
    return Heart(vertices, tetrahedra, fibres, face, other, electrodes)
