"""In a notebook: the widget answers as a session does, and its script runs in a browser."""

import base64

import pytest

import fascicle
from fascicle.explorer import explore as explore_module
from fascicle.explorer.explore import widget
from fascicle.explorer.session import Session

# A cell of a notebook, with a kernel that answers
CELL = """async (script) => {
  const url = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const { default: made } = await import(url);
  const heard = [];
  const model = {
    on: (name, handler) => heard.push(handler),
    off: () => {},
    send: async (message) => {
      const bytes = Uint8Array.from(atob(await kernel(message)), (c) => c.charCodeAt(0));
      heard.forEach((handler) => handler({}, [new DataView(bytes.buffer)]));
    },
  };
  made.render({ model, el: document.body });
}"""


@pytest.fixture(scope="module")
def session(default_model):
    return Session(default_model)


def asked(made, message):
    """What a widget sends when a page asks."""
    sent = []
    made.send = lambda content, buffers: sent.append((content, buffers))
    made._handle_custom_msg(message, [])
    ((content, (answer,)),) = sent
    assert content == {}
    return answer


def test_a_widget_answers_as_its_session(session):
    pytest.importorskip("anywidget")
    made = widget(session)
    assert asked(made, {"ask": "description"}) == session.description()
    message = {"id": 3, "state": {"values": session.start}}
    assert asked(made, message) == session.answer(message)


def test_a_cell_shows_the_heart(session, visit):
    pytest.importorskip("anywidget")
    made = widget(session)
    page = visit("about:blank")
    page.expose_function("kernel", lambda m: base64.b64encode(asked(made, m)).decode())
    page.evaluate(CELL, str(made._esm))
    page.locator(".fx-measured dd").first.wait_for()
    expected = session.model.simulate(session.start)
    assert page.locator(".fx-measured dd").first.inner_text() == (f"{expected.qrs_duration:.0f} ms")


def test_a_kernel_gets_a_widget_and_a_script_a_page(session, monkeypatch):
    monkeypatch.setattr(explore_module, "session_of", lambda *given: session)
    monkeypatch.setattr(explore_module, "serve", lambda served: ("page", served))
    monkeypatch.setattr(explore_module, "widget", lambda shown: ("widget", shown))
    assert fascicle.explore("default") == ("page", session)
    kernel = type("Shell", (), {"kernel": True})()
    ipython = type("IPython", (), {"get_ipython": staticmethod(lambda: kernel)})
    monkeypatch.setitem(explore_module.sys.modules, "IPython", ipython)
    assert fascicle.explore("default") == ("widget", session)


def test_without_anywidget_it_says_so(session, monkeypatch):
    monkeypatch.setattr("fascicle.core.errors.find_spec", lambda name: None)
    with pytest.raises(fascicle.InputError, match=r"pip install .fascicle-ecg\[notebook\]"):
        widget(session)
