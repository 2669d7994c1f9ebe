"""The documentation site: what is generated, where links lead, and notebooks that run."""

import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from hydra.utils import get_object

from tests.shell import ROOT

pytest.importorskip("mkdocs", reason="the extra docs is not installed")
nbformat = pytest.importorskip("nbformat", reason="the extra docs is not installed")
nbclient = pytest.importorskip("nbclient", reason="the extra docs is not installed")

NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


@pytest.fixture
def generate(monkeypatch):
    """Imports a file of docs/generate."""
    monkeypatch.syspath_prepend(ROOT / "docs/generate")

    def load(name: str) -> ModuleType:
        return import_module(name)

    yield load
    for name in ("parts", "links", "notebooks", "hooks"):
        sys.modules.pop(name, None)


def headed(text: str) -> dict[str, str]:
    """What stands below each heading of the second level."""
    _, *sections = re.split(r"^## ", text, flags=re.MULTILINE)
    return {section.partition("\n")[0]: section for section in sections}


# What is generated.


@pytest.mark.parametrize(
    ("folder", "pattern", "pages"),
    [
        ("zfall/envs/transforms", r"^class (?!_)(\w+)\(Transform\)", "code/transforms/"),
        ("zfall/falling", r"^class (?!_)(\w+)\(Transform\)", "code/transforms/falling"),
        ("zfall/envs/terms", r"^def (?!_)(\w+)\(\s*td: TensorDictBase,\s*next_td", "code/terms/"),
        ("zfall/losses", r"^class (\w+Loss)\(", "code/losses"),
    ],
)
def test_every_part_has_a_place_in_the_reference(generate, folder, pattern, pages):
    """Found in the text of the files here, by importing them there."""
    texts = [path.read_text() for path in (ROOT / folder).rglob("*.py")]
    there = {name for text in texts for name in re.findall(pattern, text, re.MULTILINE)}
    found = generate("parts").pages()
    shown = {name for page, text in found.items() if pages in page for name in headed(text)}
    assert len(there) > 2
    assert there <= shown


def test_every_line_of_yaml_names_what_stands_above_it(generate):
    for page, text in generate("parts").pages().items():
        for name, section in headed(text).items():
            for line in re.findall(r"```yaml\n(.*)\n```", section):
                ((_, entry),) = yaml.safe_load(line).items()
                made = entry[1] if isinstance(entry, list) else entry
                assert get_object(made["_target_"]).__name__ == name, (page, line)


def test_a_new_transform_appears_by_itself_with_what_it_needs(generate, tmp_path, monkeypatch):
    code = [
        "from torchrl.envs import Transform",
        "class Gust(Transform):",
        "    def __init__(self, env, *, force: float, side: str = 'left'):",
        "        super().__init__()",
        "class _Hidden(Transform): ...",
    ]
    (tmp_path / "gusty.py").write_text("\n".join(code))
    monkeypatch.syspath_prepend(tmp_path)
    parts = generate("parts")
    (made,) = parts.defined_in("gusty", parts.is_transform)
    assert parts.part(made).line == "gust: {_target_: gusty.Gust, force: <float>}"


def test_an_option_that_goes_on_from_another_makes_the_same(generate):
    options = generate("parts").options()
    assert {"actor=gru_mog", "actor=gru_gaussian"} <= set(options["zfall.modules.actors.gru_actor"])
    assert "loss=ppo" in options["zfall.losses.ppo.PenalizedPPOLoss"]


# Links.


@pytest.mark.parametrize(
    ("origin", "page", "link", "there"),
    [
        ("docs/guide/tasks.md", "guide/tasks.md", "learning.md#x", "learning.md#x"),
        ("docs/guide/a.md", "guide/a.md", "../../zfall/moved.py", "../source/zfall/moved.py.md"),
        ("docs/guide/a.md", "guide/a.md", "../../zfall/policies/best.md", "../policies/best.md"),
        ("zfall/policies/best.md", "policies/best.md", "../../docs/site.css", "../site.css"),
        ("docs/guide/a.md", "guide/a.md", "https://x.org/a.md", "https://x.org/a.md"),
        ("docs/index.md", "index.md", "notebooks/own_parts.ipynb", "notebooks/own_parts.md"),
        ("CHANGELOG.md", "project/changelog.md", "docs/index.md", "../index.md"),
        ("docs/guide/a.md", "guide/a.md", "missing.md", "missing.md"),
    ],
)
def test_a_link_of_the_clone_leads_to_its_page_of_the_site(generate, origin, page, link, there):
    text = f"See [it]({link}).\n\n```\n[code]({link})\n```\n"
    assert generate("links").rebased(text, ROOT / origin, page) == text.replace(link, there, 1)


def test_bars_in_code_of_a_table_are_bars_for_both_readers(generate):
    assert generate("links").as_markdown(r"| `exp(-\|v\|)` \| |") == r"| `exp(-|v|)` \| |"


@pytest.mark.parametrize(
    ("html", "found"),
    [
        ('<script src="https://cdn.org/a.js">', ["https://cdn.org/a.js"]),
        ('<link rel="stylesheet" href="//fonts.org/b">', ["//fonts.org/b"]),
        ('<a href="https://torch.org">and</a> <img src="pictures/c.png">', []),
    ],
)
def test_what_a_page_takes_from_elsewhere_is_found(generate, html, found):
    assert generate("links").fetched(html) == found


# Notebooks.


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_its_first_cell_to_its_last(path, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    book = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(
        book, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    assert any(cell.get("outputs") for cell in book.cells)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_a_page_with_its_code_and_what_it_printed(generate, path):
    text, _ = generate("notebooks").page(path)
    cells = nbformat.read(path, as_version=4).cells
    assert text.startswith("# ")
    assert text.count("```python\n") == sum(cell.cell_type == "code" for cell in cells)
    assert "```text\n" in text


def test_a_notebook_in_git_is_small():
    assert len(NOTEBOOKS) == 3
    assert all(Path(path).stat().st_size < 20_000 for path in NOTEBOOKS)
