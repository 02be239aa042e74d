"""Control access to the server by a token and by host names, and refuse requests from other sites."""

from __future__ import annotations

import hmac
import html
import ipaddress
import secrets
import socket
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kinedex.explorer.answers import error_json

MAX_BYTES = 4 * 2**20
"""The largest body of a request that is accepted, in bytes."""

EVERYWHERE = ("0.0.0.0", "::")
"""Hosts that mean all addresses of this machine."""

LOOPBACK = ("localhost", "127.0.0.1", "::1")

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'nonce-{nonce}'; img-src 'self' data: blob:; "
    "connect-src 'self'; font-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""The Content-Security-Policy: pages load from this server only and run no inline scripts; styles need the nonce."""

HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "x-frame-options": "DENY",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}
"""The security headers that every response gets."""


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(24)


@dataclass(frozen=True)
class Rules:
    """The rules by which requests are admitted.

    Attributes
    ----------
    token : str
        The token that every request needs: once in the address, then in a cookie, or as a bearer token.
    port : int
        The port, which is part of the cookie's name, so that servers on one machine do not share a cookie.
    hosts : frozenset of str
        Host names that are accepted in the header Host; any IP address is too, if `open_to_others`.
    open_to_others : bool
        True if the server listens on more than the loopback device.
    """

    token: str
    port: int
    hosts: frozenset[str] = frozenset(LOOPBACK)
    open_to_others: bool = False
    cookie: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cookie", f"kinedex-{self.port}")

    @classmethod
    def for_host(cls, token: str, host: str, port: int) -> Rules:
        """Return the rules of a server that listens on a host."""
        if is_loopback(host):
            return cls(token, port, frozenset({*LOOPBACK, host}))
        names = {*LOOPBACK, host, socket.gethostname(), socket.getfqdn()}
        return cls(token, port, frozenset(name.lower() for name in names), open_to_others=True)

    def is_known_host(self, header: str) -> bool:
        """Return whether a header Host names this server.

        The port may differ, as it does behind a tunnel. Other names are refused, as they are a sign of DNS rebinding.
        """
        name = _host_name(header)
        return name in self.hosts or (self.open_to_others and _is_address(name))

    def is_known(self, request: Request) -> bool:
        """Return whether a request brings the token in its cookie or as a bearer token."""
        kind, _, bearer = request.headers.get("authorization", "").partition(" ")
        given = bearer.strip() if kind.lower() == "bearer" else request.cookies.get(self.cookie, "")
        return self.is_token(given)

    def is_token(self, given: str) -> bool:
        """Return whether a text is the token, in a time that does not depend on the text."""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())


def is_loopback(host: str) -> bool:
    """Return whether a host is a loopback address, which other machines cannot reach."""
    if host == "localhost":
        return True
    return _is_address(host) and ipaddress.ip_address(host).is_loopback


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _host_name(header: str) -> str:
    """Return the name in a header Host, without its port and brackets."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def is_cross_site(request: Request) -> bool:
    """Return whether another site made a request.

    A browser reports the site in Sec-Fetch-Site, and in Origin with all methods but GET and HEAD. Plain
    navigation to the page is allowed from any site, because its data is shown to this browser alone.
    """
    origin = request.headers.get("origin")
    host = request.headers.get("host", "")
    if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return True
    if request.headers.get("sec-fetch-site", "same-origin") in ("same-origin", "none"):
        return False
    navigation = request.headers.get("sec-fetch-mode") == "navigate"
    return not (navigation and request.method == "GET" and not request.url.path.startswith("/api/"))


class Access:
    """Refuse requests that break the rules before the application sees them; add security headers to all responses.

    Parameters
    ----------
    app : ASGI application
        The application that is protected.
    rules : Rules
        The rules by which requests are admitted.
    """

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        self.app = app
        self.rules = rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        request = Request(scope)
        nonce = scope.setdefault("state", {})["nonce"] = secrets.token_urlsafe(16)
        answer = self._refusal(request)
        started = False

        async def send_safely(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                _add_headers(message, {**HEADERS, "content-security-policy": POLICY.format(nonce=nonce)})
            await send(message)

        if answer is not None:
            await answer(scope, receive, send_safely)
            return
        try:
            await self.app(scope, _Bounded(receive), send_safely)
        except Exception:
            # the application has answered and logged the fault, and raises it again for the server's own log
            if not started:
                raise

    def _refusal(self, request: Request) -> Response | None:
        """Return the response that refuses or redirects a request; None if the request is admitted."""
        rules = self.rules
        if not rules.is_known_host(request.headers.get("host", "")):
            names = ", ".join(sorted(rules.hosts))
            return error_json(
                403, "AccessError", f"this server is not known by the name in the address; its names: {names}"
            )
        if is_cross_site(request):
            return error_json(403, "AccessError", "requests of other sites are refused")
        length = request.headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MAX_BYTES:
            return too_long_response()
        given = dict(parse_qsl(request.url.query)).get("token")
        if given is not None and request.method == "GET" and rules.is_token(given):
            return self._admission(request)
        if rules.is_known(request):
            return None
        if request.url.path.startswith("/api/"):
            return error_json(401, "AccessError", f"the token is missing or wrong; {WAY_IN}")
        return HTMLResponse(_PAGE.format(text=html.escape(WAY_IN)), 401)

    def _admission(self, request: Request) -> Response:
        """Return a redirect to the same address without the token, which sets the token as a cookie."""
        rest = [pair for pair in parse_qsl(request.url.query, keep_blank_values=True) if pair[0] != "token"]
        path = "/" + request.url.path.lstrip("/")
        answer = RedirectResponse(f"{path}?{urlencode(rest)}" if rest else path, 303)
        answer.set_cookie(self.rules.cookie, self.rules.token, httponly=True, samesite="strict", path="/")
        answer.headers["cache-control"] = "no-store"
        return answer


WAY_IN = "open the whole address that `kinedex explore` printed, with its token; it changes with every start"

_PAGE = "<!doctype html><html lang=en><meta charset=utf-8><title>kinedex</title><h1>kinedex</h1><p>{text}</p></html>"


class TooLongError(Exception):
    """The body of a request is longer than the server accepts."""


def too_long_response() -> Response:
    """Return the answer to a request whose body is too long."""
    return error_json(413, "ParameterError", f"the request is longer than {MAX_BYTES // 2**20} MiB; ask for less")


class _Bounded:
    """The body of a request; it raises TooLongError when it exceeds the limit, even if Content-Length does not."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._bytes = 0

    async def __call__(self) -> Message:
        message = await self._receive()
        self._bytes += len(message.get("body", b""))
        if self._bytes > MAX_BYTES:
            raise TooLongError
        return message


def _add_headers(message: Message, headers: dict[str, str]) -> None:
    """Add headers to an answer that does not have them yet."""
    known = {name.lower() for name, _ in message["headers"]}
    message["headers"] = [
        *message["headers"],
        *((name.encode(), value.encode()) for name, value in headers.items() if name.encode() not in known),
    ]


def address(rules: Rules, host: str) -> str:
    """Return the address that opens the page, with the token."""
    name = socket.gethostname() if host in EVERYWHERE else host
    return f"http://{f'[{name}]' if ':' in name else name}:{rules.port}/?token={rules.token}"
