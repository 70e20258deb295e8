"""Long calls: progress, interruption, other threads, forked processes."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from conftest import ROOT, widening_model


@pytest.fixture(scope="module")
def long_plan():
    """A plan whose execution takes a second or so on one thread."""
    model = widening_model((4000, 4000), size=41, interpolation="bicubic")
    return model.plan((4000, 4000), 0.0, "f64", method="lowrank")


@pytest.fixture(scope="module")
def large_scene():
    return np.ones((4000, 4000))


def test_progress_is_told(long_plan, large_scene):
    steps = []
    long_plan.simulate(large_scene, progress=lambda done, total: steps.append((done, total)))
    assert steps[-1][0] == steps[-1][1] > 0
    assert steps == sorted(steps)


def test_tqdm_bars_are_taken(long_plan, large_scene):
    tqdm = pytest.importorskip("tqdm")
    with open(os.devnull, "w") as nowhere, tqdm.tqdm(file=nowhere) as bar:
        long_plan.simulate(large_scene, progress=bar)
        assert bar.n == bar.total > 0
    with pytest.raises(TypeError, match="progress must be a function"):
        long_plan.simulate(large_scene, progress=5)


def test_an_exception_in_progress_stops_the_work(long_plan, large_scene):
    def stop(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        long_plan.simulate(large_scene, progress=stop)
    # The plan can still be used.
    assert long_plan.simulate(large_scene)[2000, 2000] == pytest.approx(1.0, rel=1e-9)


def test_other_threads_run_meanwhile(long_plan, large_scene):
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.005):
            ticks.append(time.monotonic())

    other = threading.Thread(target=tick)
    other.start()
    began = time.monotonic()
    long_plan.simulate(large_scene)
    took = time.monotonic() - began
    done.set()
    other.join()
    # A call that held the interpreter would allow no ticks.
    assert len([t for t in ticks if began < t < began + took]) > 0.1 * took / 0.005


def test_many_threads_may_use_one_plan(model, scene):
    plan = model.plan(scene.shape, 1e-3)
    expected = plan.simulate(scene)
    images = [None] * 8

    def simulate(i):
        images[i] = plan.simulate(scene)

    threads = [threading.Thread(target=simulate, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(image, expected) for image in images)


def test_calls_do_not_write_to_one_array_at_once(long_plan, large_scene):
    out = np.zeros(large_scene.shape)
    refused = []

    def look(done, total):
        for call in (
            lambda: long_plan.simulate(large_scene, out=out),
            lambda: long_plan.simulate(out),
        ):
            with pytest.raises(ValueError, match="another call") as error:
                call()
            refused.append(str(error.value)[:3])

    long_plan.simulate(large_scene, out=out, progress=look)
    assert {"out", "sce"} == set(refused)


INTERRUPTED = """
    import os, signal, sys, threading, time
    sys.path.insert(0, {tests!r})
    import numpy as np
    from conftest import gaussian_stamp, widening_model
    import psfield
    # A parent that ignores Ctrl-C, such as a shell's background job, passes this on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    scene = np.ones((4000, 4000))
    model = widening_model((4000, 4000), size=41, interpolation="bicubic")
    plan = model.plan(scene.shape, 0.0, "f64", method="lowrank")
    began = time.monotonic()
    plan.simulate(scene)
    whole = time.monotonic() - began
    def galaxies(count):
        place = np.linspace(100, 3900, count)
        return {{"x": place, "y": place, "flux": place, "re": 3.0, "n": 1.0, "q": 1e-3}}
    plan.simulate(catalog=galaxies(1))
    def draw(x, y):
        time.sleep(0.01)
        return gaussian_stamp(1 + x / 4000)
    calls = {{
        "simulate": lambda: [plan.simulate(scene) for _ in range(100)],
        "galaxies": lambda: plan.simulate(catalog=galaxies(10_000)),
        "adjoint": lambda: [plan.adjoint(scene) for _ in range(100)],
        "sample": lambda: psfield.PsfModel.from_function(draw, (4000, 4000), threshold=1e-5),
    }}
    for name, call in calls.items():
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        began = time.monotonic()
        try:
            call()
        except KeyboardInterrupt:
            print(name, "stopped", time.monotonic() - began, whole)
"""


def test_ctrl_c_stops_the_work():
    program = textwrap.dedent(INTERRUPTED).format(tests=str(ROOT / "python" / "tests"))
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    lines = [line.split() for line in ran.stdout.splitlines()]
    assert [line[:2] for line in lines] == [
        [name, "stopped"] for name in ("simulate", "galaxies", "adjoint", "sample")
    ], ran.stderr
    for name, _, seconds, whole in lines:
        # Long before the end of one of a hundred calls, or of a hundred galaxies.
        assert float(seconds) < 0.3 + 2.0 + float(whole), name


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_forked_processes_have_threads_of_their_own(model, scene):
    # A data loader does this: the parent uses its threads and then forks.
    plan = model.plan(scene.shape, 1e-3)
    expected = plan.simulate(scene)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        images = pool.map_async(plan.simulate, [scene] * 4).get(timeout=60)
    assert all(np.array_equal(image, expected) for image in images)


ALL_AT_ONCE = """
    import sys, threading
    sys.path.insert(0, {tests!r})
    from conftest import widening_model
    import psfield
    psfield.set_threads({threads})
    stars = {{"x": [10.0, 20.0], "y": [10.0, 30.0], "flux": [1.0, 2.0]}}
    galaxies = {{**stars, "re": [3.0, 2.0], "n": [1.0, 1.0]}}
    for _ in range(3):
        model = widening_model((512, 512), size=33, across=6)
        plan = model.plan((512, 512), 1e-4)
        calls = [lambda: plan.simulate(catalog=stars), lambda: plan.simulate(catalog=galaxies)] * 4
        threads = [threading.Thread(target=call) for call in calls]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    print("done")
"""


@pytest.mark.parametrize("threads", [1, 2])
def test_the_first_sources_may_come_to_many_threads_at_once(threads):
    # A thread that makes a plan and picks up a call that waits for this plan would never end.
    program = textwrap.dedent(ALL_AT_ONCE).format(
        tests=str(ROOT / "python" / "tests"), threads=threads
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.stdout == "done\n", ran.stderr


NESTED = """
    import sys
    sys.path.insert(0, {tests!r})
    import numpy as np
    from conftest import relative_l2, widening_model
    import psfield
    psfield.set_threads({threads})
    model = widening_model((256, 256))
    sampled = psfield.PsfModel.from_function(model.evaluate, (256, 256), threshold=0.05)
    plan = model.plan((256, 256), 1e-3, method="lowrank")
    def look(done, total):
        return sampled.evaluate(3, 4), plan.simulate(np.ones((256, 256)))
    plan.simulate(np.ones((256, 256)), progress=look)
    print(relative_l2(sampled.evaluate(100, 90), model.evaluate(100, 90)) < 0.05)
"""


@pytest.mark.parametrize("threads", [1, 2])
def test_functions_of_the_caller_may_use_psfield(threads):
    # If threads of the pool called the functions, work started by the functions would wait for
    # these threads.
    program = textwrap.dedent(NESTED).format(tests=str(ROOT / "python" / "tests"), threads=threads)
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.stdout == "True\n", ran.stderr
