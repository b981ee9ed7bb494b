"""The server of the page, on the loopback interface."""

from __future__ import annotations

import gc
import socket
import webbrowser
from collections.abc import Callable

from hamsym.errors import InputError
from hamsym.workbench.explore.access import Guard, new_token
from hamsym.workbench.explore.messages import Setting

_HOST = "127.0.0.1"


def explore(
    formula: str = "",
    *,
    port: int = 0,
    browser: bool = True,
    announce: Callable[[str], None] = print,
) -> None:
    """Serve the page until Ctrl-C.

    Raise InputError if the packages of the page are missing, or the port is taken.

    - formula: The H that a new tab begins with; by default an oscillator.
    - port: 0 for a free one.
    - browser: Open the page in the browser.
    - announce: Takes the address, once the port is bound.
    """
    try:
        import nicegui
    except ImportError:
        raise InputError('the page needs nicegui; run pip install "hamsym[explore]"') from None
    import uvicorn
    from fastapi import FastAPI
    from nicegui import ui

    bound = _bound_socket(port)
    from hamsym.workbench.explore.session import FIRST, Sessions

    sessions = Sessions(Setting(formula) if formula else FIRST)
    from hamsym.workbench.explore.page import build

    port = bound.getsockname()[1]
    token = new_token()
    app = FastAPI(openapi_url=None)
    ui.run_with(
        app,
        root=lambda: build(sessions),
        title="hamsym explore",
        language="en-US",
        tailwind=False,
        reconnect_timeout=5.0,
        message_history_length=50,  # of up to a hundred kilobytes each
        show_welcome_message=False,
    )
    nicegui.app.on_shutdown(sessions.close_all)
    config = uvicorn.Config(
        Guard(app, token, port),
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=1,
        server_header=False,
    )
    # Imported objects stay; looking through them would take a tenth of a second at times.
    gc.collect()
    gc.freeze()
    address = f"http://{_HOST}:{port}/?token={token}"
    announce(address)
    if browser:
        webbrowser.open(address)  # the bound socket queues the request until the server runs
    try:
        uvicorn.Server(config).run(sockets=[bound])
    except KeyboardInterrupt:
        pass
    finally:
        bound.close()
        sessions.close_all()


def _bound_socket(port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise InputError(f"port {port} does not exist; give one from 1024 to 65535, or 0")
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((_HOST, port))
        bound.listen()
    except OSError as error:
        bound.close()
        raise InputError(
            f"port {port} cannot be used ({error.strerror}); give another one, or 0"
        ) from None
    return bound
