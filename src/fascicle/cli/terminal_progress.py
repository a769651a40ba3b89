"""Progress of long runs in the terminal."""

from __future__ import annotations

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


class TerminalProgress:
    """A bar a stage, with time left; a plain line a stage where there is no terminal."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._tasks: dict[str, TaskID] = {}
        self._bars = Progress(
            TextColumn("{task.description:<24}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
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
        self._bars.start()
        if stage not in self._tasks:
            name = NAMES.get(stage, stage)
            self._tasks[stage] = self._bars.add_task(name, total=total, message="")
        self._bars.update(self._tasks[stage], completed=done, total=total, message=message)
