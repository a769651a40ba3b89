"""Progress of long runs in plain lines: how far a stage is, and how long it still takes."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from typing import Literal, TextIO

from fascicle.core.progress import Progress, check_progress

Lines = Literal["lines"]  # asks for them, on standard error
# of the stages that are not called by their own names
NAMES = {
    "compilation": "compiling (first run)",
    "template": "cables",
    "preparation": "preparing the heart",
    "repair": "evaluations kept",
    "initial": "Latin hypercube",
    "optimisation": "Bayesian optimisation",
    "prior": "networks of the prior",
    "draws": "drawing from the prior",
    "stored": "evaluations stored before",
    "sampling": "sampling",
    "rejection": "networks accepted",
    "networks": "simulating the networks",
    "workers": "workers of the cluster",
}
ENDS_EARLIER = ("sampling",)  # names of stages whose total is a maximum
STEADY = ("patients",)  # whose steps take long: all that was done says how much time is left
FIRST, EVERY = 2.0, 10.0  # s after which a stage is spoken of in a line, and then again
WINDOW, APART = 60.0, 0.5  # s, whose work says how much time is left, and between its reports
FEWEST = 5.0  # s of work before anything is said of that
LONG = 10  # min, from which on seconds are not spoken of


@contextmanager
def shown_progress(wanted: Progress | Lines | None) -> Iterator[Progress | None]:
    """Give the progress callback that a caller of the Python interface asks for.

    Parameters
    ----------
    wanted : Progress, "lines" or None
        A callback; lines on standard error, while the context lasts; or nothing.
    """
    shown = progress_of(wanted)
    try:
        yield shown
    finally:
        if isinstance(shown, ProgressLines):
            shown.end()


def progress_of(wanted: Progress | Lines | None) -> Progress | None:
    """The progress callback of what lives on: see `shown_progress`."""
    if isinstance(wanted, str) and wanted == "lines":
        return ProgressLines(lambda line: write_with_time(line, sys.stderr))
    check_progress(wanted)
    return wanted


def write_with_time(line: str, stream: TextIO) -> None:
    """Write a line of progress, and the time of day before it."""
    stream.write(f"{time.strftime('%H:%M:%S')} {line}\n")
    stream.flush()


@dataclass
class Stage:
    """How far a stage is, how fast it goes, and when it was last spoken of (s)."""

    name: str
    done: int
    total: int
    message: str
    began: float = field(default_factory=time.monotonic)
    said: float | None = None
    # when (s) so many were done, over the last `WINDOW`
    reports: deque[tuple[float, int]] = field(default_factory=deque)

    def update(self, done: int, total: int, message: str) -> None:
        """Take note of how far it is."""
        now = time.monotonic()
        self.done, self.total, self.message = done, total, message
        if not self.reports or now - self.reports[-1][0] >= APART:
            self.reports.append((now, done))
        memory = inf if self.name in STEADY else WINDOW
        while len(self.reports) > 2 and self.reports[1][0] <= now - memory:
            self.reports.popleft()

    @property
    def time_left(self) -> str:
        """How long it still takes; empty while nothing can be said of that."""
        now = time.monotonic()
        if self.done >= self.total or now - self.reports[0][0] < FEWEST:
            return ""
        # the slower of the window and of its later half, as what was quick may be over
        first = self.reports[0][0]
        rate = self._rate(first, now)
        if self.name not in STEADY:
            rate = min(rate, self._rate((first + now) / 2, now))
        if rate <= 0:
            return ""
        most = "at most " if self.name in ENDS_EARLIER else ""
        return f"{most}{duration((self.total - self.done) / rate)} left"

    def _rate(self, since: float, now: float) -> float:
        """What has been done a second since the last report before a time."""
        begin, done = [report for report in self.reports if report[0] <= since][-1]
        return (self.done - done) / (now - begin)

    def __str__(self) -> str:
        elapsed = duration(time.monotonic() - self.began)
        text = f"{self.name} {self.done}/{self.total}, {elapsed}"
        if left := self.time_left:
            text += f", {left}"
        return f"{text}: {self.message}" if self.message else text


class ProgressLines:
    """Lines that say how far a stage is: after 2 s, then every 10 s, and at its end.

    Parameters
    ----------
    say : callable
        Says a line.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say_line = say
        self._stages: dict[str, Stage] = {}
        self._timers: list[threading.Timer] = []

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """See `fascicle.core.progress.Progress`."""
        self.update(NAMES.get(stage, stage), done, total, message)

    def update(self, name: str, done: int, total: int, message: str) -> Stage:
        """Take note of a stage, say it if it is time to, and give it."""
        stage = self._stages.get(name)
        if stage is None or done < stage.done:
            stage = self._stages[name] = Stage(name, done, total, message)
            timer = threading.Timer(FIRST, self._say_first, [stage])
            timer.daemon = True
            timer.start()
            self._timers.append(timer)
        ended = stage.done < stage.total and done >= total
        stage.update(done, total, message)
        if stage.said is not None and (ended or time.monotonic() - stage.said >= EVERY):
            self._say(stage)
        return stage

    def end(self) -> None:
        """Say nothing more."""
        for timer in self._timers:
            timer.cancel()

    def _say_first(self, stage: Stage) -> None:
        if stage.done < stage.total:
            self._say(stage)

    def _say(self, stage: Stage) -> None:
        stage.said = time.monotonic()
        self._say_line(str(stage))


def duration(seconds: float) -> str:
    """Minutes and seconds, as people say them."""
    minutes, left = divmod(round(seconds), 60)
    if minutes >= LONG:
        return f"{round(seconds / 60)} min"
    return f"{minutes} min {left} s" if minutes else f"{left} s"
