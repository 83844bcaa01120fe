"""The local server of the explorer: only for this machine, with a secret token."""

import contextlib
import html
import logging
import os
import secrets
import signal
import socket
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.server.server import Server
from jinja2 import Template

from viscovib.errors import InputError, ViscovibError
from viscovib.explorer.page import Page
from viscovib.explorer.state import State
from viscovib.explorer.widgets import alert, words
from viscovib.scene.scene import Scene

_HERE = "127.0.0.1"
#: Bokeh's slider handles have no names. Screen readers get the name of the neighbouring field.
_NAME_SLIDERS = """
const nameSliders = (root) => {
  for (const part of root.querySelectorAll('*')) {
    if (!part.shadowRoot) continue
    const handle = part.shadowRoot.querySelector('.noUi-handle')
    if (handle) {
      const neighbour = [part, ...part.parentNode.children].map(
        (other) => other.shadowRoot?.querySelector('label, .bk-slider-title')?.textContent.trim()
      ).find((text) => text)
      handle.setAttribute('aria-label', neighbour || 'slider')
    }
    nameSliders(part.shadowRoot)
  }
}
setInterval(() => nameSliders(document), 500)
"""
#: The HTML page; all scripts and styles come from this server.
_TEMPLATE = Template(
    """{% from macros import embed %}<!DOCTYPE html>
<html lang="en">
<head>
  <meta charset="utf-8">
  <meta name="viewport" content="width=device-width, initial-scale=1">
  <meta name="referrer" content="no-referrer">
  <link rel="icon" href="data:,">
  <title>{{ title | e }}</title>
  {{ bokeh_css }}{{ bokeh_js }}
  <style>
    body { margin: 8px; font-family: system-ui, sans-serif; color: #222; background: #fff; }
  </style>
</head>
<body><main>{% for doc in docs %}{{ embed(doc) if doc.elementid }}{% for root in doc.roots %}
{{ embed(root) }}{% endfor %}{% endfor %}</main>{{ plot_script }}
<script>{{ name_sliders }}</script></body>
</html>"""
)

#: The local file that redirects to the page.
_LEAD = """<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>viscovib</title>
<meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="0; url={address}">
<p><a href="{address}">viscovib explorer</a></p></html>
"""


def query_of(arguments: Mapping[str, Sequence[bytes]]) -> list[tuple[str, str]]:
    """Return the first value of each key of an address; undecodable bytes are replaced."""
    return [(key, value.decode(errors="replace")) for key, (value, *_) in arguments.items()]


def page_of(
    scene: Scene,
    keys: Sequence[str] | None = None,
    query: Sequence[tuple[str, str]] = (),
    document: Any = None,
) -> Page:
    """Return a page of a scene in the state given by the query of an address.

    ``scene=NAME`` in the query selects another scene of the same folder.
    """
    folder = scene.path.parent if scene.path.exists() else None
    wanted = dict(query).get("scene")
    if folder is not None and wanted and wanted != scene.path.name:
        named = folder / Path(wanted).name
        # `exists` is False for a name that no file can have.
        if named.suffix == ".nml" and os.path.exists(named):
            scene, keys = Scene.read(named), None
    state = State(scene, keys)
    wrong = ""
    try:
        state.follow(query)
    except ViscovibError as error:
        wrong = f"The address contains a wrong value: {error}"
    page = Page(state, folder, document)
    if wrong:
        page.complain(wrong)
    return page


def start(scene: Scene, keys: Sequence[str] | None = None, port: int = 0) -> tuple[Server, str]:
    """Start the server; return it and the address of the page."""

    def session(document: Any) -> None:
        query = query_of(document.session_context.request.arguments)
        document.title = f"viscovib: {scene.path.name}"
        document.template = _TEMPLATE
        document.template_variables["name_sliders"] = _NAME_SLIDERS
        try:
            page = page_of(scene, keys, query, document)
        except ViscovibError as error:
            document.add_root(words(alert(str(error))))
            return
        document.add_root(page.view)

    # Requests that fail are reported to the browser only.
    logging.getLogger("tornado.access").setLevel(logging.ERROR)
    token = secrets.token_urlsafe(24)
    try:
        with socket.socket() as probe:
            # The server needs its own address, including the port.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((_HERE, port))
            port = probe.getsockname()[1]
        server = Server(
            {"/": Application(FunctionHandler(session))},
            port=port,
            address=_HERE,
            prefix=f"/{token}",
            allow_websocket_origin=[f"{_HERE}:{port}", f"localhost:{port}"],
        )
    except OSError as error:
        raise InputError(f"--port {port}: cannot be used ({error.strerror})") from None
    server.start()
    return server, f"http://{_HERE}:{server.port}/{token}/"


def serve(
    scene: Scene,
    keys: Sequence[str] | None = None,
    *,
    port: int = 0,
    browser: bool = True,
    show_message: Callable[[str], None] = print,
) -> None:
    """Serve the explorer until it is interrupted. ``port`` 0: any free port."""
    # Errors of the computation are raised here, before a server starts.
    page_of(scene, keys)
    server, address = start(scene, keys, port)
    show_message(f"{address}\nend with Ctrl+C")

    def end(*_: object) -> None:
        # Code that ignores exceptions, such as a finalizer, would suppress this one.
        server.io_loop.add_callback(server.io_loop.stop)
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    # Only this user can open the folder.
    with TemporaryDirectory(prefix="viscovib-") as folder:
        with contextlib.suppress(KeyboardInterrupt):
            if browser:
                _open(address, Path(folder))
            server.io_loop.start()
        server.stop()


def _open(address: str, folder: Path) -> None:
    """Open the page by a local file, so that the command line of the browser shows no token."""
    page = folder / "explorer.html"
    text = _LEAD.format(address=html.escape(address))
    with open(os.open(page, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text)
    with contextlib.suppress(webbrowser.Error):
        webbrowser.open(page.as_uri())
