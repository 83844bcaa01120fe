"""The explorer in a notebook, or in the background of a Python session."""

import html
import os
import threading
from collections.abc import Sequence
from typing import Any

from viscovib.common.parameters import Names, Whole
from viscovib.errors import InputError
from viscovib.scene.scene import Scene

_KEYS, _PORT = Names("keys"), Whole("port", 0, 65535)
#: Height of the frame in a notebook (pixels), and longest start of a server (s).
_HEIGHT, _PATIENCE = 900, 60.0


class Explorer:
    """A page with sliders that is served until `stop`, or until Python ends.

    In a notebook it is a frame below the cell. Otherwise open `address` in a browser.

    Attributes
    ----------
    address : str
        Address of the page: on this machine only, with a secret token. Over ssh, forward its port.

    Examples
    --------
    >>> import viscovib as vv
    >>> page = vv.explore("data/scenes/mount_paper.nml")
    >>> page.address.startswith("http://127.0.0.1:")
    True
    >>> page.stop()

    See Also
    --------
    explore
    """

    address: str

    def __init__(self, scene: Scene, keys: Sequence[str] | None, port: int) -> None:
        self._started = threading.Event()
        self._failed: BaseException | None = None
        self._server: Any = None
        self._loop: Any = None
        threading.Thread(target=self._serve, args=(scene, keys, port), daemon=True).start()
        self._started.wait(_PATIENCE)
        if self._failed is not None:
            raise self._failed

    def _serve(self, scene: Scene, keys: Sequence[str] | None, port: int) -> None:
        import asyncio

        from viscovib.explorer.server import start

        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            self._server, self.address = start(scene, keys, port)
        except BaseException as error:
            self._failed = error
            return
        finally:
            self._started.set()
        self._loop = self._server.io_loop
        self._loop.start()

    def stop(self) -> None:
        """End the server. The page remains visible and no longer updates."""
        if self._server is not None:
            self._loop.add_callback(self._server.stop)
            self._loop.add_callback(self._loop.stop)
            self._server = None

    def __repr__(self) -> str:
        """Return a text with the address of the page."""
        return f"<Explorer: {self.address}>"

    def _repr_html_(self) -> str:
        """Return the page as a frame, for notebooks."""
        address = html.escape(self.address)
        return (
            f"<iframe src='{address}' title='viscovib explorer' width='100%' height='{_HEIGHT}' "
            f"style='border:1px solid #c4c4c4'></iframe><p><a href='{address}'>{address}</a></p>"
        )


def explore(
    scene: Scene | str | os.PathLike[str], *, keys: Sequence[str] | None = None, port: int = 0
) -> Explorer:
    """Open a scene as a page with a slider for each of its numbers.

    Parameters
    ----------
    scene : Scene or path
    keys : sequence of str, optional
        Numbers with a slider, such as "mount.stiffness_x"; by default all, at most 40.
    port : int
        Port of the server on this machine; 0: any free port.

    Returns
    -------
    Explorer
        A frame in a notebook; open its ``address`` in any browser of this machine.

    Raises
    ------
    InputError
        If a key is unknown, the port is taken, the scene cannot be computed, or Bokeh is not
        installed (``pip install 'viscovib[explore]'``).

    Examples
    --------
    >>> import viscovib as vv
    >>> page = vv.explore("data/scenes/mount_paper.nml", keys=["mount.mass", "load.amplitude"])
    >>> page.stop()

    See Also
    --------
    run, Scene
    """
    read = scene if isinstance(scene, Scene) else Scene.read(scene)
    wanted = None if keys is None else _KEYS.check(list(keys))
    place = _PORT.check(port)
    try:
        from viscovib.explorer.server import page_of
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in ("bokeh", "jinja2", "tornado"):
            raise
        raise InputError(
            "explore: needs the package bokeh: pip install 'viscovib[explore]'"
        ) from None
    # Errors of the computation are raised here.
    page_of(read, wanted)
    return Explorer(read, wanted, place)
