"""What an adult trunk is scaled by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fascicle.core.errors import InputError

HEIGHT, WEIGHT = 1.70, 66.5  # m, kg

GIRTH = 14.7  # cm: girth of the chest divided by the square root of (kg by m)

HEIGHTS, WEIGHTS, GIRTHS = (1.2, 2.3), (25.0, 250.0), (50.0, 180.0)  # m, kg, cm: of adults

DEPTH_TO_WIDTH = 0.70

FACTORS = (0.5, 2.0)  # on the standard adult's shape

SQUARENESS = 2.4  # exponent of the superellipse that is the outline; 2 is an ellipse

V1_LEVEL = 0.735  # of the height

SHAPE = ("depth", "shoulders", "hips")
MM_PER_M, MM_PER_CM = 1000, 10
OUTLINE_POINTS = 721  # on which its length is measured
LEAST_HEIGHT = 1e-3  # m, against division by zero; the range refuses such heights


@dataclass(frozen=True)
class BodySize:
    """What an adult trunk is scaled by.

    Attributes
    ----------
    height : float
        Standing height (m).
    weight : float
        Body weight (kg).
    chest : float, optional
        Girth of the chest at the level of the nipples (cm); from height and weight if not given.
    depth, shoulders, hips : float
        Factors on the standard adult's depth by width of the chest, and on the width of shoulders
        and hips.

    Raises
    ------
    InputError
        If a value is not one of an adult.
    """

    height: float = HEIGHT
    weight: float = WEIGHT
    chest: float | None = None
    depth: float = 1.0
    shoulders: float = 1.0
    hips: float = 1.0

    def __post_init__(self) -> None:
        for name, value, (low, high), unit in (
            ("height", self.height, HEIGHTS, "m"),
            ("weight", self.weight, WEIGHTS, "kg"),
            ("chest girth", self.girth, GIRTHS, "cm"),
            *((name, getattr(self, name), FACTORS, "times") for name in SHAPE),
        ):
            if not low <= value <= high:
                raise InputError(
                    f"torso: {name} {value:.4g} {unit} is not that of an adult; "
                    f"give {low:g} to {high:g} {unit}"
                )

    @property
    def girth(self) -> float:
        """Girth of the chest (cm)."""
        if self.chest is not None:
            return self.chest
        return GIRTH * float(np.sqrt(max(self.weight, 0) / max(self.height, LEAST_HEIGHT)))

    @cached_property
    def half_width(self) -> float:
        """Of the chest's outline at the level of V1 (mm)."""
        angle = np.linspace(0, 2 * np.pi, OUTLINE_POINTS)
        outline = np.stack([np.cos(angle), np.sin(angle)])
        outline = np.sign(outline) * np.abs(outline) ** (2 / SQUARENESS)
        outline[1] *= self.depth * DEPTH_TO_WIDTH
        perimeter = np.linalg.norm(np.diff(outline), axis=0).sum()
        return float(MM_PER_CM * self.girth / perimeter)

    @property
    def half_depth(self) -> float:
        """Of the chest's outline at the level of V1 (mm)."""
        return self.depth * DEPTH_TO_WIDTH * self.half_width

    def level(self, fraction: float) -> float:
        """Height z in the body frame (mm) of a fraction of the standing height."""
        return MM_PER_M * self.height * (fraction - V1_LEVEL)
