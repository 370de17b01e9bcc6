"""The local page: what it serves, and to whom."""

import http.client
from threading import Thread

import pytest

from lf_flame import InputError
from lf_flame.viewer.server import ViewerServer


@pytest.fixture
def server(make_exhibit):
    """A server that runs."""
    with ViewerServer(make_exhibit((5, 5, 30, 40), with_map=True)) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(server, path, method="GET", **headers):
    """Status and body of an answer."""
    connection = http.client.HTTPConnection(server.address)
    connection.request(method, path, headers={"Host": server.address, **headers})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body, dict(answer.getheaders())


def test_it_listens_to_this_machine_alone(server):
    assert server.server_address[0] == "127.0.0.1"


def test_without_the_token_there_is_nothing(server):
    for path in ("/", "/views/0", f"/{server.token[:-1]}/", f"/{server.token}x/", "//", ""):
        assert ask(server, path or "/")[0] == 404
    assert ask(server, f"/{server.token}/views/0")[0] == 200


@pytest.mark.parametrize(
    "path",
    ["../setup.cfg", "static/../../__init__.py", "static/%2e%2e/page.py", "views/-1", "views/99",
     "/etc/passwd", "static/page.html", "views/0/../../"],
)  # fmt: skip
def test_there_is_nothing_but_the_light_field(server, path):
    assert ask(server, f"/{server.token}/{path}")[0] == 404


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "localhost.evil.example:80"},
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_other_pages_are_refused(server, headers):
    status, body, _ = ask(server, f"/{server.token}/", **headers)
    assert (status, body) == (403, b"A request of another page.")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "HEAD"])
def test_nothing_but_reading_is_possible(server, method):
    assert ask(server, f"/{server.token}/", method)[0] == 501


def test_answers_forbid_all_else(server):
    headers = ask(server, f"/{server.token}/")[2]
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"


def test_what_cannot_be_made_is_told_to_the_page(server, monkeypatch, capfd):
    def refuse():
        raise InputError("There is no room for a slope map.")

    monkeypatch.setattr(type(server._exhibit), "map_bytes", lambda exhibit: refuse())
    status, body, _ = ask(server, f"/{server.token}/map")
    assert (status, body) == (500, b"There is no room for a slope map.")


def test_a_page_that_is_closed_early_is_no_traceback(server, capfd):
    for error, told in ((BrokenPipeError(), False), (ValueError("ours"), True)):
        try:
            raise error
        except type(error):
            server.handle_error(None, ("127.0.0.1", 1))
        assert ("Traceback" in capfd.readouterr().err) is told


def test_a_port_in_use_is_one_sentence(server, make_exhibit):
    with pytest.raises(InputError, match="cannot be opened"):
        ViewerServer(make_exhibit((3, 3, 8, 9)), server.server_port)
