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
