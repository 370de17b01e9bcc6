"""Server of one page, on this machine, for requests with its token."""

import secrets
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from lf_flame.errors import InputError
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.page import SERVED_POLICY, served_page
from lf_flame.viewer.scripts import MEDIA_TYPES, read_static, static_names

HOST = "127.0.0.1"


@dataclass(frozen=True)
class _Answer:
    body: bytes
    media_type: str = "application/octet-stream"
    status: HTTPStatus = HTTPStatus.OK


class ViewerServer(ThreadingHTTPServer):
    """Serves an exhibit on 127.0.0.1, for requests whose path begins with a random token.

    All names that it answers are known before it starts: no request becomes the path of a file.

    Parameters
    ----------
    exhibit : Exhibit
    port : int, optional
        Port. Default: any free port.

    Raises
    ------
    InputError
        If the port is in use.
    """

    daemon_threads = True

    def __init__(self, exhibit: Exhibit, port: int = 0):
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise InputError(f"Port {port} cannot be opened: {error.strerror}.") from None
        self.token = secrets.token_urlsafe(16)
        self._exhibit = exhibit
        self._answers: dict[str, Callable[[], _Answer]] = {"": partial(_page, exhibit)}
        for name in static_names():
            self._answers[f"static/{name}"] = partial(_static, name)
        for name, make in exhibit.data().items():
            self._answers[name] = partial(_made, make)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore pages that were closed before their answer; report other errors."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """Host and port."""
        return HOST if self.server_port == 80 else f"{HOST}:{self.server_port}"  # as browsers do

    @property
    def url(self) -> str:
        """Address of the page, token included."""
        return f"http://{self.address}/{self.token}/"

    def answer(self, path: str) -> _Answer | None:
        """Answer for a path; None without the token, or for an unknown name."""
        start, _, name = path.partition("?")[0].removeprefix("/").partition("/")
        if not secrets.compare_digest(start.encode(), self.token.encode()):
            return None
        return self._answers[name]() if name in self._answers else None


def _page(exhibit: Exhibit) -> _Answer:
    return _Answer(served_page(exhibit).encode(), "text/html; charset=utf-8")


def _made(make: Callable[[], bytes]) -> _Answer:
    try:
        return _Answer(make())
    except InputError as error:
        status = HTTPStatus.INTERNAL_SERVER_ERROR
        return _Answer(str(error).encode(), "text/plain; charset=utf-8", status)


def _static(name: str) -> _Answer:
    suffix = name[name.rindex(".") :]
    return _Answer(read_static(name).encode(), f"{MEDIA_TYPES[suffix]}; charset=utf-8")


class _Handler(BaseHTTPRequestHandler):
    """Answers GET requests of this machine's browser for the page itself."""

    server: ViewerServer
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else an answer's body waits 40 ms for an acknowledgement

    def do_GET(self) -> None:
        """Answer a request, or refuse it."""
        if not self._is_our_page():
            self._send(_Answer(b"A request of another page.", "text/plain", HTTPStatus.FORBIDDEN))
            return
        missing = _Answer(b"Not found.", "text/plain", HTTPStatus.NOT_FOUND)
        self._send(self.server.answer(self.path) or missing)

    def _is_our_page(self) -> bool:
        """Whether the request was meant for this server, and not sent by another site's page."""
        host, origin = self.headers.get("Host"), self.headers.get("Origin")
        site = self.headers.get("Sec-Fetch-Site", "none")
        return (
            host == self.server.address
            and origin in (None, f"http://{self.server.address}")
            and site in ("same-origin", "none")
        )

    def _send(self, answer: _Answer) -> None:
        self.send_response(answer.status)
        self.send_header("Content-Type", answer.media_type)
        self.send_header("Content-Length", str(len(answer.body)))
        self.send_header("Content-Security-Policy", SERVED_POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(answer.body)

    def log_message(self, *_) -> None:
        """Log nothing: the terminal belongs to the command."""
