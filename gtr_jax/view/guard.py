"""Who may see the page: only whoever has the address that the command printed, on this machine.

The address carries a token. The first request with it gets a cookie, and the address without the token; every
other request, sockets and the page's own scripts included, needs that cookie. Other users of the machine and
pages of other sites have neither.
"""

from __future__ import annotations

import hmac
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Any

from tornado.httputil import HTTPServerRequest
from tornado.routing import AnyMatches, Matcher, Rule, RuleRouter
from tornado.web import Application, RequestHandler

REFUSED = "This page needs the address that `gtr view` printed, with its token.\n"


class Guard:
    """A token, and who has it.

    Args:
        port: that the page is served on; browsers send cookies to all ports of a machine.
    """

    def __init__(self, port: int) -> None:
        self.token = secrets.token_urlsafe(24)
        self.cookie = f"gtr-view-{port}"

    def is_new(self, request: HTTPServerRequest) -> bool:
        """Whether a request for the page itself brings the token in its address."""
        given = request.query_arguments.get("token", [b""])[-1]
        return request.path == "/" and hmac.compare_digest(given, self.token.encode())

    def is_known(self, request: HTTPServerRequest) -> bool:
        """Whether a request brings the cookie."""
        try:
            kept = SimpleCookie(request.headers.get("Cookie", "")).get(self.cookie)
        except CookieError:
            return False
        return kept is not None and hmac.compare_digest(kept.value.encode(), self.token.encode())

    def around(self, pages: Any) -> RuleRouter:
        """What serves these pages (a tornado application) to whoever may see them, and refuses the others."""
        welcome = Application([(r"/", _Welcome, {"guard": self})])
        refusal = Application([(r".*", _Refusal)])
        return RuleRouter(
            [
                Rule(_Asks(self.is_new), welcome),
                Rule(_Asks(self.is_known), pages),
                Rule(AnyMatches(), refusal),
            ]
        )


class _Asks(Matcher):
    """Matches the requests of which a function is true."""

    def __init__(self, wanted: Any) -> None:
        self._wanted = wanted

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        """What tornado asks: something for a match, None for none."""
        return {} if self._wanted(request) else None


class _Welcome(RequestHandler):
    def initialize(self, guard: Guard) -> None:
        self._guard = guard

    def get(self) -> None:
        """The cookie, and the page at an address without the token, which histories then do not keep."""
        self.set_cookie(
            self._guard.cookie, self._guard.token, expires_days=None, httponly=True, samesite="Strict"
        )
        self.redirect("/")


class _Refusal(RequestHandler):
    def prepare(self) -> None:
        """A refusal, whatever is asked for."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(REFUSED)
