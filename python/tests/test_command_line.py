"""Python gives the same bytes and errors as the command line."""

from __future__ import annotations

import re
import subprocess

import numpy as np
import pytest
from conftest import widening_model

import psfield

fits = pytest.importorskip("astropy.io.fits")

CATALOG = (
    "x,y,flux,re,n,q,angle\n40.3,30.6,1000,4,1,0.5,30\n10.25,50.5,10,0,,,\n-3,20,500,5,2,0.9,0\n"
    "130.5,90,77,0,,,\n"
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A scene, a catalogue, samples of four pixels per frame pixel, and a model of one."""
    folder = tmp_path_factory.mktemp("files")
    rng = np.random.default_rng(11)
    light = rng.random((96, 128)).astype(np.float32)
    light[rng.integers(0, 96, 9), rng.integers(0, 128, 9)] += 200
    fits.writeto(folder / "scene.fits", light)
    fits.writeto(folder / "fine.fits", rng.random((192, 256)).astype(np.float32))
    (folder / "sources.csv").write_text(CATALOG)
    widening_model(size=65, oversampling=4.0).write(folder / "samples.fits", format="psf-samples")
    widening_model().write(folder / "model.fits")
    return folder


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
@pytest.mark.parametrize("psf", ["samples.fits", "model.fits"])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], {}),
        (["--tolerance", "1e-2", "--precision", "f64"], {"tolerance": 1e-2, "precision": "f64"}),
        (
            ["--tolerance", "1e-2", "--tolerance-on", "l2"],
            {"tolerance": 1e-2, "tolerance_on": "l2"},
        ),
        (["--anchor", "output", "--method", "lowrank"], {"anchor": "output", "method": "lowrank"}),
        (
            ["--frame", "8,5,100,80", "--stamp-size", "11"],
            {"frame": (8, 5, 100, 80), "stamp_size": 11},
        ),
        (["--oversampling", "2"], {"oversample": 2}),
        (["--scene-pixels", "integrated"], {"scene_pixels": "integrated"}),
    ],
)
@pytest.mark.parametrize("catalog", [False, True])
def test_simulations(command, files, tmp_path, psf, options, words, catalog):
    scene = files / ("fine.fits" if "--oversampling" in options else "scene.fits")
    output = tmp_path / "image.fits"
    sources = ["--catalog", files / "sources.csv"] if catalog else []
    subprocess.run(
        [
            command,
            "simulate",
            scene,
            "--psf",
            files / psf,
            *options,
            *sources,
            "-o",
            output,
            "--quiet",
            "--device",
            "cpu",
        ],
        check=True,
    )
    model = psfield.PsfModel.read(files / psf)
    light = fits.getdata(scene)
    columns = psfield.read_catalog(files / "sources.csv") if catalog else None
    image = model.plan(light.shape, device="cpu", **words).simulate(light, columns)
    theirs = fits.getdata(output)
    assert theirs.shape == image.shape
    assert theirs.astype(image.dtype).tobytes() == image.tobytes()


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_catalogues_alone(command, files, tmp_path):
    output = tmp_path / "image.fits"
    subprocess.run(
        [
            command,
            "simulate",
            "--catalog",
            files / "sources.csv",
            "--shape",
            "128,96",
            "--psf",
            files / "samples.fits",
            "-o",
            output,
            "-q",
        ],
        check=True,
    )
    image = (
        psfield.PsfModel.read(files / "samples.fits")
        .plan((96, 128))
        .simulate(catalog=psfield.read_catalog(files / "sources.csv"))
    )
    assert fits.getdata(output).astype(np.float32).tobytes() == image.tobytes()


def test_exposures(command, files, tmp_path):
    (tmp_path / "ccd.toml").write_text(
        "photon_noise = true\nsky_e = 20.0\nread_noise_e = 3.0\ngain_e_per_adu = 1.5\nbits = 16\n"
    )
    raw, truth = tmp_path / "raw.fits", tmp_path / "truth.fits"
    words = [
        "--psf",
        files / "model.fits",
        "--detector",
        tmp_path / "ccd.toml",
        "--seed",
        "5",
        "--truth",
        truth,
    ]
    subprocess.run([command, "simulate", files / "scene.fits", *words, "-o", raw, "-q"], check=True)
    light = fits.getdata(files / "scene.fits")
    image = psfield.PsfModel.read(files / "model.fits").plan(light.shape).simulate(light)
    exposure = psfield.detector.Detector.from_toml(tmp_path / "ccd.toml").expose(image, 5)
    assert np.array_equal(fits.getdata(raw), exposure.counts)


def test_errors_have_the_same_texts(command, files, tmp_path):
    bad = tmp_path / "bad.csv"
    bad.write_text("x,y,flux\n1,2,3\n1,oops,3\n")
    for arguments, call in [
        (["--psf", "none.fits"], lambda: psfield.PsfModel.read("none.fits")),
        (["--psf", files / "scene.fits"], lambda: psfield.PsfModel.read(files / "scene.fits")),
        (["--psf", files / "model.fits", "--catalog", bad], lambda: psfield.read_catalog(bad)),
        (
            ["--psf", files / "model.fits", "--frame", "0,0,200,10"],
            lambda: psfield.PsfModel.read(files / "model.fits").plan(
                (96, 128), frame=(0, 0, 200, 10)
            ),
        ),
    ]:
        ran = subprocess.run(
            [command, "simulate", files / "scene.fits", *arguments, "-o", tmp_path / "out.fits"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode != 0
        with pytest.raises((OSError, ValueError)) as caught:
            call()
        # Each face names its own setting at the end.
        without_hint = re.sub(r" \(\w+=\)$", "", str(caught.value))
        assert without_hint in ran.stderr
