"""Make the hearts of the atlas and the simulations from which its emulators learn.

    python tools/make_atlas.py template --surface heart.vtp --out FOLDER
    python tools/make_atlas.py simulate --out FOLDER [--hearts 64] [--processes 2]
    python tools/make_atlas.py ectopic --out FOLDER [--hearts 64] [--processes 2]
    python tools/make_atlas.py learn --out FOLDER

The surface is the mean of more than 1000 healthy hearts, `examples/geo1/heart.vtp` of Cobiveco
(Apache-2.0). Hearts are independent of each other; those that are there are not made again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from heart_family import HeartFamily, heart_in_torso, with_drawn_seeds
from make_packaged_emulators import put
from numpy.typing import NDArray

import fascicle
from fascicle.atlas.population import (
    NETWORK_HEIGHTS,
    AtlasHeart,
    Build,
    HeartSize,
    drawn_hearts,
    measures_of,
)
from fascicle.build.build_heart import TorsoOptions, heart_of, in_torso
from fascicle.build.labelled_files import Anatomy, labelled_surface
from fascicle.build.meshing import filled
from fascicle.build.surface_checks import wall_thickness
from fascicle.build.surface_repair import prepared_surface
from fascicle.core.conduction_states import told_apart
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.emulation.ecg_classifier import (
    EcgClassifier,
    Recorder,
    RecordingSet,
    in_cosines,
    in_leads,
)
from fascicle.emulation.ecg_classifier import learn as learn_classifier
from fascicle.emulation.ecg_emulator import (
    EcgEmulator,
    emulated_quantities,
    learn_quantities,
    ranges_of,
    tissue_inputs,
    with_residuals,
)
from fascicle.emulation.heart_emulator import usual_prior
from fascicle.emulation.origin import classifier_key as origin_key
from fascicle.emulation.origin import ectopic_beats, learn_origins
from fascicle.emulation.state_classifier import classifier_key, simulations_of_states
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import (
    Electrocardiograph,
    build_electrocardiograph,
    nodal_gradients,
)
from fascicle.forward.loss import placed
from fascicle.forward.model import ForwardModel
from fascicle.forward.preparation import build
from fascicle.forward.primitives import His, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.forward.template import default_template
from fascicle.heart.atlas import atlas_heart, with_bare_base
from fascicle.heart.conduction import Conduction
from fascicle.heart.coordinates import with_coordinates
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Atlas, Components, Heart, LeadFields
from fascicle.heart.labelled_surface import labelled_mesh
from fascicle.mesh.measures import barycentric_gradients
from fascicle.mesh.read import read_mesh
from fascicle.networks.prior import TISSUES, AveragedOver, Prior
from fascicle.networks.prior_simulations import BEFORE, HELD_OUT, Examples
from fascicle.torso.lead_fields import key_of, torso_key
from fascicle.torso.training import lead_fields_in_torsos

EDGE_LENGTH = 4.0  # mm
TORSOS = 8  # variations of each torso
NORMAL, MOST, OTHERS = 250, 2400, 100  # networks wanted, tried at most, and of each other state
ECTOPIC = 160  # beats from anywhere in a heart
LENGTH = 300  # samples (ms) of an ECG
SEED = 20261129
FIELD_COMPONENTS = 140  # of the lead fields
INPUTS = 16  # numbers that stand for a heart in the emulators
EPOCHS = 30  # of the emulators' training
# of the probabilities of origins: regions of 90 % then hold the origins of beats simulated on real
# hearts, where those that are right for hearts of the atlas hold fewer (docs/atlas.md)
ORIGIN_TEMPERATURE = 3.5
PLAIN_RATIO = float(np.divide(*Conduction().speeds))
COUNT = 16_000
PACKAGE = Path(fascicle.__file__).parent / "data"


def template(surface: Path, out: Path) -> None:
    """Mesh the surface, coarsely: one tetrahedron across the right ventricle's free wall."""
    labelled = labelled_surface(read_mesh(surface, "anatomy"), None, None, None)
    mesh = filled(prepared_surface(labelled), EDGE_LENGTH)
    heart, _ = with_coordinates(heart_of(Anatomy(mesh), name="atlas"), mesh)
    heart, _ = in_torso(heart, mesh, TorsoOptions())
    write_heart(heart, out / "template")


