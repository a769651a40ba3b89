"""Progress of long runs: bars in a terminal, plain lines elsewhere and in the log."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from fascicle.cli.output import Output, current_output
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
    "sampling": "sampling",
    "rejection": "networks accepted",
    "networks": "simulating the networks",
}
MEMORY = 86_400.0  # s; time left is that of the whole stage so far, also where a step takes an hour
FIRST, EVERY = 2.0, 10.0  # s after which a stage is spoken of in a line, and then again


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
            TimeRemainingColumn(),
            TextColumn("{task.fields[message]}"),
            console=self._console,
            speed_estimate_period=MEMORY,
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
        self._lines.update(name, done, total, message)
        if not self._console.is_terminal:
            return
        self._bars.start()
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(name, total=total, message="")
        task = self._tasks[stage]
        if done < self._bars.tasks[task].completed:  # the stage of another patient
            self._bars.reset(task)
        self._bars.update(task, completed=done, total=total, message=message)


@dataclass
class _Stage:
    """How far a stage is, and when it was last spoken of (s)."""

    name: str
    done: int
    total: int
    message: str
    began: float = field(default_factory=time.monotonic)
    from_done: int = 0  # what was done when it began, as in a study that goes on
    said: float | None = None

    def __str__(self) -> str:
        elapsed = time.monotonic() - self.began
        text = f"{self.name} {self.done}/{self.total}, {_duration(elapsed)}"
        new = self.done - self.from_done
        if new > 0 and self.done < self.total:
            text += f", {_duration(elapsed * (self.total - self.done) / new)} left"
        return f"{text}: {self.message}" if self.message else text


class _Lines:
    """Lines that say how far a stage is: after 2 s, then every 10 s, and at its end."""

    def __init__(self, output: Output) -> None:
        screen = output.screen
        self._screen = screen if screen is not None and not screen.isatty() else None
        self._output = output
        self._stages: dict[str, _Stage] = {}
        self._timers: list[threading.Timer] = []

    def update(self, name: str, done: int, total: int, message: str) -> None:
        """Take note of a stage, and say it if it is time to."""
        stage = self._stages.get(name)
        if stage is None or done < stage.done:
            stage = self._stages[name] = _Stage(name, done, total, message, from_done=done)
            timer = threading.Timer(FIRST, self._say_first, [stage])
            timer.daemon = True
            timer.start()
            self._timers.append(timer)
        ended = stage.done < stage.total and done >= total
        stage.done, stage.total, stage.message = done, total, message
        if stage.said is not None and (ended or time.monotonic() - stage.said >= EVERY):
            self._say(stage)

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


def _duration(seconds: float) -> str:
    """Minutes and seconds, as people say them."""
    minutes, left = divmod(round(seconds), 60)
    return f"{minutes} min {left} s" if minutes else f"{left} s"
