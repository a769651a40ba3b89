"""Interactive explorer of a heart or a study: a notebook widget, or a web page.

The web page is served to this machine alone, until the last open page is closed.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from types import NoneType
from typing import Any

from fascicle.core.errors import InputError, check_installed
from fascicle.core.files import as_path
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.explorer.session import Session
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart
from fascicle.networks.target_comparison import TargetComparison
from fascicle.recording.target import Target
from fascicle.recording.target_files import read_target
from fascicle.study.fitted import FittedStudy, load_study
from fascicle.study.study import StudyFile


def explore(
    source: Heart | FittedStudy | Path | str,
    target: Target | Path | str | None = None,
    progress: Progress | Lines | None = "lines",
) -> Any:
    """Show a heart, its Purkinje networks and its ECG, simulated again as parameters are moved.

    In a notebook the result is a widget; anywhere else a page opens in the browser, and the call
    returns when that is closed.

    Parameters
    ----------
    source : Heart, FittedStudy or path
        A heart or a study, its folder, or the name of a packaged heart.
    target : Target or path, optional
        A recording, with which simulated ECGs are compared; a study has its own.
    progress : Progress, "lines" or None
        Progress callback while a large heart is prepared; by default lines on standard error.

    Raises
    ------
    InputError
        If the source is neither a heart nor a study, or the target cannot be used.
    """
    with shown_progress(progress) as shown:
        session = session_of(source, target, shown)
    kernel = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if hasattr(kernel, "kernel"):
        return widget(session)
    return serve(session)


def session_of(
    source: Heart | FittedStudy | Path | str,
    target: Target | Path | str | None,
    progress: Progress | None,
) -> Session:
    """Session that shows the `source` and `target` of `explore`."""
    check_kind(target, (Target, Path, str, NoneType), "target", "a fascicle target, or its file")
    if isinstance(source, Path | str):
        configuration = as_path(source, "heart") / StudyFile.CONFIGURATION
        source = load_study(source) if configuration.is_file() else source
    if isinstance(source, FittedStudy):
        if target is not None:
            raise InputError(
                f"{source.folder}: a study has its own recordings; leave out the target"
            )
        return Session.of_study(source)
    model = ForwardModel(as_heart(source), progress=progress)
    if target is None:
        return Session(model)
    recording = target if isinstance(target, Target) else read_target(target)
    return Session(model, TargetComparison(recording.in_leads(model.heart.leads)))


def widget(session: Session) -> Any:
    """Notebook widget of a session; raises InputError if anywidget is missing."""
    check_installed("anywidget", "a notebook", "notebook")
    from anywidget import AnyWidget

    page = files("fascicle") / "reporting" / "page"

    # the web page calls `fascicleExplorer` as well, with a socket in place of the widget's messages
    script = """
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

    class Explorer(AnyWidget):
        _esm = (page / "viewer.js").read_text(encoding="utf-8") + script
        _css = (page / "explorer.css").read_text(encoding="utf-8")

    explorer = Explorer()

    def answer(shown: Any, message: Any, buffers: Any) -> None:
        is_first = message.get("ask") == "description"
        send = partial(explorer.send, {})
        send([session.description() if is_first else session.answer(message, lambda m: send([m]))])

    explorer.on_msg(answer)
    return explorer


def listen(port: int = 0) -> socket.socket:
    """Socket of a local port, of any free one if 0; raises InputError if the port is taken."""
    try:
        return socket.create_server((Application.address, port))
    except OSError as error:
        reason = os.strerror(error.errno or 0)
        raise InputError(f"port {port}: {reason}; leave out --port, or give another") from None


