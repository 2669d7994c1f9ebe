"""Links that lead out of ``docs``: to code, cards and folders, which become pages of the site."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
CARDS = ROOT / "zfall" / "policies"
LINK = re.compile(r"(\]\()([^)\s]+)(\))")
FETCHED = re.compile(
    r'<(?:script|link|img|iframe|video|source)\b[^>]*?(?:src|href)="((?:https?:)?//[^"]*)"'
)
FENCE = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)
MOVED = {
    "README.md": "project/readme.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
}
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml", ".xml": "xml"}


def place(path: Path) -> str:
    """Where a file or folder of the clone lies in the site, as a path in ``docs``."""
    name = path.relative_to(ROOT).as_posix()
    if name in MOVED:
        return MOVED[name]
    if path.parent == CARDS and path.suffix == ".md":
        return f"policies/{path.name}"
    if path.suffix == ".ipynb":
        return path.relative_to(DOCS).with_suffix(".md").as_posix()
    if path.is_dir():
        return f"source/{name}/index.md"
    if path.is_relative_to(DOCS) and path.suffix != ".py":
        return path.relative_to(DOCS).as_posix()
    return f"source/{name}.md"


def prose(text: str) -> Iterator[tuple[str, bool]]:
    """The parts of a page in order, each with whether it is a block of code."""
    for number, each in enumerate(FENCE.split(text)):
        yield each, bool(number % 2)


def targets(text: str, origin: Path) -> Iterator[Path]:
    """Files and folders of the clone to which a page that lies at ``origin`` links."""
    for each, code in prose(text):
        for _, link, _ in () if code else LINK.findall(each):
            path = link.partition("#")[0]
            if path and "://" not in link and not link.startswith("mailto:"):
                there = (origin.parent / path).resolve()
                if there.exists() and there.is_relative_to(ROOT):
                    yield there


def rebased(text: str, origin: Path, page: str) -> str:
    """A page with its links as they must be at ``page`` in the site."""

    def link(match: re.Match[str]) -> str:
        path, sharp, anchor = match[2].partition("#")
        there = (origin.parent / path).resolve()
        if not path or "://" in match[2] or not there.exists() or not there.is_relative_to(ROOT):
            return match[0]
        new = os.path.relpath(place(there), Path(page).parent)
        return f"{match[1]}{Path(new).as_posix()}{sharp}{anchor}{match[3]}"

    return "".join(each if code else LINK.sub(link, each) for each, code in prose(text))


def source_page(path: Path) -> str:
    """A page that shows a file of the clone, or lists a folder."""
    name = path.relative_to(ROOT).as_posix()
    if path.is_dir():
        files = sorted(each.name for each in path.iterdir() if not each.name.startswith((".", "_")))
        return f"# {name}\n\n" + "\n".join(f"- `{each}`" for each in files) + "\n"
    code = path.read_text()
    fence = "`" * (1 + max((len(run) for run in re.findall(r"`{3,}", code)), default=2))
    return (
        f"# {path.name}\n\n`{name}`\n\n{fence}{LANGUAGES.get(path.suffix, 'text')}\n{code}{fence}\n"
    )


def as_markdown(text: str) -> str:
    """What GitHub reads otherwise than Python-Markdown: bars in code in tables."""
    return "".join(
        each if code else re.sub(r"`[^`\n]*\\\|[^`\n]*`", lambda m: m[0].replace("\\|", "|"), each)
        for each, code in prose(text)
    )


def anchor(heading: str, separator: str = "-") -> str:
    """The anchor of a heading as GitHub makes it."""
    kept = re.sub(r"[^\w\- ]", "", heading.lower().strip())
    return kept.replace(" ", separator)


def fetched(html: str) -> list[str]:
    """What a page takes from another server while it is shown; links to click on are none."""
    return FETCHED.findall(html)
