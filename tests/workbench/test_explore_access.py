"""Tests of who may use the page."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from hamsym.workbench.explore.access import Guard, new_token

PORT, TOKEN = 8123, "secret-token"
HOST = f"127.0.0.1:{PORT}"


async def _page(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"page"})


def _ask(kind: str = "http", query: str = "", **headers: str) -> list[dict[str, Any]]:
    """Return what the guard sends back for a request."""
    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    given = {"host": HOST, **headers}
    scope = {
        "type": kind,
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in given.items()],
    }
    asyncio.run(Guard(_page, TOKEN, PORT)(scope, None, send))
    return sent


COOKIE = f"hamsym_{PORT}={TOKEN}"


def _status(sent: list[dict[str, Any]]) -> int:
    return sent[0]["status"]


def test_token_in_the_address_sets_a_cookie():
    sent = _ask(query=f"token={TOKEN}")
    headers = dict(sent[0]["headers"])
    assert _status(sent) == 303
    assert headers[b"location"] == b"/"  # without the token
    cookie = headers[b"set-cookie"].decode()
    assert cookie.startswith(COOKIE)
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie


def test_cookie_opens_the_page():
    sent = _ask(cookie=f"other=1; {COOKIE}")
    assert _status(sent) == 200
    assert sent[1]["body"] == b"page"
    policy = dict(sent[0]["headers"])[b"content-security-policy"]
    assert b"default-src 'self'" in policy


@pytest.mark.parametrize(
    "request_",
    [
        {},
        {"query": "token="},
        {"query": "token=wrong"},
        {"query": f"token={TOKEN}x"},
        {"cookie": f"hamsym_{PORT}=wrong"},
        {"cookie": f"hamsym_{PORT + 1}={TOKEN}"},
        {"cookie": "\x00;;=="},
        {"cookie": COOKIE, "host": "evil.example"},
        {"cookie": COOKIE, "host": f"evil.example:{PORT}"},
        {"cookie": COOKIE, "host": f"127.0.0.1:{PORT + 1}"},
        {"cookie": COOKIE, "host": ""},
        {"cookie": COOKIE, "origin": "http://evil.example"},
        {"cookie": COOKIE, "origin": "null"},
        {"query": f"token={TOKEN}", "host": f"evil.example:{PORT}"},
    ],
)
def test_other_requests_are_refused(request_):
    sent = _ask(**request_)
    assert _status(sent) == 403
    assert b"token" in sent[1]["body"]
    assert TOKEN.encode() not in sent[1]["body"]


def test_websockets_need_cookie_and_origin():
    origin = f"http://{HOST}"
    assert _ask("websocket", cookie=COOKIE, origin=origin)[0]["type"] == "http.response.start"
    for headers in ({}, {"cookie": COOKIE, "origin": "http://evil.example"}):
        assert _ask("websocket", **headers)[0]["type"] == "websocket.close"
    # A websocket cannot be led to another address: the token alone is not enough.
    assert _ask("websocket", query=f"token={TOKEN}")[0]["type"] == "websocket.close"


def test_tokens_differ_and_are_long():
    assert new_token() != new_token()
    assert len(new_token()) >= 40
