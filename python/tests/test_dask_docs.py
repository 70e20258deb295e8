"""The snippets of the page on clusters run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("zarr")
distributed = pytest.importorskip("distributed")

PAGE = Path(__file__).parents[2] / "docs" / "cluster.md"


def test_the_snippets_run(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    snippets = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    here = [snippet for snippet in snippets if "dask_jobqueue" not in snippet]
    assert (len(here), len(snippets)) == (2, 3)
    names: dict[str, object] = {"__name__": "__main__"}
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster),
    ):
        for snippet in here:
            exec(compile(snippet, str(PAGE), "exec"), names)
    assert capsys.readouterr().out == "20 frames written\n"
    assert names["part"].shape == (200, 400)

    import zarr

    frames = zarr.open_group(tmp_path / "frames.zarr", mode="r")
    assert {name: array.shape for name, array in frames.arrays()} == {
        "image": (20, 128, 128),
        "flags": (20, 128, 128),
        "truth": (20, 128, 128),
        "done": (20,),
    }
