"""Memory of calls: no copies except the arrays of the caller and the result."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from conftest import ROOT

#: Planes of the tiles in progress on each thread, and memory that the allocator keeps.
WORK = 48 << 20

PROGRAM = """
    import sys
    sys.path.insert(0, {tests!r})
    import numpy as np
    from conftest import widening_model
    import psfield

    def field(name):
        lines = open("/proc/self/status")
        return next(int(line.split()[1]) << 10 for line in lines if line.startswith(name))

    shape = (6000, 6000)
    scene = np.ones(shape, np.float32)
    out = np.zeros(shape, np.float32)
    psfield.set_threads(2)
    plan = widening_model(shape, size=33).plan(shape, 1e-3)
    plan.simulate(scene, out=out)
    calls = {{
        "new": lambda: plan.simulate(scene),
        "out": lambda: plan.simulate(scene, out=out),
        "cut out": lambda: plan.simulate(np.broadcast_to(scene, (1, *shape))[0]),
        "adjoint": lambda: plan.adjoint(out),
    }}
    for name, call in calls.items():
        before = field("VmRSS")
        open("/proc/self/clear_refs", "w").write("5")
        call()
        print(name.replace(" ", "_"), field("VmHWM") - before, scene.nbytes)
"""


@pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="only Linux tells of the peak of a call"
)
def test_a_call_takes_the_memory_of_its_image_alone():
    program = textwrap.dedent(PROGRAM).format(tests=str(ROOT / "python" / "tests"))
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True
    )
    figures = {
        name: (int(peak), int(image))
        for name, peak, image in (line.split() for line in ran.stdout.splitlines())
    }
    assert set(figures) == {"new", "out", "cut_out", "adjoint"}
    for name, (peak, image) in figures.items():
        assert peak <= (0 if name == "out" else image) + WORK, (name, peak)


REFUSED = """
    import resource
    import sys
    sys.path.insert(0, {tests!r})
    import numpy as np
    from conftest import widening_model
    import psfield

    def refused(name, call):
        try:
            call()
        except MemoryError as error:
            assert "MiB" in str(error), error
            print(name)

    psfield.set_threads(2)
    shape = (6000, 6000)
    model = widening_model((96, 128))
    plan = widening_model(shape).plan(shape, 1e-3)
    star = {{"x": [100.0], "y": [100.0], "flux": [1.0]}}
    plan.simulate(catalog=star)
    small, scene = model.plan((96, 128), 1e-3), np.ones((96, 128), np.float32)
    small.simulate(scene)
    stamps = np.random.default_rng(1).random((400, 64, 64))
    unfitted = psfield.PsfModel.from_samples(stamps, np.random.default_rng(2).random((400, 2)))
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (100 << 20),) * 2)
    refused("image", lambda: plan.simulate(catalog=star))
    refused("adjoint", lambda: plan.adjoint(np.broadcast_to(np.float32(1), shape)))
    refused("stamps", lambda: model.evaluate(np.zeros(10**5), 0.0))
    refused("stack", lambda: small.simulate(np.broadcast_to(scene, (3000, 96, 128))))
    refused("fit", unfitted.fit_report)
    # The interpreter and the plans are as before.
    small.simulate(scene)
    print("done")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of addresses is that of Linux")
def test_a_refused_allocation_is_a_memory_error():
    program = textwrap.dedent(REFUSED).format(tests=str(ROOT / "python" / "tests"))
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split() == ["image", "adjoint", "stamps", "stack", "fit", "done"]


def test_a_plan_has_the_size_limit_of_the_command_line():
    import psfield

    model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    with pytest.raises(ValueError, match=r"shape: 40000 x 40000 pixels are too many"):
        model.plan((40_000, 40_000))