def forward_model(
    heart: Heart, tissue: int, fields: NDArray[Any]
) -> tuple[ForwardModel, list[Electrocardiograph]]:
    """Forward model of a heart with a tissue, and ECG integrals in the variations of its torso."""
    conduction = Conduction.of(heart).with_values(TISSUES[tissue])
    standard = LeadFields(
        fields[0].astype(float), key_of(heart, conduction), torso_key(heart.torso)
    )
    heart, potential = replace(heart, lead_fields=standard), default_template()
    prepared = build(heart, conduction, potential, rays=ForwardModel.atlas_rays)
    gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
    mesh = heart.tetrahedra, gradients, heart.volumes, conduction.intracellular(heart.fibres)
    torsos = [
        build_electrocardiograph(
            *mesh, nodal_gradients(field.astype(float), heart.tetrahedra, gradients), potential, []
        )
        for field in fields[1:]
    ]
    return ForwardModel(heart, conduction, prepared=prepared), torsos


def kept_leads(leads: NDArray[Any], beat: Beat) -> NDArray[np.float16]:
    """Independent leads (8, LENGTH) from `BEFORE` the first activation."""
    begin = beat.first_activation - BEFORE
    return placed(leads[[*INDEPENDENT_ROWS]], begin, LENGTH).astype(np.float16)


def simulate(number: int, out: Path, described: AtlasHeart) -> str:
    """Make a heart of the atlas and simulate networks in it."""
    path = out / f"{number:03d}.npz"
    if path.exists():
        return f"{number}: there"
    began = time.perf_counter()
    torso_rng, rng = np.random.default_rng([SEED, number]), np.random.default_rng([SEED, number, 2])
    family = HeartFamily.of(load_heart(out / "template"))
    try:
        heart = heart_in_torso(family, described, f"atlas {number}")
    except InputError as error:
        path.with_suffix(".txt").write_text(f"{error}\n", encoding="utf-8")
        return f"{number}: {error}"
    fields = lead_fields_in_torsos(heart, Conduction.of(heart), torso_rng, TORSOS)
    meshed = time.perf_counter() - began
    height = float(rng.uniform(*NETWORK_HEIGHTS))
    heart = with_bare_base(with_drawn_seeds(heart, rng), height)
    model, torsos = forward_model(heart, described.tissue, fields)
    arrays: dict[str, np.ndarray] = {
        "vertices": heart.vertices.astype(np.float32),
        "fields": fields.astype(np.float32),
        "electrodes": heart.electrodes,
        "seeds": np.array([(e.root, e.direction) for e in heart.endocardia]),
        "network height": np.array(height),
    }
    counts = {}
    for index, state in enumerate(told_apart()):
        usual = usual_prior(heart, state)
        # weighted as the hearts of an atlas are, whose activation may end later (`Prior.keeps`)
        averaged = AveragedOver(usual.averaged.space, (TISSUES[described.tissue],), (1.0,))
        prior = replace(usual, averaged=averaged)
        points, feasible, kept, ecgs, in_torsos, which = [], [], [], [], [], []
        wanted = NORMAL if prior.mapped else OTHERS
        while sum(kept) < wanted and len(points) < MOST:
            point = prior.sample(rng, 1)[0]
            values = prior.from_unit(point)
            beat = model.simulate(values)
            points.append(point)
            feasible.append(isinstance(beat, Beat))
            kept.append(False)
            if not isinstance(beat, Beat):
                continue
            kept[-1] = prior.keeps(point, model.surfaces, beat)
            which.append(int(rng.integers(TORSOS)))
            torso = model.with_sources(torsos[which[-1]], values)
            for leads, to in ((beat.leads, ecgs), (torso.leads(beat.activation), in_torsos)):
                to.append(kept_leads(leads, beat))
        arrays |= {
            f"{index} points": np.array(points), f"{index} feasible": np.array(feasible),
            f"{index} kept": np.array(kept), f"{index} ecgs": np.array(ecgs),
            f"{index} in torsos": np.array(in_torsos), f"{index} torsos": np.array(which),
        }  # fmt: skip
        counts[state.name] = f"{sum(kept)}/{sum(feasible)}/{len(points)}"
    text = json.dumps(
        {
            **asdict(described),
            "axis": [*described.axis],
            "shift": [*described.shift],
            "trunk": [*described.trunk],
        }
    )
    part = out / f".{number:03d}.npz"
    np.savez_compressed(part, described=np.array(text), **arrays)
    part.rename(path)
    whole = time.perf_counter() - began
    return f"{number}: torso {meshed:.0f} s, whole {whole:.0f} s, {counts}"


