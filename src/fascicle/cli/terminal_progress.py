"""Progress of long runs: bars in a terminal, plain lines elsewhere and in the log."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, field
from math import inf
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from fascicle.cli.output import Output, current_output, duration
from fascicle.core.errors import InputError

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


class TerminalProgress:
    """A bar a stage, with time left; where there is no terminal, lines now and then."""

    def __init__(self) -> None:
        output = current_output()
        self._lines = _Lines(output)
        self._console = Console(file=output.screen, stderr=True, quiet=output.screen is None)
        self._tasks: dict[str, TaskID] = {}
        self._bars = Progress(
            TextColumn("{task.description:<24}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            _TimeLeft(),
            TextColumn("{task.fields[message]}"),
            console=self._console,
        )

    def __enter__(self) -> TerminalProgress:
        return self  # the bars start with the first stage, so that an early error stands alone

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._lines.end()
        if not self._tasks:
            return
        if kind is not None and issubclass(kind, InputError):
            # a refusal stands alone, in one line
            self._bars.live.transient = True
            self._bars.live.stop()
        else:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """See `fascicle.core.progress.Progress`."""
        name = NAMES.get(stage, stage)
        stage_now = self._lines.update(name, done, total, message)
        if not self._console.is_terminal:
            return
        self._bars.start()
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(name, total=total, message="", stage=None)
        task = self._tasks[stage]
        if done < self._bars.tasks[task].completed:  # the stage of another patient
            self._bars.reset(task)
        self._bars.update(task, completed=done, total=total, message=message, stage=stage_now)


@dataclass
class _Stage:
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


class _TimeLeft(ProgressColumn):
    """How long the stage of a bar still takes."""

    def render(self, task: Task) -> Text:
        stage = task.fields["stage"]
        return Text(stage.time_left if stage is not None else "", style="progress.remaining")


class _Lines:
    """Lines that say how far a stage is: after 2 s, then every 10 s, and at its end."""

    def __init__(self, output: Output) -> None:
        screen = output.screen
        self._screen = screen if screen is not None and not screen.isatty() else None
        self._output = output
        self._stages: dict[str, _Stage] = {}
        self._timers: list[threading.Timer] = []

    def update(self, name: str, done: int, total: int, message: str) -> _Stage:
        """Take note of a stage, say it if it is time to, and give it."""
        stage = self._stages.get(name)
        if stage is None or done < stage.done:
            stage = self._stages[name] = _Stage(name, done, total, message)
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

    def _say_first(self, stage: _Stage) -> None:
        if stage.done < stage.total:
            self._say(stage)

    def _say(self, stage: _Stage) -> None:
        stage.said = time.monotonic()
        self._output.note(str(stage))
        if self._screen is not None:
            print(time.strftime("%H:%M:%S"), stage, file=self._screen, flush=True)
