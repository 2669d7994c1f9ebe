"""The page as a browser sees it; skipped with a reason where something for that is missing."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from recipes.playground import SOURCES
from tests.shell import run

FLAGS = [
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader"),
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright: make setup")
    with api.sync_playwright() as playwright:
        path = shutil.which("chromium") or playwright.chromium.executable_path
        if not Path(path).exists():
            pytest.skip("needs Chromium: python -m playwright install chromium")
        started = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield started
        started.close()


@pytest.fixture(scope="module")
def build_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., str]]:
    """Builds the page of a policy, once, and serves it as plain files; gives its address."""
    if not (SOURCES / "node_modules" / ".of-lock").exists():
        pytest.skip("needs the page's libraries: make playground")
    pytest.importorskip("onnxscript")
    servers: dict[tuple[str, ...], tuple[subprocess.Popen[str], str]] = {}

    def build(*words: str) -> str:
        if words in servers:
            return servers[words][1]
        folder = tmp_path_factory.mktemp("page")
        done = run("playground", f"out={folder}", *words, f"hydra.run.dir={folder.parent}/run")
        assert done.returncode == 0, done.stderr
        command = [sys.executable, "-u", "-m", "http.server", "0", "--directory", str(folder)]
        server = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert server.stdout is not None
        port = server.stdout.readline().split(" port ")[1].split()[0]
        servers[words] = server, f"http://localhost:{port}/"
        return servers[words][1]

    yield build
    for server, _ in servers.values():
        with server:
            server.terminate()


@pytest.fixture(scope="module")
def site(build_site: Callable[..., str]) -> str:
    """Address of the page as it is built without options."""
    return build_site()


@pytest.fixture
def open_page(browser: Any, site: str) -> Iterator[Callable[..., Any]]:
    """Opens the page; what its console says is in ``said``, the addresses it asks in ``asked``."""
    pages: list[Any] = []

    def open_at(
        width: int = 640, before: Callable[[Any], None] = lambda page: None, url: str = site
    ) -> Any:
        page = browser.new_page(viewport={"width": width, "height": 480})
        pages.append(page)
        page.said, page.asked = [], []
        page.on("console", lambda line: page.said.append(f"{line.type}: {line.text}"))
        page.on("pageerror", lambda error: page.said.append(f"error: {error}"))
        page.on("response", lambda answer: page.asked.append((answer.url, answer.status)))
        page.set_default_timeout(120_000)
        before(page)
        page.goto(url)
        return page

    yield open_at
    for page in pages:
        page.close()
