"""Two worker processes: a chunked scene, and batches of frames."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest
from conftest import relative_l2

import psfield

dask = pytest.importorskip("dask")
da = pytest.importorskip("dask.array")
distributed = pytest.importorskip("distributed")
fits = pytest.importorskip("astropy.io.fits")

import psfield.dask  # noqa: E402

#: Relative L2 error in f32: chunks share transforms with different neighbours.
ROUNDING = 1e-6
SHAPE = (48, 64)


def model_of(width: float = 1.5) -> psfield.PsfModel:
    y, x = np.mgrid[-6:7, -6:7]
    stamps = [
        np.exp(-(x**2 + y**2) / (2 * sigma**2)) for sigma in width * np.array([1.0, 1.2, 1.1, 1.3])
    ]
    stamps = [stamp / stamp.sum() for stamp in stamps]
    return psfield.PsfModel.from_samples(stamps, [(0, 0), (399, 0), (0, 399), (399, 399)])


def draw(seed: int) -> np.ndarray:
    """A random scene."""
    rng = np.random.default_rng(seed)
    return (rng.random((48, 64)) ** 8).astype(np.float32)


def expected_of(model: psfield.PsfModel, seed: int, **words) -> np.ndarray:
    return model.plan(SHAPE, device="cpu", **words).simulate(draw(seed))


def _count_models() -> None:
    """Count the models that a worker unpickles."""
    from psfield import _model

    again = _model._again
    _model.seen = 0

    def counted(*state):
        _model.seen += 1
        return again(*state)

    _model._again = counted


def _models_counted() -> int:
    from psfield import _model

    return _model.seen


@pytest.fixture(scope="module")
def model() -> psfield.PsfModel:
    return model_of()


@pytest.fixture(scope="module")
def client() -> Iterator[distributed.Client]:
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def test_four_by_four_chunks_on_two_processes(client, model) -> None:
    rng = np.random.default_rng(1)
    scene = (rng.random((400, 400)) ** 8).astype(np.float32)
    for tolerance in (1e-1, 1e-4):
        lazy = psfield.dask.simulate(da.from_array(scene, chunks=(100, 100)), model, tolerance)
        image = client.compute(lazy).result()
        expected = model.plan(scene.shape, tolerance, device="cpu").simulate(scene)
        assert relative_l2(image, expected) < ROUNDING


def test_the_model_goes_to_each_worker_once(client) -> None:
    model = model_of(1.1)
    client.run(_count_models)
    lazy = psfield.dask.simulate(da.ones((400, 400), chunks=(50, 50), dtype=np.float32), model)
    client.compute(lazy).result()
    counts = list(client.run(_models_counted).values())
    assert sum(counts) >= 1
    assert max(counts) == 1


def test_workers_share_the_cores(client, model) -> None:
    lazy = psfield.dask.simulate(da.ones((100, 100), chunks=(50, 100), dtype=np.float32), model)
    client.compute(lazy).result()
    assert set(client.run(psfield.threads).values()) == {1}


def test_fits_files(client, model, tmp_path) -> None:
    seen: list[tuple[int, int]] = []
    jobs = [{"scene": draw, "seed": seed} for seed in range(6)]
    template = tmp_path / "frames" / "{index:03d}.fits"
    results = psfield.dask.batch(
        jobs, model, template, 1e-3, client=client, progress=lambda *step: seen.append(step)
    )
    assert [(r.index, r.status, r.error) for r in results] == [
        (i, "written", None) for i in range(6)
    ]
    assert seen == [(i + 1, 6) for i in range(6)]
    assert sorted(os.listdir(tmp_path / "frames")) == [f"{i:03d}.fits" for i in range(6)]
    for seed, result in enumerate(results):
        assert result.seconds > 0
        image, header = fits.getdata(result.output, header=True)
        np.testing.assert_array_equal(image, expected_of(model, seed, tolerance=1e-3))
        assert header["PSFIELD"] == psfield.__version__
        assert header["PSFTOLON"] == "aperture"
        assert header["PSFSCPIX"] == "point"
        assert (header["PSFTOL"], header["PSFANCH"], header["PSFPREC"], header["PSFSEED"]) == (
            1e-3,
            "source",
            "f32",
            seed,
        )


def test_a_second_run_does_what_the_first_left_undone(client, model, tmp_path) -> None:
    jobs = [{"scene": draw, "seed": seed} for seed in range(5)]
    template = tmp_path / "{seed}.fits"
    psfield.dask.batch(jobs[:3], model, template, client=client)
    before = (tmp_path / "1.fits").stat().st_mtime_ns
    results = psfield.dask.batch(jobs, model, template, client=client)
    assert [r.status for r in results] == ["kept"] * 3 + ["written"] * 2
    assert (tmp_path / "1.fits").stat().st_mtime_ns == before
    results = psfield.dask.batch(iter(jobs), model, template, client=client, overwrite=True)
    assert [r.status for r in results] == ["written"] * 5


def test_scenes_of_every_kind(client, model, tmp_path) -> None:
    scene = draw(3)
    header = fits.Header(
        {
            "OBJECT": "M 51",
            "CRPIX1": 10.5,
            "CRPIX2": 20.0,
            "CRPIX1B": 1.0,
            "BUNIT": "electron",
            "PSFTOL": 0.5,
        }
    )
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(scene, header)]).writeto(tmp_path / "scene.fits")
    np.save(tmp_path / "scene.npy", scene)
    jobs = [
        {"scene": tmp_path / "scene.fits", "header": {"OBSERVER": ("Hubble", "who looked")}},
        {"scene": str(tmp_path / "scene.npy")},
        {"scene": scene},
        {"scene": lambda: draw(3)},
        {"catalog": {"x": [30.0], "y": [20.0], "flux": [100.0]}},
        {
            "scene": draw,
            "seed": 3,
            "catalog": lambda seed: {"x": [30.0], "y": [20.0], "flux": [100.0 * seed]},
        },
    ]
    frame = (2, 3, 40, 30)
    template = tmp_path / "{index}.fits"
    results = psfield.dask.batch(jobs, model, template, client=client, frame=frame, shape=SHAPE)
    assert [r.error for r in results] == [None] * 6
    plan = model.plan(SHAPE, device="cpu", frame=frame)
    for i in range(4):
        np.testing.assert_array_equal(fits.getdata(results[i].output), plan.simulate(scene))
    np.testing.assert_array_equal(
        fits.getdata(results[4].output), plan.simulate(None, jobs[4]["catalog"])
    )
    np.testing.assert_array_equal(
        fits.getdata(results[5].output), plan.simulate(scene, jobs[5]["catalog"](3))
    )
    carried = fits.getheader(results[0].output)
    assert (carried["OBJECT"], carried["BUNIT"], carried["OBSERVER"]) == (
        "M 51",
        "electron",
        "Hubble",
    )
    assert (carried["CRPIX1"], carried["CRPIX2"], carried["CRPIX1B"]) == (8.5, 17.0, -1.0)
    assert carried["PSFTOL"] == 1e-4


def test_a_failed_job_does_not_stop_the_rest(client, model, tmp_path) -> None:
    bad = draw(0)
    bad[3, 4] = np.nan

    def broken(seed):
        raise RuntimeError("no scene today")

    jobs = [
        {"scene": draw, "seed": 0},
        {"scene": bad},
        {"scene": tmp_path / "missing.npy"},
        {"scene": broken, "seed": 2},
        {"scenes": bad},
        {"seed": 1},
        "scene.fits",
        {"scene": draw, "seed": -1},
        {"scene": draw, "seed": 1, "output": tmp_path / "0.fits"},
        {"scene": np.zeros((4, 4, 4))},
        {"scene": draw, "seed": 10},
    ]
    with pytest.warns(
        psfield.PsfieldWarning, match="9 of 11 jobs failed, the first of them job 1: ValueError"
    ):
        results = psfield.dask.batch(jobs, model, tmp_path / "{index}.fits", client=client)
    assert [r.index for r in results if r.status == "written"] == [0, 10]
    texts = [r.error for r in results]
    for index, words in {
        1: "[3, 4] is NaN",
        2: "missing.npy",
        3: "RuntimeError: no scene today",
        4: "a job has no key 'scenes'",
        5: "nothing to simulate",
        6: "a job must be a dict, got str",
        7: "seed must be an integer",
        8: "already the output of job 0",
        9: r"[y, x]",
    }.items():
        assert words in texts[index], texts[index]
    assert sorted(os.listdir(tmp_path)) == ["0.fits", "10.fits"]


def test_zarr(client, model, tmp_path) -> None:
    zarr = pytest.importorskip("zarr")
    path = tmp_path / "frames.zarr"
    jobs = [{"scene": draw, "seed": seed} for seed in range(4)]
    results = psfield.dask.batch(jobs[:3], model, path, client=client, shape=SHAPE, keep=["scene"])
    assert [r.status for r in results] == ["written"] * 3
    assert results[2].output == f"{path}[2]"
    group = zarr.open_group(path, mode="r")
    assert group["image"].chunks == (1, *SHAPE)
    assert group["image"].dtype == np.float32
    assert group["done"][:].tolist() == [True] * 3
    # One more frame, and one that was lost.
    done = zarr.open_group(path, mode="r+")["done"]
    done[1] = False
    results = psfield.dask.batch(jobs, model, path, client=client, shape=SHAPE, keep=["scene"])
    assert [r.status for r in results] == ["kept", "written", "kept", "written"]
    group = zarr.open_group(path, mode="r")
    for seed in range(4):
        np.testing.assert_array_equal(group["image"][seed], expected_of(model, seed))
        np.testing.assert_array_equal(group["scene"][seed], draw(seed))
    with pytest.raises(ValueError, match=r"made with tolerance = 0\.0001, not 0\.1"):
        psfield.dask.batch(jobs, model, path, 0.1, client=client, shape=SHAPE, keep=["scene"])
    with pytest.raises(ValueError, match="made with model"):
        psfield.dask.batch(jobs, model_of(2.0), path, client=client, shape=SHAPE, keep=["scene"])
    with pytest.raises(ValueError, match="it has 4 frames, but there are only 2 jobs"):
        psfield.dask.batch(jobs[:2], model, path, client=client, shape=SHAPE, keep=["scene"])
    with pytest.raises(ValueError, match="shape is not known"):
        psfield.dask.batch(jobs, model, path, client=client)
    with pytest.raises(TypeError, match="the number of frames"):
        psfield.dask.batch(iter(jobs), model, path, client=client, shape=SHAPE)
    results = psfield.dask.batch(
        jobs[:2], model, path, 0.1, client=client, shape=SHAPE, overwrite=True
    )
    foreign = tmp_path / "data.zarr"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("years of work")
    with pytest.raises(ValueError, match="is not replaced"):
        psfield.dask.batch(
            jobs[:2], model, foreign, 0.1, client=client, shape=SHAPE, overwrite=True
        )
    assert (foreign / "thesis.txt").exists()
    assert [r.status for r in results] == ["written"] * 2
    assert zarr.open_group(path, mode="r")["image"].shape == (2, *SHAPE)


def test_frames_of_another_shape_are_refused_by_zarr(client, model, tmp_path) -> None:
    pytest.importorskip("zarr")
    jobs = [{"scene": draw(1)}, {"scene": draw(2)[:1]}]
    with pytest.warns(psfield.PsfieldWarning, match="1 of 2 jobs failed"):
        results = psfield.dask.batch(jobs, model, tmp_path / "frames.zarr", client=client)
    assert "have the shape (48, 64)" in results[1].error


def test_exposures(client, model, tmp_path) -> None:
    detector = psfield.detector.Detector(sky_e=20.0, read_noise_e=3.0)
    jobs = [{"scene": draw, "seed": seed} for seed in range(3)]
    results = psfield.dask.batch(
        jobs,
        model,
        tmp_path / "{seed}.fits",
        client=client,
        detector=detector,
        keep=["truth", "scene"],
    )
    for seed, result in enumerate(results):
        assert result.error is None
        truth = expected_of(model, seed)
        exposure = detector.expose(truth, seed)
        with fits.open(result.output) as hdus:
            assert [hdu.name for hdu in hdus] == ["PRIMARY", "FLAGS", "TRUTH", "SCENE"]
            np.testing.assert_array_equal(hdus[0].data, exposure.counts)
            np.testing.assert_array_equal(hdus["FLAGS"].data, exposure.flags)
            np.testing.assert_array_equal(hdus["TRUTH"].data, truth)
            np.testing.assert_array_equal(hdus["SCENE"].data, draw(seed))
    with pytest.warns(psfield.PsfieldWarning, match="needs a seed"):
        psfield.dask.batch(
            [{"scene": draw(1)}],
            model,
            tmp_path / "none{index}.fits",
            client=client,
            detector=detector,
        )


def test_files_that_fail_are_tried_again(client, model, tmp_path) -> None:
    def unsteady(seed: int) -> np.ndarray:
        tries = tmp_path / f"tries_{seed}"
        tries.mkdir(exist_ok=True)
        (tries / str(len(os.listdir(tries)))).touch()
        if len(os.listdir(tries)) <= seed:
            raise OSError("the disk is away")
        return draw(seed)

    jobs = [{"scene": unsteady, "seed": seed} for seed in (0, 2, 3)]
    with pytest.warns(
        psfield.PsfieldWarning,
        match="1 of 3 jobs failed, the first of them job 2: OSError: the disk is away",
    ):
        results = psfield.dask.batch(
            jobs, model, tmp_path / "{seed}.fits", client=client, retries=2
        )
    assert [r.status for r in results] == ["written", "written", "failed"]
    np.testing.assert_array_equal(fits.getdata(results[1].output), expected_of(model, 2))


def wide_model(seed: int) -> psfield.PsfModel:
    return model_of(1.5 + 0.1 * seed)


def test_a_psf_of_one_job(client, model, tmp_path) -> None:
    other = model_of(2.0)
    other.write(tmp_path / "other.fits")
    jobs = [{"scene": draw, "seed": seed} for seed in range(5)]
    for job, psf in zip(jobs, [None, other, tmp_path / "other.fits", wide_model, [1, 2]]):
        job["psf"] = psf
    with pytest.warns(psfield.PsfieldWarning, match="1 of 5 jobs failed"):
        results = psfield.dask.batch(
            jobs, model, str(tmp_path / "p{index}.fits"), tolerance=1e-4, client=client
        )
    assert "psf must be a PsfModel, a path or a function, got list" in results[4].error
    models = [model, other, other, wide_model(3)]
    for seed, (result, psf) in enumerate(zip(results, models)):
        expected = expected_of(psf, seed, tolerance=1e-4)
        # Each plan may differ by the tolerance.
        assert relative_l2(fits.getdata(result.output), expected) < 2e-4
    assert relative_l2(fits.getdata(results[1].output), expected_of(model, 1)) > 1e-2


def test_a_detector_of_one_job(client, model, tmp_path) -> None:
    detector = psfield.detector.Detector(photon_noise=True)
    jobs = [{"scene": draw, "seed": 1, "detector": detector}, {"scene": draw, "seed": 2}]
    results = psfield.dask.batch(jobs, model, tmp_path / "{index}.fits", client=client)
    np.testing.assert_array_equal(
        fits.getdata(results[0].output), detector.expose(expected_of(model, 1), 1).counts
    )
    np.testing.assert_array_equal(fits.getdata(results[1].output), expected_of(model, 2))
    pytest.importorskip("zarr")
    with pytest.warns(psfield.PsfieldWarning, match="has no array 'flags'"):
        psfield.dask.batch(jobs, model, tmp_path / "frames.zarr", client=client, shape=SHAPE)


@pytest.mark.parametrize("kind", ["fits", "zarr"])
def test_a_killed_worker_loses_no_job(client, model, tmp_path, kind) -> None:
    """The process of a worker is killed when half of the jobs are done."""
    if kind == "zarr":
        zarr = pytest.importorskip("zarr")
    count = 24

    def slow(seed: int) -> np.ndarray:
        # Wait until both workers run a job.
        time.sleep(0.05)
        return draw(seed)

    before = client.run(os.getpid)
    killed: list[int] = []

    def kill(done: int, total: int) -> None:
        assert total == count
        if done >= count // 2 and not killed:
            pid = max(client.run(os.getpid).values())
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    output = tmp_path / "out" / ("{index:02d}.fits" if kind == "fits" else "frames.zarr")
    results = psfield.dask.batch(
        [{"scene": slow, "seed": seed} for seed in range(count)],
        model,
        output,
        client=client,
        progress=kill,
        shape=SHAPE,
    )
    assert killed
    assert killed[0] in before.values()
    assert [(r.index, r.status) for r in results] == [(i, "written") for i in range(count)]
    if kind == "fits":
        assert sorted(os.listdir(output.parent)) == [f"{i:02d}.fits" for i in range(count)]
        images = [fits.getdata(result.output) for result in results]
    else:
        group = zarr.open_group(output, mode="r")
        assert group["done"][:].all()
        images = list(group["image"][:])
    for seed, image in enumerate(images):
        np.testing.assert_array_equal(image, expected_of(model, seed))
    # The nanny starts a new process, which the next batch uses.
    client.wait_for_workers(2, timeout=30)


def test_a_job_that_kills_its_workers_fails_alone(model, tmp_path) -> None:
    def poison(seed: int) -> np.ndarray:
        if seed == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        return draw(seed)

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        pytest.warns(
            psfield.PsfieldWarning,
            match="1 of 12 jobs failed, the first of them job 5: KilledWorker",
        ),
    ):
        results = psfield.dask.batch(
            [{"scene": poison, "seed": i} for i in range(12)],
            model,
            tmp_path / "{index}.fits",
            client=client,
        )
    assert [r.index for r in results if r.status != "written"] == [5]
    assert len(os.listdir(tmp_path)) == 11


def test_unfinished_files_of_killed_workers_go(tmp_path) -> None:
    from psfield.dask._fits import FitsFiles

    output = str(tmp_path / "1.fits")
    left = [tmp_path / f".{name}.psfield-0123456789ab-my-host-77" for name in ("1.fits", "2.fits")]
    for path in left:
        path.touch()
    FitsFiles("psfield-ba9876543210", {}).remove_unfinished(
        [output, str(tmp_path / "missing" / "1.fits")]
    )
    assert os.listdir(tmp_path) == [left[1].name]


def test_a_cluster_of_its_own(model, tmp_path) -> None:
    """Without a client, one is made and closed."""
    results = psfield.dask.batch([{"scene": draw(1)}], model, tmp_path / "{index}.fits")
    assert results[0].error is None
    np.testing.assert_array_equal(fits.getdata(results[0].output), expected_of(model, 1))


@pytest.mark.parametrize(
    ("output", "options", "message"),
    [
        ("frame.fits", {}, "must have {index} or {seed}"),
        ("{index}{other}.fits", {}, "is not a template with {index} or {seed}"),
        ("{index}.fits", {"threads": 0}, "threads must be"),
        ("{index}.fits", {"retries": -1}, "retries must be"),
        ("{index}.fits", {"keep": ["light"]}, "'scene' and 'truth'"),
        ("{index}.fits", {"keep": ["truth"]}, "needs a detector"),
        ("{index}.fits", {"tolerance": 2.0}, "tolerance must be"),
    ],
)
def test_batches_that_cannot_be(client, model, output, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        psfield.dask.batch([], model, output, client=client, **options)


def test_no_jobs(client, model, tmp_path) -> None:
    assert psfield.dask.batch([], model, tmp_path / "{index}.fits", client=client) == []