def ectopic(number: int, out: Path) -> str:
    """Simulate beats from anywhere in a heart of the atlas that `simulate` has made."""
    path, part = out / f"ectopic-{number:03d}.npz", out / f".ectopic-{number:03d}.npz"
    simulated = Simulated.read(out, [number])
    if path.exists() or not simulated.hearts:
        return f"{number}: nothing to do"
    began, rng = time.perf_counter(), np.random.default_rng([SEED, number, 1])
    (described,), (arrays,) = simulated.hearts, simulated.arrays
    model, torsos = forward_model(simulated.heart(0), described.tissue, arrays["fields"])
    prior = ectopic_beats(model, out).prior
    prior = replace(prior, averaged=replace(prior.averaged, tissues=(TISSUES[described.tissue],)))
    volumes = model.heart.volumes
    points, feasible, origins, ecgs, in_torsos, which = [], [], [], [], [], []
    for k in range(ECTOPIC):
        # three beats from one place, since finding the rays from it takes long; the tenth, which
        # is held out, has one of its own
        if k % HELD_OUT in (0, 3, 6, HELD_OUT - 1):
            origin = int(rng.choice(len(volumes), p=volumes / volumes.sum()))
        x, y, z = model.heart.vertices[model.heart.tetrahedra[origin]].mean(axis=0)
        scenario = Scenario((His(time=np.inf), Stimulus(time=0.0, position=(x, y, z))))
        point = prior.sample(rng, 1)[0]
        beat = model.simulate(prior.from_unit(point), scenario)
        points.append(point)
        origins.append(origin)
        feasible.append(isinstance(beat, Beat))
        if not isinstance(beat, Beat):
            continue
        which.append(int(rng.integers(TORSOS)))
        leads = torsos[which[-1]].leads(beat.activation)
        ecgs.append(kept_leads(beat.leads, beat))
        in_torsos.append(kept_leads(leads, beat))
    np.savez_compressed(
        part, points=np.array(points), feasible=np.array(feasible), origins=np.array(origins),
        ecgs=np.array(ecgs), in_torsos=np.array(in_torsos), torsos=np.array(which),
    )  # fmt: skip
    part.rename(path)
    return f"{number}: {sum(feasible)} beats, {time.perf_counter() - began:.0f} s"


