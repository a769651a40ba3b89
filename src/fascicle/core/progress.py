"""Progress of long computations: callbacks that report it, and plain lines that show it."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal, Protocol, TextIO

from fascicle.core.errors import ValueRefusedError
from fascicle.core.ranges import shown

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import Task

StageProgress = Callable[[int, int], None]  # progress callback of one stage: done, total
Lines = Literal["lines"]  # asks for lines on standard error
WHOLE_RUN = "whole fit"  # name of the stage "whole run" for users; its steps are seconds


class Progress(Protocol):
    """Progress callback of a run with several stages, which `stage_name` lists.

    Besides these there are "sampling" of a posterior, whose total is a maximum, and "prior
    simulations"; "repair" and "resuming" are notes, whose message is the news. "draws" belong to
    "rejection"; "workers" is reported while a cluster has no workers or does not answer. The steps
    of the "whole run" of a fit are seconds.
    """

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """Report `done` of `total` steps of `stage`; `message` is a text for people."""


def no_progress(done: int, total: int) -> None:
    """Stand in for the progress callback of a stage that is not watched."""


def stage_progress(progress: Progress | None, stage: str, message: str = "") -> StageProgress:
    """Progress callback of one stage, which calls that of the run with `stage` and `message`."""
    if progress is None:
        return no_progress
    return lambda done, total: progress(stage, done, total, message)


def part_of_stage(
    progress: Progress | None, name: str, before: int, others: int
) -> Progress | None:
    """Progress callback of a part of the stage `name`, which calls that of the run with the whole.

    The other parts have `others` steps, `before` of them in parts that are done.
    """
    if progress is None:
        return None

    def whole(stage: str, done: int, total: int, message: str) -> None:
        if stage == name:
            done, total = done + before, total + others
        progress(stage, done, total, message)

    return whole


class WholeRun:
    """Progress callback of consecutive stages, which also reports the time that all of them take.

    That is the stage "whole run", in seconds. It is estimated from usual durations (s) and from
    how much faster or slower the stages so far went. Stages may be left out.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress, self._began = progress, time.monotonic()
        self._usual = 10.0  # s, of the stages so far; not 0, so that the pace begins at about 1
        self._stages: list[tuple[str, float]] = [("", 0.0)]
        self._afterwards, self._message, self._last = 0.0, "", 0

    def expect(
        self, stages: Sequence[tuple[str, float]], afterwards: float = 0.0, message: str = ""
    ) -> None:
        """Expect stages with their usual durations (s), and others `afterwards`."""
        self._usual += self._stages[0][1]
        self._stages = [("", 0.0), *stages]
        self._afterwards, self._message = afterwards, message

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """See `Progress`."""
        self._progress(stage, done, total, message)
        (current, usual), *later = self._stages
        if stage != current or done < self._last:  # a later stage, or the current one once more
            names = [name for name, _ in later]
            if stage in names:
                self._stages = later[names.index(stage) :]
            elif stage != current:
                return
            self._usual += usual
            (_, usual), *later = self._stages
        self._last = done
        share = done / max(total, 1)
        elapsed = time.monotonic() - self._began
        pace = (elapsed + 10.0) / (self._usual + share * usual)
        left = (1 - share) * usual + sum(seconds for _, seconds in later) + self._afterwards
        self._progress("whole run", round(elapsed), round(elapsed + pace * left), self._message)

    def end(self) -> None:
        """Report that the run is over, if any stages were expected."""
        elapsed = round(time.monotonic() - self._began)
        if self._stages != [("", 0.0)]:
            self._progress("whole run", elapsed, elapsed, "")


def check_progress(progress: object) -> None:
    """Refuse an argument that is neither None nor a progress callback."""
    if progress is not None and not callable(progress):
        raise ValueRefusedError(f"progress is {shown(progress)}; give a function, 'lines' or None")


@contextmanager
def shown_progress(progress: Progress | Lines | None) -> Iterator[Progress | None]:
    """Yield the callback for a `progress` argument of the Python interface.

    "lines" are written on standard error while the context lasts.
    """
    callback = progress_of(progress)
    try:
        yield callback
    finally:
        if isinstance(callback, ProgressLines) and callback is not progress:
            callback.end()  # those of a caller go on


def progress_of(progress: Progress | Lines | None) -> Progress | None:
    """Progress callback for an object that outlives the call; see `shown_progress`."""
    if isinstance(progress, str) and progress == "lines":
        return ProgressLines(lambda line: write_with_time(line, sys.stderr))
    check_progress(progress)
    return progress


