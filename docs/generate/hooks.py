"""What mkdocs calls while it builds the site, see ``mkdocs.yml``."""

from pathlib import Path
from typing import Any

import links
import notebooks
import parts
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ORIGINS: dict[str, Path] = {}  # of pages that lie elsewhere in the clone


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Anchors are GitHub's, so that links work there and here."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = links.anchor
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds what is generated: reference, notebooks, cards, and the code that pages link to."""
    ORIGINS.clear()

    def put(page: str, content: str | bytes) -> None:
        files.append(File.generated(config, page, content=content))

    for page, text in parts.pages().items():
        put(page, text)
    for path in sorted((links.DOCS / "notebooks").glob("*.ipynb")):
        files.remove(files.src_uris[f"notebooks/{path.name}"])
        text, pictures = notebooks.page(path)
        ORIGINS[f"notebooks/{path.stem}.md"] = path
        put(f"notebooks/{path.stem}.md", text)
        for name, picture in pictures.items():
            put(f"notebooks/{name}", picture)
    for path in [*sorted(links.CARDS.glob("*.md")), *map(links.ROOT.joinpath, links.MOVED)]:
        page = links.place(path)
        if page not in files.src_uris:
            ORIGINS[page] = path
            put(page, path.read_text())
    for file in list(files.documentation_pages()):
        for path in links.targets(file.content_string, _origin(file)):
            page = links.place(path)
            if page not in files.src_uris and page.startswith("source/"):
                put(page, links.source_page(path))
    config.nav = _filled(config.nav, files)
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Links of the clone become links of the site."""
    if page.file.src_uri.startswith("source/"):
        return markdown
    text = links.rebased(markdown, _origin(page.file), page.file.src_uri)
    return links.as_markdown(text)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """The site must work without a network.

    Raises:
        PluginError: on a script, style or picture that a page takes from elsewhere.
    """
    found = links.fetched(output)
    if found:
        raise PluginError(f"{page.file.src_uri} must fetch nothing from elsewhere, got {found[0]}.")
    return output


def _origin(file: File) -> Path:
    return ORIGINS.get(file.src_uri, links.DOCS / file.src_uri)


def _filled(nav: Any, files: Files) -> Any:
    """The table of contents, with the pages of a folder in place of its name, ``journal/``."""
    if isinstance(nav, dict):
        return {title: _filled(child, files) for title, child in nav.items()}
    if isinstance(nav, list):
        return [each for child in nav for each in _as_list(_filled(child, files))]
    if not nav.endswith("/"):
        return nav
    pages = [file.src_uri for file in files.documentation_pages()]
    found = sorted(page for page in pages if str(Path(page).parent) == nav.rstrip("/"))
    return found[::-1] if nav == "journal/" else found


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]