@dataclass(frozen=True)
class Simulated:
    """Simulated hearts of the atlas, as `simulate` has written them."""

    template: Heart
    hearts: list[AtlasHeart]
    arrays: list[dict[str, NDArray[Any]]]

    @classmethod
    def read(cls, folder: Path, numbers: Sequence[int] | None = None) -> Simulated:
        """Read all hearts that are finished, or those of these numbers."""
        hearts, arrays = [], []
        for path in sorted(folder.glob("[0-9]*.npz")):
            if numbers is not None and int(path.stem) not in numbers:
                continue
            with np.load(path, allow_pickle=False) as content:
                arrays.append({name: content[name] for name in content.files})
            fields = json.loads(str(arrays[-1].pop("described")))
            fields |= {"build": Build(**fields["build"]), "size": HeartSize(**fields["size"])}
            fields |= {name: np.array(fields[name]) for name in ("axis", "shift", "trunk")}
            hearts.append(AtlasHeart(**fields))
        return cls(load_heart(folder / "template"), hearts, arrays)

    def heart(self, number: int) -> Heart:
        """One of the hearts, without a torso."""
        return replace(atlas_heart(replace(self.template, atlas=self.atlas), number), atlas=None)

    def of(self, name: str) -> list[NDArray[Any]]:
        """Arrays of this name, one for each heart."""
        return [arrays[name] for arrays in self.arrays]

    @property
    def atlas(self) -> Atlas:
        """Atlas of these hearts, which are equally probable."""
        count, mesh = len(self.hearts), labelled_mesh(self.template)
        walls = [
            np.median(wall_thickness(replace(mesh, vertices=vertices.astype(float))).lv)
            for vertices in self.of("vertices")
        ]
        fields = np.array([fields[0] for fields in self.of("fields")], dtype=float)
        fields = fields.reshape(9 * count, -1)
        return Atlas(
            Components.of(np.array(self.of("vertices"), dtype=float).reshape(count, -1), 24),
            np.array(self.of("electrodes")),
            np.array(self.of("seeds")),
            np.array(self.of("network height")),
            Components.of(fields - fields.mean(axis=1, keepdims=True), FIELD_COMPONENTS),
            tuple(TISSUES[heart.tissue] for heart in self.hearts),
            {**measures_of(self.hearts), "lv_wall": np.array(walls)},
            np.full(count, 1 / count),
        )

    def inputs(self) -> NDArray[np.float64]:
        """Inputs (k, p) that stand for each heart: of its mean ECG, and its tissue."""
        means = []
        for feasible, kept, ecgs in zip(
            self.of("0 feasible"), self.of("0 kept"), self.of("0 in torsos"), strict=True
        ):
            means.append(in_cosines(ecgs[kept[feasible]].astype(float)).mean(axis=0).ravel())
        centred = np.array(means) - np.mean(means, axis=0)
        left, sizes, _ = np.linalg.svd(centred, full_matrices=False)
        count = min(INPUTS, len(sizes))
        tissues = tissue_inputs(AveragedOver(tissues=TISSUES), PLAIN_RATIO)
        return np.column_stack(
            [
                left[:, :count] * np.sqrt(len(left) * sizes[:count] / sizes[0]),
                tissues[[heart.tissue for heart in self.hearts]],
            ]
        )

    def examples(self, state: int, rng: np.random.Generator) -> Examples:
        """Prior simulations of a conduction state in all hearts, in random order."""
        count, points, torsos = len(self.hearts), [], []
        for number, (of_heart, which) in enumerate(
            zip(self.of(f"{state} points"), self.of(f"{state} torsos"), strict=True)
        ):
            place = np.full((len(of_heart), 1), (number + 0.5) / count)
            points.append(np.hstack([of_heart, place]))
            torsos.append(TORSOS * number + which)
        feasible = np.concatenate(self.of(f"{state} feasible"))
        order = rng.permutation(len(feasible))
        ecg = (np.cumsum(feasible) - 1)[order][feasible[order]]
        held_out = ecg[(np.arange(len(order)) % HELD_OUT == HELD_OUT - 1)[feasible[order]]]
        return Examples(
            np.concatenate(points)[order],
            feasible[order],
            np.concatenate(self.of(f"{state} kept"))[order],
            np.concatenate(self.of(f"{state} ecgs"))[ecg].astype(np.float32),
            np.concatenate(self.of(f"{state} in torsos"))[held_out].astype(np.float32),
            np.concatenate(torsos)[held_out],
        )


def learn(out: Path) -> None:
    """Write the atlas into the package, and train its emulators and its classifier."""
    simulated = Simulated.read(out)
    heart = load_heart(out / "template")
    assert heart.lead_fields is not None
    fields = replace(heart.lead_fields, torso="")  # the standard torso, which can be meshed again
    packaged = replace(heart, torso=None, lead_fields=fields, atlas=simulated.atlas, sheets=None)
    write_heart(packaged, out / "atlas")
    for file in (out / "atlas").iterdir():  # beside a file that says where the mesh is from
        if file.is_file():
            shutil.copy(file, PACKAGE / "hearts" / "atlas" / file.name)
    heart = load_heart("atlas")
    model = ForwardModel(heart)
    states = simulations_of_states(model, usual_prior(heart), out, COUNT)
    priors = {name: of_state.simulations.prior for name, of_state in states.items()}
    for name, emulator in emulators_of(simulated, priors).items():
        report = {**emulator.report, "networks": float(COUNT)}
        arrays = replace(emulator, report=report).arrays()
        content = states[name].simulations.content
        put("emulator", content, {k: np.asarray(v) for k, v in arrays.items()})
        print(f"{name}: {emulator.summary}", flush=True)
    learn_ectopic(out, model, simulated)
    classifier = learn_states(simulated, len(states))
    print(f"classifier: {classifier.accuracy:.0%} of held-out recordings told right")
    arrays = {**classifier.arrays(), "networks": np.array(COUNT)}
    put("classifier", classifier_key(states, np.array(INDEPENDENT_ROWS)), arrays)


