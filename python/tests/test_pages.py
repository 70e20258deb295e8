"""The Python blocks of every page run, and all links lead somewhere."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, widening_model

import psfield

PAGES = [
    path.relative_to(ROOT).as_posix()
    for path in sorted(
        [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("benches/*/*.md")]
    )
]
#: A block that imports one of these, and the blocks after it, are skipped if it is not installed.
OPTIONAL = ("astropy", "dask", "dask_jobqueue", "galsim", "jax", "matplotlib", "photutils")
OPTIONAL += ("regularizepsf", "scipy", "torch", "tqdm")


def blocks(page: str) -> list[tuple[str, int, str]]:
    """Return the Python blocks of a page: section, number of the first line, and text."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found, section = [], ""
    for match in re.finditer(r"^## ([^\n]*)$|^```python\n(.*?)^```$", text, re.M | re.S):
        if match[1] is not None:
            section = match[1]
        else:
            found.append((section, text.count("\n", 0, match.start(2)), match[2]))
    return found


def run(page: str, *sections: str, edit: tuple[str, str] = ("\0", "")) -> dict[str, Any]:
    """Run the Python blocks of a page, or of its sections, and return the names they define.

    Lines are numbered as in the page. ``edit`` is a text in them and its replacement.
    """
    chosen = [block for block in blocks(page) if not sections or block[0] in sections]
    assert chosen, page
    names: dict[str, Any] = {"__name__": "__main__"}
    for _, line, block in chosen:
        for module in re.findall(r"^(?:from|import) (\w+)", block, re.M):
            if module in OPTIONAL and importlib.util.find_spec(module) is None:
                pytest.skip(f"{module} is not installed")
        exec(compile("\n" * line + block.replace(*edit), page, "exec"), names)
    return names


