"""Origin of an ectopic or paced beat, from its ECG.

Beats of the prior begin anywhere in the ventricles, with equal probability per volume; the Purkinje
network does not fire, and conducts where the activation front enters it. A classifier of such beats
gives the probability of each patch of the tissue to hold the origin of a recorded beat.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.files import DISPOSABLE, ArrayCache, as_path, atomic_folder
from fascicle.core.leads import INDEPENDENT_LEADS
from fascicle.core.parameters import ParameterSpace, free, network_space, ordered_fascicles
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.quantities import SPEED, Changes, quantity
from fascicle.core.ranges import short_repr
from fascicle.emulation.ecg_classifier import (
    LENGTH,
    EcgClassifier,
    Recorder,
    RecordingSet,
    classified_rows,
    in_cosines,
    in_leads,
    learn,
    most_alike,
)
from fascicle.emulation.heart_emulator import for_simulations, learnt_or_made
from fascicle.forward.model import ForwardModel
from fascicle.forward.preparation import compile_kernels
from fascicle.forward.primitives import His, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.heart.fibres import Wall
from fascicle.heart.heart import Heart
from fascicle.heart.sites import SEGMENTS, Places, places
from fascicle.inference.emulator import Singles
from fascicle.mesh.mesh_file import TETRAHEDRON
from fascicle.mesh.vtk import write_grid
from fascicle.networks.prior import AveragedOver, Prior
from fascicle.networks.prior_simulations import HELD_OUT, Examples, PriorSimulations
from fascicle.pools.pool import Pool
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target

BEATS = 16_000  # to learn from
REGION = 0.9  # probability of the credible region
ORIGIN_PICTURE = "origin.png"  # picture that the command draws beside the files


@dataclass(frozen=True)
class EctopicBeats(PriorSimulations):
    """Prior simulations of beats that begin at points of the tissue, drawn uniformly."""

    @cached_property
    def content(self) -> str:
        """Text that identifies all that the simulations depend on."""
        return f"from anywhere; {super().content}"

    def origins(self, number: int) -> Integers:
        """Tetrahedra (`part_size`,) in which the beats of a part begin."""
        volumes = self.model.heart.volumes
        rng = np.random.default_rng([self.seed, number, 4])  # 4: stream of the origins
        # origin of each of ten beats: several share one, since finding the rays from it takes long;
        # the tenth beat, which is held out, has another one
        numbers = [0, 0, 0, 1, 1, 1, 2, 2, 2, 3]
        size = self.part_size // HELD_OUT, max(numbers) + 1
        drawn = rng.choice(len(volumes), size, p=volumes / volumes.sum())
        return np.asarray(drawn[:, numbers].ravel())

    def scenarios(self, number: int) -> Sequence[Scenario | None]:
        """Scenario of each beat of a part: a stimulus at its origin, and no firing His bundle."""
        centres = _centres(self.model.heart)[self.origins(number)].tolist()
        stimuli = [Stimulus(time=0.0, position=(x, y, z)) for x, y, z in centres]
        return [Scenario((His(time=np.inf), stimulus)) for stimulus in stimuli]


@dataclass(frozen=True)
class Origin:
    """Origin of a recorded beat: probability that it lies in each tetrahedron of the heart.

    Attributes
    ----------
    heart : Heart
    probabilities : (n_tetrahedra,) array
        Probability of each tetrahedron of the heart; they add up to 1.
    explained, least_explained : float
        Share of the recorded QRS that the most similar simulated beat explains, scaled; and the
        share that 98 % of simulated recordings reach.
    held_out : mapping of str to float
        Accuracy for held-out simulated beats: "distance", the median distance from the most
        probable place to the origin (mm), and "region", the share whose region holds the origin.
    """

    heart: Heart
    probabilities: Floats
    explained: float
    least_explained: float
    held_out: Mapping[str, float]

    __repr__ = short_repr

    @property
    def caution(self) -> str | None:
        """Reason why the origin cannot be relied on; None if there is none."""
        if self.explained >= self.least_explained:
            return None
        return (
            "no simulated beat looks like the recording (the most similar explains "
            f"{self.explained:.0%} of its QRS, {self.least_explained:.0%} expected)"
        )

    @property
    def verdict(self) -> str:
        """Most probable origin of the beat, in one line."""
        if self.caution is not None:
            return f"no origin is named: {self.caution}"
        statements = [self.heart.no_image, _ranked(self.walls)]
        if segments := _ranked({n: p for n, p in self.segments.items() if n in SEGMENTS}):
            statements.append(f"segments {segments}")
        x, y, z = self.place
        of_mean = "" if self.heart.atlas is None else " of the mean heart"
        return "; ".join(filter(None, statements)) + (
            f"; most probable place {x:.0f}, {y:.0f}, {z:.0f} mm{of_mean}, with {REGION:.0%} "
            f"within {self.radius:.0f} mm of it"
        )

    @cached_property
    def place(self) -> Floats:
        """Centre (3,) (mm) of the tetrahedron with the least expected distance to the origin."""
        return _place(_centres(self.heart), self.probabilities)

    @property
    def radius(self) -> float:
        """Radius (mm) about the most probable place that holds the probability `REGION`."""
        distances = np.linalg.norm(_centres(self.heart) - self.place, axis=1)
        order = np.argsort(distances)
        within = np.cumsum(self.probabilities[order]) < REGION
        return float(distances[order[within]].max(initial=0.0))

    @cached_property
    def levels(self) -> Floats:
        """Credible level (n,): total probability of tetrahedra more probable per volume."""
        return levels(self.probabilities, self.heart.volumes)

    @property
    def region(self) -> Booleans:
        """The smallest part of the tissue that holds the probability `REGION`."""
        return self.levels < REGION

    @cached_property
    def _places(self) -> Places:
        return places(self.heart)

    @property
    def ventricles(self) -> dict[str, float]:
        """Probability of each ventricle; each has the half of the septum that is nearer to it."""
        anatomy, septum = self._places, self._places.wall == Wall.SEPTUM
        right = (anatomy.wall == Wall.RV) | (septum & (anatomy.depth > 0.5))
        return self._by_part({"left ventricle": ~right, "right ventricle": right})

    @property
    def walls(self) -> dict[str, float]:
        """Probability of the free walls and of the septum."""
        names = {
            "left ventricular free wall": Wall.LV,
            "right ventricular free wall": Wall.RV,
            "septum": Wall.SEPTUM,
        }
        return self._by_part({name: self._places.wall == wall for name, wall in names.items()})

    @property
    def layers(self) -> dict[str, float]:
        """Probability of the inner and the outer half of the free walls, and of the septum."""
        septum, inner = self._places.wall == Wall.SEPTUM, self._places.depth < 0.5
        return self._by_part(
            {"endocardial half": ~septum & inner, "epicardial half": ~septum & ~inner,
             "septum": septum}
        )  # fmt: skip

    @property
    def segments(self) -> dict[str, float]:
        """Probability of the left ventricle's 17 segments and of the right one's free wall."""
        names = ("right ventricular free wall", *SEGMENTS)
        return self._by_part({name: self._places.segment == k for k, name in enumerate(names)})

    def _by_part(self, parts: Mapping[str, Any]) -> dict[str, float]:
        return {name: float(self.probabilities[inside].sum()) for name, inside in parts.items()}

    def summary(self) -> dict[str, Any]:
        """All results but the probabilities of the tetrahedra."""
        tables = {n: getattr(self, n) for n in ("ventricles", "walls", "layers", "segments")}
        return {
            "verdict": self.verdict,
            "caution": self.caution,
            "place_mm": self.place.tolist(),
            "radius_mm": self.radius,
            "region_ml": float(self.heart.volumes[self.region].sum() / 1000),
            "explained": self.explained,
            "least_explained": self.least_explained,
            "held_out": dict(self.held_out),
            **tables,
        }

    def save(self, folder: Path | str) -> Path:
        """Write ``origin.json`` and, for ParaView, ``origin.vtu`` into a folder of their own."""
        folder = as_path(folder, "folder")
        with atomic_folder(folder, disposable=[ORIGIN_PICTURE]) as temporary:
            text = json.dumps(self.summary(), indent=2)
            (temporary / "origin.json").write_text(text + "\n", encoding="utf-8")
            data = {
                "probability_per_ml": 1000 * self.probabilities / self.heart.volumes,
                "credible_level": self.levels,
            }
            heart = self.heart
            path = temporary / "origin.vtu"
            write_grid(path, heart.vertices, heart.tetrahedra, TETRAHEDRON, cell_data=data)
        return folder


def locate(
    heart: Heart | Path | str,
    target: Target | Path | str,
    *,
    prior_simulations: int | None = None,
    workers: int | None = None,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
) -> Origin:
    """Locate the origin of an ectopic or paced beat, with a probability of every place.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    target : Target or path
        The beat, of one class: `fascicle.make_target` chooses it.
    prior_simulations : int, optional
        Number of beats to learn from, simulated once for all recordings of a heart and kept in its
        folder; by default 16,000.
    workers : int, optional
        Simulations at a time; by default one a core.
    progress : Progress, "lines" or None
        Progress callback, called with the stage and how far it is.
    pool : Pool, optional
        Where beats are simulated, as in `fascicle.fit`.

    Returns
    -------
    Origin

    Raises
    ------
    InputError
        If the heart or the target cannot be used.

    Examples
    --------
    >>> import fascicle
    >>> origin = fascicle.locate("HEART", "ectopic.nc")  # doctest: +SKIP
    >>> origin.verdict, origin.segments  # doctest: +SKIP
    """
    heart, folder, count, pool = for_simulations(
        heart, prior_simulations, "prior_simulations", workers, pool, BEATS
    )
    target = as_target(target)
    with shown_progress(progress) as shown:
        compile_kernels(shown)
        beats = ectopic_beats(ForwardModel(heart, progress=shown), folder)
        classifier = classifier_of(beats, classified_rows(target), count, pool, shown)
    return classifier.origin(heart, target)


def ectopic_beats(model: ForwardModel, folder: Path) -> EctopicBeats:
    """Prior simulations of beats that begin anywhere, in networks within the paper's ranges.

    The network need not give a normal activation sequence: it only conducts where the front enters
    it. Quantities that change the ECG's sources are not varied.
    """
    heart = model.heart
    speed = [] if {*SPEED} & {*heart.values} else [free("alpha")]
    space = ordered_fascicles(ParameterSpace((*network_space().parameters, *speed)))
    averaged = AveragedOver.of(space, {}, heart)
    not_of_sources = (
        p for p in averaged.space.parameters if quantity(p.name).changes != Changes.SOURCES
    )
    averaged = replace(averaged, space=ParameterSpace(tuple(not_of_sources)))
    prior = Prior(space, averaged=averaged)
    return EctopicBeats(model, prior, ArrayCache(folder / DISPOSABLE, "prior"))


@dataclass(frozen=True)
class OriginClassifier:
    """Classifier of origins, with simulated beats to detect a recording that is unlike them."""

    classifier: EcgClassifier
    patches: Floats  # (c, 3) centres of the patches (mm)
    reference: Floats  # (n, r, COSINES) simulated beats, to compare with a recording
    least_explained: float
    held_out: Mapping[str, float]

    def origin(self, heart: Heart, target: Target) -> Origin:
        """Locate the origin of a recorded beat."""
        recording = self.classifier.cosines(target)
        return Origin(
            heart,
            of_tetrahedra(heart, self.patches, self.classifier.of_cosines(recording))[0],
            float(most_alike(recording, self.reference)[0]),
            self.least_explained,
            self.held_out,
        )


def classifier_of(
    beats: EctopicBeats, rows: Integers, count: int, pool: Pool, progress: Progress | None = None
) -> OriginClassifier:
    """Classifier of beats that begin anywhere, by the leads `rows`; trained if it is missing."""

    def make() -> Mapping[str, Any]:
        beats.simulate(count, pool, progress)
        numbers = range(-(-count // beats.part_size))
        origins = np.concatenate([beats.origins(number) for number in numbers])
        rng = np.random.default_rng(beats.seed)
        return learn_origins(
            beats.model.heart, beats.examples(count, LENGTH), origins, rows, rng, progress
        )

    folder = beats.cache.folder.parent
    stored = learnt_or_made("origin", classifier_key(beats, rows), count, folder, make)
    return OriginClassifier(
        EcgClassifier.from_arrays(stored),
        stored["patches"],
        stored["reference"].astype(float),
        float(stored["least_explained"]),
        {name: float(stored[name]) for name in ("distance", "region")},
    )


def classifier_key(beats: EctopicBeats, rows: Integers) -> str:
    """Text that identifies all that the classifier of beats by the leads `rows` depends on."""
    return f"{rows} of {beats.content}"


def learn_origins(
    heart: Heart,
    examples: Examples,
    origins: Integers,
    rows: Integers,
    rng: np.random.Generator,
    progress: Progress | None = None,
    recording_count: int = 240_000,
    steps: int = 4000,
    temperature: float = 1.0,
) -> dict[str, Any]:
    """Arrays of an `OriginClassifier`, trained on `recording_count` recordings.

    The examples are of beats that begin in the tetrahedra `origins` of the heart, one a point.
    Probabilities are to the power 1 / `temperature`.
    """
    centres, volumes, leads = _centres(heart), heart.volumes, in_leads(rows)
    feasible, held_out = examples.feasible, examples.held_out
    training_origins, held_out_origins = origins[feasible & ~held_out], origins[feasible & held_out]
    # patches of about 600 mm³: clusters of points that are uniform in the tissue
    points = centres[rng.choice(len(volumes), 10_000, p=volumes / volumes.sum())]
    patch_count = max(2, round(volumes.sum() / 600.0))
    patches = kmeans2(points, patch_count, minit="++", rng=rng)[0]
    recorder, independent = Recorder.of(examples), slice(len(INDEPENDENT_LEADS))
    ecgs = examples.ecgs[~held_out[feasible], independent]
    recordings, chosen = recorder.recordings(ecgs, rows, recording_count, rng)
    in_torsos = examples.in_torsos[:, independent]
    held_out_recordings = leads @ recorder.recorded(in_torsos, rng, in_torsos=True)
    classifier = learn(
        RecordingSet(recordings, _patch_weights(patches, centres[training_origins])[chosen]),
        RecordingSet(held_out_recordings, _patch_weights(patches, centres[held_out_origins])),
        rows, rng, progress, steps,
    ).tempered(temperature)  # fmt: skip
    reference = leads @ in_cosines(ecgs[rng.permutation(len(ecgs))[:2000]])
    distance, region = _held_out(
        heart, patches, classifier.of_cosines(held_out_recordings[:300]), held_out_origins
    )
    # 98 % of simulated recordings are as much like a simulated beat
    least_explained = np.quantile(most_alike(held_out_recordings, reference), 0.02)
    return {
        **classifier.arrays(),
        "patches": patches,
        "reference": reference.astype(np.float16),
        "least_explained": np.array(least_explained),
        "distance": np.array(distance),
        "region": np.array(region),
    }


def _held_out(
    heart: Heart, patches: Floats, probabilities: Floats, origins: Integers
) -> tuple[float, float]:
    """Median distance to the origins (mm), and the share of them that the regions hold."""
    centres, located = _centres(heart), of_tetrahedra(heart, patches, probabilities)
    pairs = [*zip(located, origins, strict=False)]
    distances = [np.linalg.norm(_place(centres, p) - centres[origin]) for p, origin in pairs]
    inside = [levels(p, heart.volumes)[origin] < REGION for p, origin in pairs]
    return float(np.median(distances)), float(np.mean(inside))


def _ranked(parts: Mapping[str, float]) -> str:
    """Parts of a probability of 0.05 or more in words, the most probable first."""
    ranked = sorted(parts, key=lambda name: -parts[name])
    return ", ".join(f"{name} {parts[name]:.2f}" for name in ranked if parts[name] >= 0.05)


def _patch_weights(patches: Floats, points: Floats) -> Singles:
    """Weights (n, c) of patches (c, 3) at points (n, 3), normal in the distance (SD 4 mm)."""
    weights = np.exp(-0.5 * (cdist(points, patches) / 4.0) ** 2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float32)


def of_tetrahedra(heart: Heart, patches: Floats, probabilities: Floats) -> Floats:
    """Probabilities (n, m) of tetrahedra from those (n, c) of the patches nearest to them."""
    nearest, volumes = cKDTree(patches).query(_centres(heart))[1], heart.volumes
    patch_volumes = np.maximum(np.bincount(nearest, volumes, len(patches)), 1e-12)
    densities = (probabilities / patch_volumes)[:, nearest] * volumes
    return np.asarray(densities / densities.sum(axis=1, keepdims=True))


def levels(probabilities: Floats, volumes: Floats) -> Floats:
    """Credible level (m,): total probability of the parts that are more probable per volume."""
    order = np.argsort(-probabilities / volumes, kind="stable")
    probability_above = np.empty(len(volumes))
    probability_above[order] = np.cumsum(probabilities[order]) - probabilities[order]
    return probability_above


def _place(centres: Floats, probabilities: Floats) -> Floats:
    """Centre, of those (m, 3) of the tetrahedra, with the least expected distance to the origin."""
    # over the 4000 most probable ones; about 500 of them are candidates, since all take long
    likely = np.argsort(-probabilities)[:4000]
    step = max(1, len(likely) // 500)
    distances = np.linalg.norm(centres[likely[::step], None] - centres[likely], axis=2)
    return np.asarray(centres[likely[::step][np.argmin(distances @ probabilities[likely])]])


def _centres(heart: Heart) -> Floats:
    return np.asarray(heart.vertices[heart.tetrahedra].mean(axis=1))
