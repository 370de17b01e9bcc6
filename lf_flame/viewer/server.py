"""The program that serves one page, on this machine and to whoever knows its token."""

import secrets
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock
from typing import Any

from lf_flame.errors import InputError
from lf_flame.viewer.exhibit import Exhibit, cut_into_pieces, piece_bytes
from lf_flame.viewer.page import SERVED_POLICY, served_page
from lf_flame.viewer.scripts import MEDIA_TYPES, read_static, static_names

HOST = "127.0.0.1"


@dataclass(frozen=True)
class _Answer:
    body: bytes
    media_type: str = "application/octet-stream"


class ViewerServer(ThreadingHTTPServer):
    """Serves an exhibit on 127.0.0.1, to requests whose path begins with a random token.

    Every name that it answers is known before it starts: no request becomes a path of a file.

    Parameters
    ----------
    exhibit : Exhibit
    port : int, optional
        Default: any that is free.

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
        self._map_lock = Lock()
        self._answers = self._known_answers()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over pages that were closed before they had their answer; tell the rest."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """Host and port."""
        return f"{HOST}:{self.server_port}"

    @property
    def url(self) -> str:
        """Address of the page, token included."""
        return f"http://{self.address}/{self.token}/"

    def _known_answers(self) -> dict[str, Callable[[], _Answer]]:
        """List what is answered to each name, made when it is asked for."""
        exhibit = self._exhibit
        answers: dict[str, Callable[[], _Answer]] = {"": partial(_page, exhibit)}
        for name in static_names():
            answers[f"static/{name}"] = partial(_static, name)
        for number, piece in enumerate(cut_into_pieces(exhibit.coded)):
            answers[f"views/{number}"] = partial(_views, exhibit, piece)
        if exhibit.with_map:
            answers["map"] = self._slope_map
        return answers

    def _slope_map(self) -> _Answer:
        with self._map_lock:  # made once, however many pages ask
            return _Answer(self._exhibit.map_bytes())

    def answer(self, path: str) -> _Answer | None:
        """Give what a path asks for; nothing, without the token or for an unknown name."""
        start, _, name = path.partition("?")[0].removeprefix("/").partition("/")
        if not secrets.compare_digest(start.encode(), self.token.encode()):
            return None
        found = self._answers.get(name)
        return found() if found else None


def _page(exhibit: Exhibit) -> _Answer:
    return _Answer(served_page(exhibit).encode(), "text/html; charset=utf-8")


def _views(exhibit: Exhibit, piece: tuple[int, int]) -> _Answer:
    return _Answer(piece_bytes(exhibit.coded, piece))


def _static(name: str) -> _Answer:
    suffix = name[name.rindex(".") :]
    return _Answer(read_static(name).encode(), f"{MEDIA_TYPES[suffix]}; charset=utf-8")


class _Handler(BaseHTTPRequestHandler):
    """Answers GET requests that this machine's browser makes for the page itself."""

    server: ViewerServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        """Answer a request, or refuse it."""
        if not self._is_our_page():
            self._send(HTTPStatus.FORBIDDEN, _Answer(b"Another page asked.", "text/plain"))
            return
        try:
            answer = self.server.answer(self.path)
        except InputError as error:
            answer = _Answer(str(error).encode(), "text/plain; charset=utf-8")
            self._send(HTTPStatus.INTERNAL_SERVER_ERROR, answer)
            return
        if answer is None:
            self._send(HTTPStatus.NOT_FOUND, _Answer(b"There is no such thing.", "text/plain"))
        else:
            self._send(HTTPStatus.OK, answer)

    def _is_our_page(self) -> bool:
        """Whether the request was meant for this server, and not sent by another site's page."""
        host, origin = self.headers.get("Host"), self.headers.get("Origin")
        site = self.headers.get("Sec-Fetch-Site", "none")
        return (
            host == self.server.address
            and origin in (None, f"http://{self.server.address}")
            and site in ("same-origin", "none")
        )

    def _send(self, status: HTTPStatus, answer: _Answer) -> None:
        self.send_response(status)
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
        """Say nothing: the terminal belongs to the command."""