def emulators_of(simulated: Simulated, priors: Mapping[str, Prior]) -> dict[str, EcgEmulator]:
    """Emulators of the states: one that has the state as an input, with that input fixed.

    States share what hearts do to the ECG, and the rarer ones have few networks of each heart.
    """
    rng, hearts, one_hot = np.random.default_rng(SEED), simulated.inputs(), np.eye(len(priors))
    parts = [simulated.examples(index, rng) for index in range(len(priors))]
    pairs = [*zip(priors.values(), parts, strict=True)]
    values = [emulated_quantities(prior, part.points) for prior, part in pairs]
    tissues = [hearts[prior.tissue(part.points)] for prior, part in pairs]
    examples, order = joined_examples(parts, rng)
    states = np.repeat(one_hot, [len(part.points) for part in parts], axis=0)
    ranges = [ranges_of(prior) for prior in priors.values()]
    began = time.perf_counter()

    def progress(stage: str, done: int, total: int, message: str = "") -> None:
        if done % 1000 < 50:
            print(f"  {stage} {done}/{total}, {time.perf_counter() - began:.0f} s", flush=True)

    emulator = learn_quantities(
        examples,
        {name: np.concatenate([v[name] for v in values])[order] for name in values[0]},
        np.hstack([np.concatenate(tissues), states])[order],
        {
            name: (min(r[name][0] for r in ranges), max(r[name][1] for r in ranges))
            for name in values[0]
        },
        rng,
        progress=progress,
        epochs=EPOCHS,
    )
    emulators = {}
    for name, part, of_state, of_heart, state in zip(
        priors, parts, values, tissues, one_hot, strict=True
    ):
        last = np.arange(len(emulator.centre) - len(state), len(emulator.centre))
        fixed = replace(emulator.with_fixed_inputs(last, state), hearts=hearts)
        emulators[name] = with_residuals(fixed, part.of_the_prior, fixed.inputs(of_state, of_heart))
    return emulators


def joined_examples(
    parts: Sequence[Examples], rng: np.random.Generator
) -> tuple[Examples, NDArray[np.intp]]:
    """Examples of all parts in random order, and that order; the same ones are held out."""
    begins = np.cumsum([0, *(len(part.points) for part in parts)])
    # rows of ten, of which the last is held out; what is left at the end of a part is left out
    rows = [
        begin + np.arange(len(part.points) // HELD_OUT * HELD_OUT).reshape(-1, HELD_OUT)
        for begin, part in zip(begins, parts, strict=False)
    ]
    order = rng.permutation(np.concatenate(rows)).ravel()
    feasible = np.concatenate([part.feasible for part in parts])
    held_out = np.concatenate([part.held_out for part in parts])
    ecg, torso = np.cumsum(feasible) - 1, np.cumsum(feasible & held_out) - 1
    chosen = order[feasible[order]]
    in_torsos = torso[chosen[held_out[chosen]]]
    ecgs, of_torsos, torsos = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("ecgs", "in_torsos", "torsos")
    )
    return Examples(
        np.concatenate([part.points for part in parts])[order],
        feasible[order],
        np.concatenate([part.kept for part in parts])[order],
        ecgs[ecg[chosen]],
        of_torsos[in_torsos],
        torsos[in_torsos],
    ), order