def serve(
    session: Session,
    listening: socket.socket | None = None,
    announce: Callable[[str], object] | None = None,
    browser: bool = True,
) -> None:
    """Show a session on a local web page; returns when its last page is closed, or at Ctrl-C.

    Parameters
    ----------
    session : Session
        Session to show.
    listening : socket, optional
        Socket of the page, from `listen`; of any free port by default.
    announce : callable, optional
        Called with the address of the page; prints it by default.
    browser : bool
        Whether a browser opens the page.
    """
    import uvicorn

    listening = listening or listen()
    app = Application(session, listening.getsockname()[1])
    config = uvicorn.Config(
        app.asgi(), log_level="error", ws="websockets-sansio", lifespan="off",
        ws_per_message_deflate=False,  # compression takes longer than the simulation
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = uvicorn.Server(config)
    app.end = lambda: setattr(server, "should_exit", True)
    with TemporaryDirectory(prefix="fascicle-explorer-") as folder, listening:
        (announce or partial(print, "exploring at", flush=True))(app.url)
        if browser:
            # the token stays in a private file: others can read the command line of a browser
            page = Path(folder) / "explorer.html"
            page.touch(0o600)
            page.write_text(
                f'<!DOCTYPE html><title>fascicle explore</title><meta http-equiv="refresh" '
                f'content="0; url={app.url}"><a href="{app.url}">Open the explorer</a>'
            )
            # in a thread: some browsers return only when they are closed
            open_page = partial(webbrowser.open, page.as_uri())
            threading.Thread(target=open_page, daemon=True).start()
        server.run(sockets=[listening])


async def in_thread(work: Callable[[], bytes]) -> bytes:
    """Result of `work`, run in a daemon thread: the program may end before it does."""
    loop, result = asyncio.get_running_loop(), Future[bytes]()
    result.set_running_or_notify_cancel()  # from here on, only the await is cancelled

    def run() -> None:
        try:
            result.set_result(work())
        except Exception as error:  # noqa: BLE001 - raised again where it is awaited
            result.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return await asyncio.wrap_future(result, loop=loop)


class Application:
    """Web application: the page, and a socket for every page that is open."""

    address = "127.0.0.1"  # reachable from this machine only
    reloaded_within = 3.0  # s that the server waits for a page to be reloaded before it ends
    # Content security policy: nothing is loaded from other hosts, and no page may embed this one
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' "
        "data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors "
        "'none'"
    )

    def __init__(self, session: Session, port: int) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(24)
        self.hosts = {f"{name}:{port}" for name in (self.address, "localhost")}
        self.url = f"http://{self.address}:{port}/{self.token}/"
        self.pages = 0
        self.end: Callable[[], object] = lambda: None

    def asgi(self) -> Any:
        """ASGI application; every path begins with the secret token."""
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import Response
        from starlette.routing import Route, WebSocketRoute

        kinds = {"": "text/html", "explorer.css": "text/css", "viewer.js": "text/javascript"}

        async def file(request: Request) -> Response:
            name = request.path_params.get("name", "")
            if request.headers.get("host") not in self.hosts or name not in kinds:
                return Response("not found", 404)
            content = files("fascicle") / "reporting" / "page" / (name or "explorer.html")
            headers = {"Content-Security-Policy": self.policy, "Referrer-Policy": "no-referrer"}
            return Response(content.read_text(encoding="utf-8"), 200, headers, kinds[name])

        at = f"/{self.token}"
        routes = [
            Route(f"{at}/", file),
            WebSocketRoute(f"{at}/socket", self.socket),
            Route(f"{at}/{{name}}", file),
        ]
        return Starlette(routes=routes)

    async def socket(self, page: Any) -> None:
        """Serve the socket of one page until it is closed; messages are answered in order."""
        from starlette.websockets import WebSocketDisconnect

        origin = page.headers.get("origin", "").removeprefix("http://")
        if origin not in self.hosts or page.headers.get("host") not in self.hosts:
            await page.close(1008)  # policy violation: a page of another host
            return
        await page.accept()
        self.pages += 1
        messages: asyncio.Queue[Any] = asyncio.Queue()
        tasks = [
            asyncio.create_task(task(page, messages)) for task in (self.messages, self.answers)
        ]
        ended, running = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in running:
            task.cancel()  # the page is closed
        self.pages -= 1
        loop = asyncio.get_running_loop()
        loop.call_later(self.reloaded_within, lambda: self.pages or self.end())
        with suppress(WebSocketDisconnect):  # closed while an answer was sent
            for task in ended:
                task.result()  # raises the exception of a failed task

    async def messages(self, page: Any, messages: asyncio.Queue[Any]) -> None:
        """Collect the messages of a page, until it is closed; None for each that is damaged."""
        while (frame := await page.receive())["type"] != "websocket.disconnect":
            message = None
            with suppress(ValueError, RecursionError):
                # binary frames have no text; a page's messages have at most 10,000 characters
                message = json.loads((frame.get("text") or "")[: 2**16])
            messages.put_nowait(message)

    async def answers(self, page: Any, messages: asyncio.Queue[Any]) -> None:
        """Send the description, then the answer to each message, with progress of long ones."""
        loop = asyncio.get_running_loop()

        def report(message: bytes) -> None:  # called in another thread
            if not loop.is_closed():
                asyncio.run_coroutine_threadsafe(page.send_bytes(message), loop)

        await page.send_bytes(await in_thread(self.session.description))
        while True:
            work = partial(self.session.answer, await messages.get(), report)
            await page.send_bytes(await in_thread(work))
