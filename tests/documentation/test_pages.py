"""Pages among each other: links, pictures, names, versions."""

import re
from urllib.parse import unquote

import nbformat
import pytest
import yaml

import jaxscan
from tests.documentation.pages import ROOT, name_of, pages, prose


LINK = re.compile(r"\]\(([^)\s]+)\)")
REGISTRIES = [
    ".".join(parts) for parts in (("pypi", "org"), ("pythonhosted", "org"), ("anaconda", "org"), ("npmjs", "com"))
]
LARGEST_PICTURE = 330_000
"""Bytes: new pictures should have less than 300 kB, and the two largest have little more."""
NOTEBOOK = ROOT / "docs" / "notebooks" / "first_room.ipynb"


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_links_and_pictures_are_there(page):
    found = [unquote(link.split("#")[0]) for link in LINK.findall(prose(page)) if "://" not in link]
    missing = [link for link in found if link and not (page.parent / link).exists()]
    assert not missing


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_no_page_names_a_registry_of_packages(page):
    assert not [host for host in REGISTRIES if host in page.read_text()]


def test_pictures_are_light():
    pictures = [path for path in (ROOT / "docs").rglob("*") if path.suffix in {".png", ".jpg", ".svg"}]
    assert pictures and not [name_of(path) for path in pictures if path.stat().st_size > LARGEST_PICTURE]


def test_every_public_name_is_on_its_page():
    text = "".join(page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))
    listed = re.findall(r"^::: jaxscan\.(\w+)$", text, re.MULTILINE)
    assert sorted(listed) == sorted(set(jaxscan.__all__) - {"__version__"})


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 200


def test_changes_and_citation_are_of_this_version():
    newest = re.search(r"^## (\S+?),? ", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert newest and newest[1] == citation["version"] == jaxscan.__version__
    assert {"cff-version", "message", "title", "authors", "license"} <= set(citation)
    assert citation["license"] == "Apache-2.0" and citation["type"] == "software"


def test_the_notebook_is_kept_without_what_it_printed():
    cells = nbformat.read(NOTEBOOK, 4).cells
    nbformat.validate(nbformat.read(NOTEBOOK, 4))
    assert all(not cell.outputs and cell.execution_count is None for cell in cells if cell.cell_type == "code")


@pytest.mark.slow
def test_the_notebook_runs(tmp_path):
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOK, 4)
    resources = {"metadata": {"path": str(tmp_path)}}
    client = NotebookClient(notebook, kernel_name="python3", timeout=240, resources=resources)
    # Sockets of this machine, not ports that others can reach.
    manager = client.create_kernel_manager()
    manager.transport, manager.ip = "ipc", str(tmp_path / "kernel")
    client.execute()
    said = "".join(out.get("text", "") for cell in notebook.cells for out in cell.get("outputs", []))
    # The room's three dimensions, each within four of its sigmas.
    found = re.findall(r"(\w+): [\d.]+ m, sigma ([\d.]+) mm, error ([+-][\d.]+) mm", said)
    assert [name for name, _, _ in found] == ["length", "width", "height"]
    assert all(abs(float(error)) < 4 * float(sigma) for _, sigma, error in found), found