def learn_ectopic(out: Path, model: ForwardModel, simulated: Simulated) -> None:
    """Train the classifier of origins on beats from anywhere in all hearts, if they are there.

    Beats of every tenth heart are held out. The probabilities are those of the power 1 /
    `ORIGIN_TEMPERATURE`, so that regions hold the origin in hearts that are none of the atlas's.
    """
    count = len(simulated.hearts)
    paths = sorted(out.glob("ectopic-*.npz"))
    if len(paths) < count:
        print(f"origins: beats of {len(paths)} of {count} hearts; not learnt")
        return
    parts: dict[str, list[NDArray[Any]]] = {}
    for number, path in enumerate(paths):
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        feasible = arrays.pop("feasible")
        place = np.full((len(feasible), 1), (number + 0.5) / count)
        arrays["points"] = np.hstack([arrays["points"], place])[feasible]
        arrays["origins"] = arrays["origins"][feasible]
        arrays["torsos"] = arrays["torsos"] + TORSOS * number
        arrays["held out"] = np.full(feasible.sum(), number % HELD_OUT == HELD_OUT - 1)
        for name, values in arrays.items():
            parts.setdefault(name, []).append(values)
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    rng, rows = np.random.default_rng(SEED), np.array(INDEPENDENT_ROWS)
    # rows of ten beats, of which the last is held out
    training, held_out = (
        rng.permutation(np.flatnonzero(joined["held out"] == of)) for of in (False, True)
    )
    tens = min(len(training) // (HELD_OUT - 1), len(held_out))
    training, held_out = training[: tens * (HELD_OUT - 1)], held_out[:tens]
    order = np.hstack([training.reshape(tens, -1), held_out[:, None]]).ravel()
    all_of_them = np.ones(len(order), bool)
    examples = Examples(
        joined["points"][order], all_of_them, all_of_them,
        joined["ecgs"][order].astype(np.float32),
        joined["in_torsos"][held_out].astype(np.float32), joined["torsos"][held_out],
    )  # fmt: skip
    arrays = learn_origins(
        model.heart, examples, joined["origins"][order], rows, rng, temperature=ORIGIN_TEMPERATURE
    )
    print(f"origins: {arrays['distance']:.1f} mm, {arrays['region']:.0%} in the 90 % region")
    key = origin_key(ectopic_beats(model, out), rows)
    put("origin", key, {**arrays, "networks": np.array(COUNT)})


def learn_states(simulated: Simulated, states: int, count: int = 40_000) -> EcgClassifier:
    """Classifier of conduction states; a tenth of the networks is held out."""
    rng, rows = np.random.default_rng(SEED), np.array(INDEPENDENT_ROWS)
    recorder = Recorder.of(simulated.examples(0, rng).of_the_prior)
    sets: dict[bool, list[tuple[NDArray[np.float32], int]]] = {False: [], True: []}
    for state in range(states):
        for held_out in (False, True):
            ecgs = []
            for arrays in simulated.arrays:
                kept = np.flatnonzero(arrays[f"{state} kept"][arrays[f"{state} feasible"]])
                chosen = kept[(np.arange(len(kept)) % HELD_OUT == HELD_OUT - 1) == held_out]
                ecgs.append(arrays[f"{state} in torsos"][chosen])
            of_state = np.concatenate(ecgs).astype(np.float32)
            if not held_out:
                of_state = of_state[np.resize(rng.permutation(len(of_state)), count)]
            parts = np.array_split(of_state, max(1, len(of_state) // 4000))
            recorded = [recorder.recorded(part, rng, in_torsos=True) for part in parts]
            sets[held_out].append((in_leads(rows) @ np.concatenate(recorded), state))
    training, testing = (
        RecordingSet(
            np.concatenate([recordings for recordings, _ in sets[held_out]]),
            np.concatenate(
                [
                    np.tile(np.eye(states, dtype=np.float32)[k], (len(recordings), 1))
                    for recordings, k in sets[held_out]
                ]
            ),
        )
        for held_out in (False, True)
    )
    return learn_classifier(training, testing, rows, rng, steps=16_000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("step", choices=("template", "simulate", "ectopic", "learn"))
    parser.add_argument("--surface", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--hearts", type=int, default=64)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.step == "template":
        template(options.surface, options.out)
        return
    if options.step == "learn":
        learn(options.out)
        return
    numbers = range(options.hearts)
    hearts = zip(numbers, drawn_hearts(SEED, len(TISSUES)), strict=False)
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        if options.step == "simulate":
            runs = [pool.submit(simulate, number, options.out, heart) for number, heart in hearts]
        else:
            runs = [pool.submit(ectopic, number, options.out) for number in numbers]
        for run in runs:
            print(run.result(), flush=True)


if __name__ == "__main__":
    main()
