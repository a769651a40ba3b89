"""The explorer in a notebook."""

from __future__ import annotations

from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from fascicle.core.errors import InputError
from fascicle.explorer.session import Session

# What the notebook calls; the page has the same `fascicleExplorer` and a socket
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


def widget(session: Session) -> Any:
    """A widget that shows a session; InputError without anywidget."""
    if find_spec("anywidget") is None:
        raise InputError("a notebook needs anywidget; install it: pip install anywidget")
    from anywidget import AnyWidget

    page = files("fascicle") / "reporting" / "page"

    class Explorer(AnyWidget):
        _esm = (page / "viewer.js").read_text(encoding="utf-8") + RENDER
        _css = (page / "explorer.css").read_text(encoding="utf-8")

    made = Explorer()

    def answer(shown: Any, message: Any, buffers: Any) -> None:
        is_first = message.get("ask") == "description"
        made.send({}, [session.description() if is_first else session.answer(message)])

    made.on_msg(answer)
    return made
