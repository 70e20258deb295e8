"""The Python examples of the README and of the page on files run, and all links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, widening_model

import psfield

PAGES = sorted(
    path.relative_to(ROOT)
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("benches/*/*.md")]
)


def run_blocks(page: str) -> dict[str, Any]:
    """Run the Python blocks of a page one after the other, and return the names they define."""
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(), re.M | re.S)
    assert blocks, page
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    return names


@pytest.fixture
def demo_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of `psfield demo` that the examples open, with less in them."""
    folder = tmp_path / "psfield-demo"
    folder.mkdir()
    widening_model((1024, 1024)).write(folder / "model.fits")
    (folder / "stars.csv").write_text("x,y,flux\n100.25,200.5,1000\n900,800.75,500\n")
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_the_readme(demo_folder):
    image = run_blocks("README.md")["image"]
    assert image.shape == (1024, 1024)
    # No star is near an edge.
    assert image.sum(dtype=float) == pytest.approx(1500, rel=1e-3)


def test_the_page_of_formats(tmp_path, monkeypatch):
    pytest.importorskip("astropy.io.fits")
    monkeypatch.chdir(tmp_path)
    names = run_blocks("docs/formats.md")
    model = psfield.PsfModel.read("my_samples.fits")
    assert model.field_shape == (1024, 1024)
    assert np.allclose(model.positions, np.column_stack([names["x"], names["y"]]))


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_links_of_every_page_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        found = target.startswith("https://") or (ROOT / page).parent.joinpath(target).exists()
        assert found, f"{page}: {target} is not there"
