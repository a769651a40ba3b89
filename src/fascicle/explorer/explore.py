"""Begin to explore a heart or a study: on a page of this machine, or in a notebook."""

from __future__ import annotations

import sys
from functools import partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import NoneType
from typing import Any

from fascicle.core.errors import InputError
from fascicle.core.files import as_path
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.explorer.server import serve
from fascicle.explorer.session import Session
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart
from fascicle.networks.target_comparison import TargetComparison
from fascicle.recording.target import Target
from fascicle.recording.target_files import read_target
from fascicle.study.fitted import FittedStudy, load_study
from fascicle.study.study import CONFIGURATION

# Script of the notebook; the page calls the same `fascicleExplorer`, and has a socket
RENDER = """
export default {
  render({ model, el }) {
    const heard = (message, [view]) =>
      explorer?.heard(view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength));
    const explorer = window.fascicleExplorer(el, (message) => model.send(message));
    model.on("msg:custom", heard);
    model.send({ ask: "description" });
    return () => { model.off("msg:custom", heard); explorer?.dispose(); };
  },
};
"""


def explore(
    given: Heart | FittedStudy | Path | str,
    target: Target | Path | str | None = None,
    progress: Progress | Lines | None = "lines",
) -> Any:
    """Show a heart, its networks and its ECG, which follow every parameter as it is moved.

    In a notebook the result is a widget; anywhere else a page opens in the browser, and this
    returns when it is closed.

    Parameters
    ----------
    given : Heart, FittedStudy or path
        A heart or a study, its folder, or the name of a packaged heart.
    target : Target or path, optional
        A recording, with which simulated ECGs are compared; a study has its own.
    progress : Progress, "lines" or None
        Called while a large heart is prepared; by default lines on standard error say so.

    Raises
    ------
    InputError
        If neither a heart nor a study is there, or the target cannot be used.
    """
    with shown_progress(progress) as shown:
        session = session_of(given, target, shown)
    kernel = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if hasattr(kernel, "kernel"):
        return widget(session)
    return serve(session)


def session_of(
    given: Heart | FittedStudy | Path | str,
    target: Target | Path | str | None,
    progress: Progress | None,
) -> Session:
    """Session of the arguments of `explore`."""
    check_kind(target, (Target, Path, str, NoneType), "target", "a fascicle target, or its file")
    if isinstance(given, Path | str) and (as_path(given, "heart") / CONFIGURATION).is_file():
        given = load_study(given)
    if isinstance(given, FittedStudy):
        if target is not None:
            raise InputError(
                f"{given.folder}: a study has its own recordings; leave out the target"
            )
        return Session.of_study(given)
    model = ForwardModel(as_heart(given), progress=progress)
    if target is None:
        return Session(model)
    read = target if isinstance(target, Target) else read_target(target)
    return Session(model, TargetComparison(read.in_leads(model.heart.leads)))


def widget(session: Session) -> Any:
    """Notebook widget of a session; raises InputError if anywidget is missing."""
    if find_spec("anywidget") is None:
        raise InputError("a notebook needs anywidget; install it: pip install anywidget")
    from anywidget import AnyWidget

    page = files("fascicle") / "reporting" / "page"

    class Explorer(AnyWidget):
        _esm = (page / "viewer.js").read_text(encoding="utf-8") + RENDER
        _css = (page / "explorer.css").read_text(encoding="utf-8")

    explorer = Explorer()

    def answer(shown: Any, message: Any, buffers: Any) -> None:
        is_first = message.get("ask") == "description"
        send = partial(explorer.send, {})
        send([session.description() if is_first else session.answer(message, lambda m: send([m]))])

    explorer.on_msg(answer)
    return explorer
