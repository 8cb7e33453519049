"""A small server on this machine that shows one log in a browser, for `canlog open`."""

import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qsl, urlsplit

from canlog.damage import LogError
from canlog.views.answers import Answers
from canlog.views.serving import LOOPBACK, PAGE, POLICY


class LogServer(ThreadingHTTPServer):
    """Listens on the loopback interface only."""

    daemon_threads = True

    def __init__(self, port: int, page: str, answers: Answers) -> None:
        """Listen on `port`, or a free one for 0. Raises LogError if it is taken or not allowed."""
        self.page = page.encode("utf-8")
        self.answers = answers
        self.turn = threading.Lock()
        try:
            super().__init__((LOOPBACK, port), _Request)
        except OSError as error:
            raise LogError(f"--port {port}: {error.strerror}") from error
        except OverflowError as error:
            raise LogError(f"--port {port}: has to be from 0 to 65535") from error

    @property
    def address(self) -> str:
        return f"http://{LOOPBACK}:{self.server_port}/"

    @property
    def names(self) -> tuple[str, ...]:
        """Accepted host names: a page of another site can only reach the server by another name."""
        return f"{LOOPBACK}:{self.server_port}", f"localhost:{self.server_port}"


class _Request(BaseHTTPRequestHandler):
    server: LogServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        if self.headers.get("Host") not in self.server.names:
            self._send(HTTPStatus.FORBIDDEN, "text/plain", b"unknown host name\n")
            return
        asked = urlsplit(self.path)
        if asked.path == "/":
            self._send(HTTPStatus.OK, PAGE, self.server.page)
            return
        query = dict(parse_qsl(asked.query, keep_blank_values=True))
        try:
            with self.server.turn:
                found = self.server.answers.answer(asked.path, query)
        except LogError as error:
            self._send(HTTPStatus.BAD_REQUEST, "text/plain; charset=utf-8", str(error).encode())
            return
        if found is None:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"unknown path\n")
        else:
            self._send(HTTPStatus.OK, *found)

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing: the terminal belongs to the user."""
        del format, args
