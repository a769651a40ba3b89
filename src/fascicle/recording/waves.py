"""The waves of the QRS of one lead, its R peak and its notches."""

from __future__ import annotations

from functools import cached_property
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Floats

# Smallest wave of IEC 60601-2-51:2003, annex GG.5, and smallest notch: its least height (mV), the
# time (ms) that it must have this height, and its duration from end to end (ms)
LEAST_HEIGHT, LEAST_TIME, LEAST_DURATION = 0.03, 6, 12
CAPITAL = 0.5  # mV from which a wave has a capital letter: 5 mm on paper


class Wave(NamedTuple):
    """A wave: first and last sample (ms from the onset), and its height (mV)."""

    start: int
    end: int
    height: float


class Qrs:
    """QRS (n,), mV, of a lead, every 1 ms from the global onset."""

    def __init__(self, qrs: Floats) -> None:
        self.potential = qrs

    @cached_property
    def waves(self) -> list[Wave]:
        """Waves Q, R, S and so on; one that returns to the level without crossing it is notched."""
        side = np.where(np.abs(self.potential) >= LEAST_HEIGHT, np.sign(self.potential), 0.0)
        waves: list[Wave] = []
        for sign, run in groupby(range(len(side)), key=side.__getitem__):
            samples = list(run)
            height = float(sign * (sign * self.potential[samples]).max())
            # an ST segment that is off the level only leads away from it, and is no wave
            returns = sign * (height - self.potential[-1]) >= LEAST_HEIGHT
            if not sign or len(samples) < LEAST_TIME or not returns:
                continue
            start = samples[0]
            if waves and waves[-1].height * sign > 0:
                before = waves.pop()
                start, height = before.start, max(before.height, height, key=abs)
            waves.append(Wave(start, samples[-1], height))
        return waves

    @property
    def signs(self) -> str:
        """Whether each wave is above or below the level: ``+-`` for rS, RS and Rs."""
        return "".join("+" if wave.height > 0 else "-" for wave in self.waves)

    @property
    def pattern(self) -> str:
        """Waves in letters, such as rSR'."""
        letters: list[str] = []
        for wave in self.waves:
            seen = "".join(letters).lower()
            letter = "r" if wave.height > 0 else "s" if "r" in seen else "q"
            capital = abs(wave.height) >= CAPITAL
            letters.append((letter.upper() if capital else letter) + "'" * seen.count(letter))
        return "QS" if self.signs == "-" else "".join(letters) or "no wave"

    @property
    def r_peak(self) -> float:
        """Time (ms) of the R peak; NaN without one.

        The peak is that of the last wave above the level, R or R'; of a notched wave, its last peak
        that is at least half as high as the wave.
        """
        above = [wave for wave in self.waves if wave.height > 0]
        if not above:
            return np.nan
        from scipy.signal import find_peaks  # loads scipy.stats

        peaks, _ = find_peaks(self.potential, above[-1].height / 2, prominence=LEAST_HEIGHT)
        peaks = peaks[(peaks >= above[-1].start) & (peaks <= above[-1].end)]
        return float(peaks[-1]) if len(peaks) else np.nan

    def notches(self, sign: int) -> list[int]:
        """Times (ms) of notches and slurs in the waves above (1) or below (-1) the level.

        But for its feet a smooth wave is concave. A notch or slur is where it departs from the
        tangent that bridges it, as far and as long as the smallest wave.
        """
        times = []
        for wave in (wave for wave in self.waves if wave.height * sign > 0):
            curve = sign * self.potential[wave.start : wave.end + 1]
            curve = np.pad(curve, 1, constant_values=-abs(wave.height))
            time = np.arange(len(curve))
            hull = np.sort(ConvexHull(np.column_stack([time, curve])).vertices)
            hull = hull[2:-2]  # without the ends of the wave, and so without its feet
            for first, last in pairwise(hull):
                bridge = np.interp(time, [first, last], curve[[first, last]])
                inside = (bridge - curve)[first : last + 1]
                if last - first >= LEAST_DURATION and (inside >= LEAST_HEIGHT).sum() >= LEAST_TIME:
                    times.append(wave.start - 1 + int(first + np.argmax(inside)))
        return times

    @property
    def is_qr(self) -> bool:
        """Whether a q is followed by a larger R, and no other wave."""
        return self.signs == "-+" and self.waves[1].height > -self.waves[0].height

    @property
    def is_rs(self) -> bool:
        """Whether an r is followed by a larger S, and no other wave."""
        return self.signs == "+-" and self.waves[0].height < -self.waves[1].height