def over_peak(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the largest difference over the peak."""
    return float(np.abs(ours - theirs).max() / theirs.max())


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run each test in a folder of its own, with the files of `psfield demo` that pages open."""
    folder = tmp_path / "psfield-demo"
    folder.mkdir()
    widening_model((1024, 1024)).write(folder / "model.fits")
    (folder / "stars.csv").write_text("x,y,flux\n100.25,200.5,1000\n900,800.75,500\n")
    monkeypatch.chdir(tmp_path)


def test_every_page_with_python_is_tested():
    tested = set(re.findall(r'run\("([^"]+)"', Path(__file__).read_text(encoding="utf-8")))
    assert tested == {page for page in PAGES if blocks(page)}


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_the_readme():
    image = run("README.md")["image"]
    assert image.shape == (1024, 1024)
    # No star is near an edge.
    assert image.sum(dtype=float) == pytest.approx(1500, rel=1e-3)


def test_the_first_page_of_the_site():
    names = run("docs/index.md")
    assert names["image"].shape == names["model"].field_shape


def test_the_reference_lists_every_public_name():
    page = (ROOT / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^ +psfield\.(\w+)$", page, re.M))
    assert listed == {*psfield.__all__, "dask", "torch", "jax"} - {"__version__"}


def test_the_package():
    names = run("docs/python.md")
    image = np.load("frames.npy")[9]
    assert np.array_equal(image, names["plan"].simulate(names["scene"]))
    assert names["check"].passed and 0 < names["difference"].relative_l2 < 1e-3


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_derivatives():
    names = run("docs/derivatives.md")
    assert names["light"].grad.shape == names["light"].shape
    assert names["after"] < 0.05 * names["before"]
    assert names["gradient"].shape == (128, 128)


def test_colour():
    names = run("docs/colour.md")
    peaks = [names[name].evaluate(0, 0).max() for name in ("green", "star")]
    assert all(0 < peak < 1 for peak in peaks)


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_bright_and_faint():
    names = run("docs/bright_and_faint.md")
    limit = names["plan"].dropped_light(names["catalog"])
    assert 0 < limit.largest < 10 * names["camera"].noise
    counts, shot = names["counts"].counts, names["exposure"].counts
    assert shot.sum() == pytest.approx(counts.sum(), rel=1e-3)


def test_formats():
    names = run("docs/formats.md")
    model = psfield.PsfModel.read("my_samples.fits")
    assert model.field_shape == (1024, 1024)
    assert np.allclose(model.positions, np.column_stack([names["x"], names["y"]]))


def test_coming_from_galsim():
    names = run("docs/coming_from.md", "", "GalSim")
    # The error of interpolation between a dozen positions and between thirds of a pixel. The stars
    # of GalSim have 64 pixels, those of psfield 63.
    assert over_peak(names["ours"], names["theirs"].array) < 1e-3
    # The interpolation of the PSF as for stars, and the truncation of GalSim's transforms.
    assert over_peak(names["our_galaxy"], names["their_galaxy"]) < 2e-3
    # The first pixel is 1 in GalSim and 0 in psfield. A shift by one pixel must be detected.
    assert over_peak(names["ours"], np.roll(names["theirs"].array, 1, axis=1)) > 0.1


def test_coming_from_photutils():
    names = run("docs/coming_from.md", "", "photutils")
    # Both draw splines through the same pixels.
    assert over_peak(names["ours"], names["theirs"]) < 1e-6


def test_coming_from_regularizepsf():
    names = run("docs/coming_from.md", "", "regularizepsf")
    ours, theirs, exact = (names[name] for name in ("ours", "theirs", "exact"))
    # The error of interpolation between 5 x 5 positions, and that of patches stated on the page.
    assert np.linalg.norm(ours - exact) < 1e-3 * np.linalg.norm(exact)
    assert 2e-3 < np.linalg.norm(theirs - exact) / np.linalg.norm(exact) < 2e-2


#: Commands of a queue that runs each job at once, on this machine. Job files are short-lived.
QUEUE = {
    "sbatch": """#!/bin/sh
cp "$1" "$0.$$"
bash "$0.$$" > "$0.$$.log" 2>&1 &
echo "Submitted batch job $$"
""",
    "scancel": "#!/bin/sh\n",
}


def test_clusters(tmp_path, monkeypatch, capsys):
    zarr = pytest.importorskip("zarr")
    dask = pytest.importorskip("dask")
    distributed = pytest.importorskip("distributed")
    pytest.importorskip("dask_jobqueue")
    for name, text in QUEUE.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    home = tmp_path / "home"
    (home / "psfield" / "bin").mkdir(parents=True)
    (home / "psfield" / "bin" / "activate").touch()
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setenv("HOME", str(home))
    with (
        # Fail, and do not wait for ever, if the queue starts no workers.
        dask.config.set({"distributed.scheduler.no-workers-timeout": "60s"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster),
    ):
        # Nodes of 2 cores in place of 32.
        names = run("docs/cluster.md", edit=("=32", "=2"))
        names["cluster"].close()
    assert capsys.readouterr().out == "20 frames written\n"
    assert names["part"].shape == (200, 400)
    frames = zarr.open_group(tmp_path / "frames.zarr", mode="r")
    assert {name: array.shape for name, array in frames.arrays()} == {
        "image": (20, 128, 128),
        "flags": (20, 128, 128),
        "truth": (20, 128, 128),
        "done": (20,),
    }
    assert len(list(tmp_path.glob("frames/*.fits"))) == 20


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_surveys():
    names = run("docs/observe.md")
    assert [report.status for report in names["reports"]] == ["done"]
    assert names["reports"][0].in_frame == 2


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        found = target.startswith("https://") or (ROOT / page).parent.joinpath(target).exists()
        assert found, f"{page}: {target} is not there"


def test_every_page_of_the_site_is_in_a_table_of_contents():
    docs = ROOT / "docs"
    listed = set()
    for page in docs.rglob("*.md"):
        for contents in re.findall(
            r"^```{toctree}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S
        ):
            for entry in re.findall(r"^[^:\n].*$", contents, re.M):
                name = entry[entry.find("<") + 1 :].rstrip(">")
                listed |= {path.resolve() for path in page.parent.glob(f"{name}.md")}
    pages = {path for path in docs.rglob("*.md") if path.name not in ("index.md", "README.md")}
    assert pages - listed == set()
