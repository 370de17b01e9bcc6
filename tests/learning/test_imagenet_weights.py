import hashlib
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from lf_flame.learning import imagenet_weights
from lf_flame.learning.imagenet_weights import ImagenetUnavailable, imagenet_file

CONTENT = b"the weights of a network" * 1000


class Handler(BaseHTTPRequestHandler):
    """Gives the file, whole or in part, and may stop in the middle of it."""

    def do_GET(self):
        self.server.asked += 1
        content, stalls = self.server.content, self.server.stalls
        self.send_response(200)
        self.send_header("Content-Length", str(len(CONTENT)))
        self.end_headers()
        self.wfile.write(content)
        self.wfile.flush()
        if stalls:
            self.server.released.wait(30)

    def log_message(self, *args):
        pass


@pytest.fixture
def server(monkeypatch, tmp_path):
    """A server of the file, and a cache that is empty."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.content, server.stalls, server.asked = CONTENT, False, 0
    server.released = threading.Event()
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    monkeypatch.setenv("KERAS_HOME", str(tmp_path))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setattr(imagenet_weights, "ORIGIN", f"http://127.0.0.1:{server.server_port}/")
    monkeypatch.setattr(imagenet_weights, "MD5", hashlib.md5(CONTENT).hexdigest())
    monkeypatch.setattr(imagenet_weights, "TIMEOUT_S", 0.5)
    yield server
    server.released.set()
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.slow
def test_the_file_is_downloaded_once(server, tmp_path):
    path = imagenet_file()
    assert path == tmp_path / "models" / imagenet_weights.NAME
    assert path.read_bytes() == CONTENT
    assert imagenet_file() == path
    assert server.asked == 1
    path.write_bytes(CONTENT[:100])  # damaged: fetched anew
    assert imagenet_file().read_bytes() == CONTENT
    assert server.asked == 2


@pytest.mark.slow
@pytest.mark.parametrize("stalls", [False, True])
def test_half_a_file_is_none_and_nobody_waits_for_the_rest(server, tmp_path, stalls):
    server.content, server.stalls = CONTENT[:5000], stalls
    started = time.perf_counter()
    with pytest.raises(ImagenetUnavailable) as said:
        imagenet_file()
    reason = "timed out" if stalls else "the download is incomplete or not the file"
    assert str(said.value).endswith(f"could not be downloaded into {tmp_path}/models ({reason}).")
    assert time.perf_counter() - started < 10
    assert list((tmp_path / "models").iterdir()) == []
