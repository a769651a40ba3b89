"""Hearts, torsos and poses of the adult population, from which the atlas is drawn.

The figures are those of docs/quantities.md, which gives their sources.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import exp, sqrt
from typing import Any, Literal, get_args

import numpy as np
from scipy.special import ndtri

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.ranges import shown, within
from fascicle.heart.heart import Atlas, Heart
from fascicle.torso.trunk import TrunkSize

Sex = Literal["f", "m"]
KNOWN = ("sex", "age", "height", "weight")  # what may be known of a person
DISEASED = 0.65  # dilated and hypertrophied hearts: frequency among people, over the atlas's
RESIDUAL = 0.15  # SD of the logarithm of volumes and mass between people of one sex and build
# Range of the height, from apex (0) to base (1), up to which the free walls have Purkinje fibres.
# The base has none, and is activated last (Durrer et al., Circulation 41:899, 1970).
NETWORK_HEIGHTS = (0.65, 0.85)


@dataclass(frozen=True)
class HeartSize:
    """Size and proportions of the ventricles at the end of diastole.

    Attributes
    ----------
    lv_volume, rv_volume : float
        Volumes of the cavities (ml).
    lv_mass : float
        Mass of the left ventricle, the whole septum included (g).
    elongation : float
        Factor on the ratio of the left ventricle's length to its diameter in the template.
    rv_wall : float
        Factor on the thickness of the right ventricle's free wall in the template.
    """

    lv_volume: float
    lv_mass: float
    rv_volume: float
    elongation: float = 1.0
    rv_wall: float = 1.0


@dataclass(frozen=True)
class Build:
    """Sex, age (years), height (cm) and weight (kg) of an adult."""

    sex: Sex
    age: float
    height: float
    weight: float

    @property
    def surface(self) -> float:
        """Body surface area (m²), by Mosteller."""
        return sqrt(self.height * self.weight / 3600)

    @property
    def mass_index(self) -> float:
        """Body mass index (kg/m²)."""
        return self.weight / (self.height / 100) ** 2

    @property
    def expected(self) -> HeartSize:
        """Median volumes and mass of healthy ventricles."""
        volume, mass, ratio = (85.0, 53.0, 1.10) if self.sex == "m" else (74.0, 42.0, 1.05)
        older = exp(-0.004 * (self.age - 60))
        lv_volume = volume * self.surface * older
        return HeartSize(lv_volume, mass * self.surface, ratio * lv_volume)

    @property
    def elevation(self) -> float:
        """Median angle of the long axis below the horizontal plane (degrees)."""
        vertical = 2.0 if self.sex == "f" else 0.0
        return 28.0 + vertical - (self.mass_index - 25) - 0.1 * (self.age - 50)


@dataclass(frozen=True)
class AtlasHeart:
    """Description of a heart of the atlas, and of the torso that it lies in.

    Attributes
    ----------
    build : Build
        The person.
    size : HeartSize
        Ventricles.
    axis : (3,) array
        Azimuth, elevation and roll of the heart, as in
        `fascicle.torso.heart_pose.standard_axes` (degrees).
    shift : (3,) array
        Shift of the heart to the left, back and up from its default position (mm).
    trunk : (3,) array
        Factors on depth, shoulders and hips of the standard adult.
    tissue : int
        Number of the tissue, of `fascicle.networks.prior.TISSUES`.
    """

    build: Build
    size: HeartSize
    axis: Floats
    shift: Floats
    trunk: Floats
    tissue: int

    @property
    def trunk_size(self) -> TrunkSize:
        """Measures of the torso."""
        depth, shoulders, hips = self.trunk
        return TrunkSize(self.build.height / 100, self.build.weight, None, depth, shoulders, hips)


def drawn_hearts(seed: int, tissues: int) -> Iterator[AtlasHeart]:
    """Draw hearts of the population without end, evenly spread (Sobol points).

    Dilated and hypertrophied hearts are more frequent than among people (three in ten), so that
    there are some of them; ages are spread evenly from 18 to 90 years.
    """
    from scipy.stats import qmc  # takes long to load

    points = qmc.Sobol(20, rng=np.random.default_rng(seed))
    number = 0
    while True:
        for point in points.random(64):
            yield _heart_at(np.clip(point, 1e-4, 1 - 1e-4), number % tissues)
            number += 1


def _heart_at(
    point: Floats, tissue: int, known: Mapping[str, float] | None = None, diseased: float = 1.0
) -> AtlasHeart:
    """Heart at a point (20,) of the unit cube, of a person of whom some of the build is `known`.

    `diseased` is a factor on the frequency of dilated and hypertrophied hearts.
    """
    normal = np.clip(ndtri(point), -2.5, 2.5)
    build = _build_at(point[0], point[1], normal[2], normal[3], known or {})
    expected = build.expected
    with_volume = normal[4]
    with_mass = 0.65 * normal[4] + sqrt(1 - 0.65**2) * normal[5]
    lv_volume = expected.lv_volume * exp(RESIDUAL * with_volume)
    lv_mass = expected.lv_mass * exp(RESIDUAL * with_mass)
    rv_volume = lv_volume * expected.rv_volume / expected.lv_volume * exp(0.10 * normal[6])
    elongation, rv_wall = exp(0.07 * normal[7]), exp(0.15 * normal[8])
    severity, kind = point[9], point[10] / diseased
    if kind < 0.09:  # eccentric hypertrophy
        lv_mass *= exp(0.20 + 0.30 * severity)
        lv_volume *= exp(0.05 + 0.20 * severity)
    elif kind < 0.18:  # concentric hypertrophy
        lv_mass *= exp(0.20 + 0.40 * severity)
        lv_volume *= exp(-0.10 * severity)
    elif kind < 0.28:  # dilated
        lv_volume *= exp(0.25 + 0.55 * severity)
        lv_mass *= exp(0.20 + 0.40 * severity)
        rv_volume *= exp(0.40 * severity)
        elongation *= exp(-0.05 - 0.10 * severity)
    elif kind < 0.31:  # right ventricle dilated or hypertrophied
        rv_volume *= exp(0.20 + 0.40 * severity)
        rv_wall *= exp(0.10 + 0.40 * severity)
    # the variations of its torso, in which a heart is simulated, turn and move it further
    axis = np.array([45.0 + 7.0 * normal[11], build.elevation + 7.0 * normal[12], 8.0 * normal[13]])
    axis[1] = np.clip(axis[1], 5.0, 60.0)
    shift = np.array([7.0, 8.0, 12.0]) * normal[14:17]
    trunk = np.exp([0.06, 0.05, 0.05] * normal[17:20])
    size = HeartSize(lv_volume, lv_mass, rv_volume, elongation, rv_wall)
    return AtlasHeart(build, size, axis, shift, trunk, tissue)


def _build_at(
    sex: float, age: float, height: float, mass_index: float, known: Mapping[str, float]
) -> Build:
    """Build at quantiles of sex and age, and normal scores of height and body mass index.

    What is `known` replaces these: age, height (cm), weight (kg), and sex (0 female, 1 male).
    """
    female = known.get("sex", float(sex >= 0.5)) == 0
    years = known.get("age", 18.0 + 72.0 * age)
    older = 0.015 * (min(years, 65.0) - 50) / 10
    if female:
        centimetres = 165.0 - 0.08 * (years - 50) + 6.3 * height
        index = 25.3 * exp(older + 0.19 * mass_index)
    else:
        centimetres = 178.0 - 0.10 * (years - 50) + 7.0 * height
        index = 26.3 * exp(older + 0.15 * mass_index)
    centimetres = known.get("height", centimetres)
    weight = known.get("weight", index * (centimetres / 100) ** 2)
    return Build("f" if female else "m", years, centimetres, weight)


def for_person(heart: Heart, person: Mapping[str, Any]) -> Heart:
    """Atlas with prior probabilities of its hearts for a person.

    Parameters
    ----------
    heart : Heart
        The atlas.
    person : mapping of str to value
        `KNOWN` by name: sex (``"f"`` or ``"m"``), age (years), height (cm), weight (kg); None where
        it is not known.

    Raises
    ------
    InputError
        If the heart is no atlas, or a value is not an adult's.
    """
    if heart.atlas is None:
        given = next(name for name, value in person.items() if value is not None)
        raise InputError(
            f"{given}: {heart.name} is one heart, and only the hearts of 'atlas' depend on it; "
            "leave it out"
        )
    known = {}
    for name, value in person.items():
        if value is None:
            continue
        if name == "sex":
            if value not in get_args(Sex):
                raise InputError(f"sex is {shown(value)}; give f or m")
            known["sex"] = float(value == "m")
        else:
            known[name] = within(name, value, name)
    weights = weights_for(heart.atlas, known)
    return replace(heart, atlas=replace(heart.atlas, weights=weights, person=known))


def weights_for(atlas: Atlas, known: Mapping[str, float], fewest: float = 24.0) -> Floats:
    """Prior probabilities (k,) of the hearts of an atlas for a person of known build.

    The density of the ventricles' volumes, the left mass, the elevation of the heart and the
    person's height and girth among such people, over that among the hearts that were drawn, both
    taken for normal distributions (of logarithms). It is raised to the largest power up to 1 that
    leaves at least `fewest` hearts effective: a library has no more of one kind.
    """
    rng = np.random.default_rng(0)
    points = np.clip(rng.random((2000, 20)), 1e-4, 1 - 1e-4)
    drawn, wanted = (
        _descriptors(measures_of([_heart_at(point, 0, *options) for point in points]))
        for options in ((), (known, DISEASED))
    )
    described = _descriptors(atlas.measures)
    # a floor for what is known exactly, as height: hearts of the library differ in it
    floor = np.diag((0.5 * drawn.std(axis=0)) ** 2)
    logs = _log_density(described, wanted, floor) - _log_density(described, drawn, 0 * floor)
    logs -= logs.max()

    def weights(power: float) -> Floats:
        unnormalised = np.exp(power * logs)
        return np.asarray(unnormalised / unnormalised.sum())

    fewest = min(fewest, 0.9 * len(logs))
    powers = np.linspace(1, 0, 101)
    enough = (power for power in powers if 1 / (weights(power) ** 2).sum() >= fewest)
    return weights(next(enough))


def measures_of(hearts: Iterable[AtlasHeart]) -> dict[str, Floats]:
    """Measures (n,) of hearts by name, as in `fascicle.heart.heart.Atlas.measures`."""
    measures: dict[str, list[float]] = {}
    for heart in hearts:
        azimuth, elevation, roll = heart.axis
        values = {**vars(heart.build), **vars(heart.size)}
        values |= {"azimuth": azimuth, "elevation": elevation, "roll": roll}
        for name, value in (values | {"sex": heart.build.sex == "m"}).items():
            measures.setdefault(name, []).append(float(value))
    return {name: np.array(values) for name, values in measures.items()}


def _descriptors(measures: Mapping[str, Floats]) -> Floats:
    """Logarithms of volumes, mass, height and girth, and the elevation (n, 6)."""
    volumes = [np.log(measures[name]) for name in ("lv_volume", "lv_mass", "rv_volume")]
    elevation, height = measures["elevation"] / 60, np.log(measures["height"])
    girth = np.log(measures["weight"] / measures["height"]) / 2
    return np.column_stack([*volumes, elevation, height, girth])


def _log_density(points: Floats, sample: Floats, floor: Floats) -> Floats:
    """Log-density (n,) of points under the normal distribution of a sample."""
    covariance = np.cov(sample, rowvar=False) + floor
    apart = points - sample.mean(axis=0)
    squares = (apart * np.linalg.solve(covariance, apart.T).T).sum(axis=1)
    return np.asarray(-0.5 * (squares + np.linalg.slogdet(covariance)[1]))