def write_with_time(line: str, stream: TextIO) -> None:
    """Write a line of progress, and the time of day before it."""
    stream.write(f"{time.strftime('%H:%M:%S')} {line}\n")
    stream.flush()


def stage_name(stage: str) -> str:
    """Name of a stage for users."""
    names = {
        "compilation": "compiling (first run)",
        "template": "cables",
        "preparation": "preparing the heart",
        "repair": "evaluations kept",
        "initial": "Latin hypercube",
        "optimisation": "Bayesian optimisation",
        "prior": "networks of the prior",
        "draws": "drawing from the prior",
        "rejection": "networks accepted",
        "networks": "simulating the networks",
        "workers": "workers of the cluster",
        "whole run": WHOLE_RUN,
    }
    return names.get(stage, stage)


class ProgressLines:
    """Lines on the progress of a stage: after `first` s, then each `interval` s, at its end."""

    def __init__(
        self, say: Callable[[str], None], first: float = 2.0, interval: float = 10.0
    ) -> None:
        self._say, self._first, self._interval = say, first, interval
        self._bars: Bars | None = None
        self._tasks: dict[str, Task] = {}
        self._said: dict[str, float] = {}  # when (s) a stage was last reported
        self._over, self._lock = threading.Event(), threading.Lock()

    def _make_bars(self) -> Bars:
        """Progress bars, which measure the pace of stages; hidden here, shown by a subclass."""
        import rich.progress

        return rich.progress.Progress(disable=True, speed_estimate_period=60.0)

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """See `Progress`; several threads may call."""
        with self._lock:
            if self._bars is None:
                self._bars = self._make_bars()
                self._bars.start()
                threading.Thread(target=self._speak, daemon=True).start()
            if stage not in self._tasks:
                self._bars.add_task(stage_name(stage), total=total, message="", first=done)
                self._tasks[stage] = self._bars.tasks[-1]
            task = self._tasks[stage]
            if done < task.completed:  # the stage of another patient
                self._bars.reset(task.id, first=done, message=message)
                self._said.pop(stage, None)
            self._bars.update(task.id, completed=done, total=total, message=message)
            if stage in ("repair", "resuming"):  # notes
                self._say(f"{task.description}: {message}")
            elif task.finished and self._said.pop(stage, None) is not None:
                self._say(_line(task))

    def end(self, clear: bool = False) -> None:
        """Stop reporting; with `clear`, bars that were shown are removed."""
        self._over.set()
        if self._bars is not None:
            self._bars.live.transient = clear
            self._bars.stop()

    def _speak(self) -> None:
        """Report the stages that have not ended, now and then."""
        while not self._over.wait(self._first / 4):
            for stage, task in [*self._tasks.items()]:
                time_now = time.monotonic()
                wait = self._interval if stage in self._said else self._first
                since = self._said.get(stage, time_now - (task.elapsed or 0.0))
                if not task.finished and time_now - since >= wait:
                    self._said[stage] = time_now
                    self._say(_line(task))


def _line(task: Task) -> str:
    steps = "" if task.description == WHOLE_RUN else f" {task.completed:g}/{task.total:g}"
    text = f"{task.description}{steps}, {duration(task.elapsed)}"
    text = ", ".join(filter(None, [text, time_left(task)]))
    message = task.fields["message"]
    return f"{text}: {message}" if message else text


def time_left(task: Task) -> str:
    """Remaining time of a stage, by its recent pace; empty while that is unknown."""
    elapsed = task.elapsed or 0.0
    done = task.completed - task.fields["first"]
    if task.finished or not done or task.total is None or elapsed < 2.0:
        return ""
    left = task.time_remaining
    if task.description == WHOLE_RUN:
        left = task.total - task.completed
    elif left is None:  # the steps are further apart than the period of rich's pace
        left = elapsed * (task.total - task.completed) / done
    if left > 50 * elapsed:  # too early to tell
        return ""
    most = "at most " if task.description == "sampling" else ""  # its total is a maximum
    return f"{most}{duration(left)} left"


def duration(seconds: float | None) -> str:
    """Duration in minutes and seconds, in words; from 10 minutes on without the seconds."""
    minutes, left = divmod(round(seconds or 0.0), 60)
    if minutes >= 10:
        return f"{minutes} min"
    return f"{minutes} min {left} s" if minutes else f"{left} s"
