"""Who may see the page, and who may act on it: only whoever was given an address by the command, on this
machine.

An address carries a key that serves once. For it the browser gets two secrets. One is a cookie, which every
request has to bring. Browsers send cookies to all ports of a machine, so that servers of other users may see
it. The other is kept where scripts of this page alone can read it, and no request carries it but the one that
opens a socket. All that the page shows, and all that it does, goes through sockets.
"""

from __future__ import annotations

import hmac
import json
import secrets
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from typing import Any

from tornado.httputil import HTTPServerRequest
from tornado.routing import AnyMatches, Matcher, Rule, RuleRouter
from tornado.web import Application, OutputTransform, RequestHandler

REFUSED = "This page needs the address that `gtr view` printed, with its token, which serves once.\n"
SOCKET = "/ws"
KEPT = "gtr-view"  # the name under which browsers keep the second secret
MARK = "gtr."  # begins it among the protocols that a socket is asked for with
PROTOCOLS = "Sec-WebSocket-Protocol"
# Pages of other ports count as the same site: they may neither frame this one nor keep a hold on it.
HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
# The page at an address without the token, which histories then do not keep. From a page of this server, as
# browsers do not bring the cookie when a file sent them here.
WELCOME = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>gtr view</title></head><body>
<noscript>The page needs scripts.</noscript>
<script>localStorage.setItem({kept}, {secret}); location.replace("/")</script>
</body></html>
"""


class Guard:
    """The secrets of a page, and who has them.

    Args:
        port: that the page is served on; tells its cookie from those of other pages.
    """

    def __init__(self, port: int) -> None:
        self.cookie = f"gtr-view-{port}"
        self._session, self._acting = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._keys: dict[str, Callable[[], object]] = {}

    def key(self, used: Callable[[], object] = lambda: None) -> str:
        """A key that lets one browser in.

        Args:
            used: called once that has happened.
        """
        key = secrets.token_urlsafe(24)
        self._keys[key] = used
        return key

    def is_new(self, request: HTTPServerRequest) -> bool:
        """Whether a request for the page itself brings a key that has not served yet."""
        return request.method == "GET" and request.path == "/" and self._given(request) is not None

    def is_known(self, request: HTTPServerRequest) -> bool:
        """Whether a request brings the cookie, and, if it opens a socket, the other secret."""
        try:
            kept = SimpleCookie(request.headers.get("Cookie", "")).get(self.cookie)
        except CookieError:
            return False
        if kept is None or not hmac.compare_digest(kept.value.encode(), self._session.encode()):
            return False
        return request.path.rstrip("/") != SOCKET or self._acts(request)

    def around(self, pages: Application) -> RuleRouter:
        """What serves these pages to whoever may see them, and refuses the others."""
        welcome = Application([(r"/", _Welcome, {"guard": self})], transforms=[_Headers])
        refusal = Application([(r".*", _Refusal)], transforms=[_Headers])
        pages.add_transform(_Headers)
        return RuleRouter(
            [
                Rule(_Asks(self.is_new), welcome),
                Rule(_Asks(self.is_known), pages),
                Rule(AnyMatches(), refusal),
            ]
        )

    def let_in(self, handler: RequestHandler) -> str | None:
        """Give a browser the secrets for its key, which then serves no more.

        Returns:
            The page that has it keep the second one; None if another browser was faster.
        """
        key = self._given(handler.request)
        if key is None:
            return None
        used = self._keys.pop(key)
        handler.set_cookie(self.cookie, self._session, expires_days=None, httponly=True, samesite="Strict")
        used()
        return WELCOME.format(kept=json.dumps(KEPT), secret=json.dumps(self._acting))

    def _given(self, request: HTTPServerRequest) -> str | None:
        given = request.query_arguments.get("token", [b""])[-1]
        return next((key for key in self._keys if hmac.compare_digest(given, key.encode())), None)

    def _acts(self, request: HTTPServerRequest) -> bool:
        """Whether a socket is asked for with the second secret, which is taken out of the request: what
        serves the socket knows its own protocols.
        """
        asked = [name.strip() for name in request.headers.get(PROTOCOLS, "").split(",")]
        own = [name.removeprefix(MARK) for name in asked if name.startswith(MARK)]
        if len(own) != 1 or not hmac.compare_digest(own[0].encode(), self._acting.encode()):
            return False
        request.headers[PROTOCOLS] = ", ".join(name for name in asked if not name.startswith(MARK))
        return True


class _Asks(Matcher):
    """Matches the requests of which a function is true."""

    def __init__(self, wanted: Any) -> None:
        self._wanted = wanted

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        """What tornado asks: something for a match, None for none."""
        return {} if self._wanted(request) else None


class _Headers(OutputTransform):
    def transform_first_chunk(
        self, status_code: int, headers: Any, chunk: bytes, finishing: bool
    ) -> tuple[int, Any, bytes]:
        """What an answer says of who may use it, besides what it says itself."""
        for name, value in HEADERS.items():
            headers.setdefault(name, value)
        return status_code, headers, chunk


class _Welcome(RequestHandler):
    def initialize(self, guard: Guard) -> None:
        self._guard = guard

    def get(self) -> None:
        """The secrets, and the way to the page."""
        self.set_header("Cache-Control", "no-store")
        page = self._guard.let_in(self)
        if page is None:
            _refuse(self)
        else:
            self.finish(page)


class _Refusal(RequestHandler):
    def prepare(self) -> None:
        """A refusal, whatever is asked for."""
        _refuse(self)


def _refuse(handler: RequestHandler) -> None:
    handler.set_status(403)
    handler.set_header("Content-Type", "text/plain; charset=utf-8")
    handler.finish(REFUSED)
