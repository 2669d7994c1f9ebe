"""Addresses at which there is no cluster, and no Ray: one line, at once."""

import http.server
import re
import sys
import threading

import pytest

from tests.cluster.conftest import of_ray
from tests.shell import TINY, run

RAY = ["seed=0,1", "hydra/launcher=ray"]


def refused(*args: str) -> str:
    """What a sweep says that cannot begin."""
    before = of_ray()
    done = run("train", "-m", *TINY, *RAY, *args)
    assert done.returncode == 1
    assert done.stdout == ""
    assert not {*of_ray()} - {*before}
    (line,) = done.stderr.splitlines()
    return line


@pytest.fixture
def web_page():
    server = http.server.HTTPServer(("127.0.0.1", 0), http.server.SimpleHTTPRequestHandler)
    server.RequestHandlerClass.log_message = lambda *_: None
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("127.0.0.1:1", "Connection refused"),
        ("nowhere", "ray start --head"),
        ("127.0.0.1:port", "ray start --head"),
    ],
)
def test_an_address_that_is_no_cluster_is_one_line(address, reason):
    line = refused(f"hydra.launcher.address='{address}'")
    assert re.match("error: hydra.launcher.address must be HOST:PORT of a running Ray", line)
    assert address in line
    assert reason in line


def test_an_address_of_something_else_is_one_line(web_page):
    assert "something else answers there" in refused(f"hydra.launcher.address='{web_page}'")


def test_without_ray_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert "pip install 'zfall[ray]'" in refused("hydra.launcher.address=auto")


@pytest.mark.parametrize(
    "value", ["cpus=0", "cpus=1.5", "gpus=-1", "memory=0", "retries=-1", "every=0", "retires=3"]
)
def test_a_value_that_no_job_can_have_is_one_line(value):
    assert f"hydra.launcher.{value.partition('=')[0]}" in refused(f"hydra.launcher.{value}")
