"""Access to the page: from this machine only, with the token of this run.

Any page that is open in the browser can send requests to 127.0.0.1, and a name that resolves to it
makes them look local (DNS rebinding). Every request and every websocket therefore needs the host
name that was bound, an origin that is the page itself, and the token: in the address at the first
visit, in a cookie from then on.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

_Scope = MutableMapping[str, Any]
_Application = Callable[[_Scope, Any, Any], Awaitable[None]]

_ALWAYS = [(b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff")]
_PLAIN = (b"content-type", b"text/plain; charset=utf-8")
_HEADERS = [(b"cache-control", b"no-store"), _PLAIN, *_ALWAYS]
_REFUSAL = b"This page needs the whole address that hamsym explore printed, with its token.\n"
# Nothing is fetched from another machine; Vue compiles its templates, which counts as eval, and
# the code of H is a module from memory.
_POLICY = (
    b"default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    b"style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    b"connect-src 'self'; frame-ancestors 'none'; base-uri 'self'; form-action 'self'"
)


def new_token() -> str:
    """Return a token that cannot be guessed."""
    return secrets.token_urlsafe(32)


class Guard:
    """An ASGI application in front of another, which refuses what does not come from the page.

    - port: That the server is bound to.
    """

    def __init__(self, app: _Application, token: str, port: int) -> None:
        self.app = app
        self._token = token
        self._cookie = f"hamsym_{port}"  # cookies of a host are shared by its ports
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        if port == 80:
            self._hosts |= {"127.0.0.1", "localhost"}

    async def __call__(self, scope: _Scope, receive: Any, send: Any) -> None:
        """Serve, redirect or refuse a request."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        if not self._from_page(headers):
            await self._refuse(scope, send)
        elif self._is_token(self._cookie_of(headers)):
            await self.app(scope, receive, self._with_policy(send))
        elif scope["type"] == "http" and self._is_token(query.get("token", [""])[0]):
            await self._admit(send)
        else:
            await self._refuse(scope, send)

    def _from_page(self, headers: dict[bytes, str]) -> bool:
        if headers.get(b"host", "").lower() not in self._hosts:
            return False
        origin = headers.get(b"origin")
        return origin is None or origin.lower() in {f"http://{host}" for host in self._hosts}

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())

    def _cookie_of(self, headers: dict[bytes, str]) -> str:
        try:
            cookie = SimpleCookie(headers.get(b"cookie", ""))
        except CookieError:
            return ""
        return cookie[self._cookie].value if self._cookie in cookie else ""

    async def _admit(self, send: Any) -> None:
        """Set the cookie and lead to the address without the token, which stays out of history."""
        cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        headers = [*_HEADERS, (b"location", b"/"), (b"set-cookie", cookie.encode())]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    async def _refuse(self, scope: _Scope, send: Any) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})  # before accepting: status 403
            return
        await send({"type": "http.response.start", "status": 403, "headers": _HEADERS})
        await send({"type": "http.response.body", "body": _REFUSAL})

    def _with_policy(self, send: Any) -> Any:
        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                added = [(b"content-security-policy", _POLICY), *_ALWAYS]
                message = {**message, "headers": [*message.get("headers", []), *added]}
            await send(message)

        return sending
