"""A notebook as a page of the site: its text, its code, and what it printed when it was saved."""

import base64
import re
from pathlib import Path
from typing import Any

import nbformat


def page(path: Path) -> tuple[str, dict[str, bytes]]:
    """The markdown of a notebook, and its pictures by file name."""
    pictures: dict[str, bytes] = {}
    text = []
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "markdown":
            text.append(cell.source)
            continue
        text.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            text += _shown(output, path.stem, pictures)
    note = "This page is a notebook. `make setup` brings what runs it; open the file "
    text.insert(1, f"{note}`docs/notebooks/{path.name}` in a notebook editor.")
    return "\n\n".join(text) + "\n", pictures


def _shown(output: Any, name: str, pictures: dict[str, bytes]) -> list[str]:
    data = output.get("data", {})
    if "image/png" in data:
        file = f"{name}-{len(pictures)}.png"
        pictures[file] = base64.b64decode(data["image/png"])
        return [f"![What the cell above draws]({file})"]
    plain = output.get("text", data.get("text/plain", ""))
    plain = re.sub(r"\x1b\[[0-9;]*m", "", plain).rstrip()
    return [f"```text\n{plain}\n```"] if plain else []
