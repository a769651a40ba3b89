"""Progress of long runs: bars in a terminal, plain lines elsewhere and in the log."""

from __future__ import annotations

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

from fascicle.cli.output import current_output
from fascicle.core.errors import InputError
from fascicle.core.progress_lines import NAMES, ProgressLines, write_with_time


class TerminalProgress:
    """A bar a stage, with time left; where there is no terminal, lines now and then."""

    def __init__(self) -> None:
        output = current_output()
        self._output = output
        self._lines = ProgressLines(self._say)
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

    def _say(self, line: str) -> None:
        """Add a line to the log, and to what is no terminal."""
        self._output.note(line)
        screen = self._output.screen
        if screen is not None and not screen.isatty():
            write_with_time(line, screen)


class _TimeLeft(ProgressColumn):
    """How long the stage of a bar still takes."""

    def render(self, task: Task) -> Text:
        stage = task.fields["stage"]
        return Text(stage.time_left if stage is not None else "", style="progress.remaining")
