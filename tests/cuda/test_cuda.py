"""Test the GPU code in numba's simulator, with scenes of at most 50 positioners: ``tox -e cuda``.

The simulator must be enabled before numba is imported. On a machine with a GPU, the same tests run without it.
"""

import importlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import rfpsurvey as rs
from rfpsurvey.collision import METHODS, place_arms
from scenes import MM, SCENES, lamost_like, many_tips, random_tips

numba_cuda = pytest.importorskip("numba.cuda")
if not numba_cuda.is_available():
    pytest.skip("no GPU, and NUMBA_ENABLE_CUDASIM is not set to 1", allow_module_level=True)


@pytest.fixture(autouse=True)
def _several_blocks(monkeypatch):
    """Use blocks that are smaller than a scene, and chunks that are smaller than a batch."""
    monkeypatch.setattr(importlib.import_module("rfpsurvey._kernels.gpu"), "THREADS", 16)
    monkeypatch.setitem(METHODS, "cuda", replace(METHODS["cuda"], chunk=2))


@pytest.mark.parametrize("name", SCENES)
def test_a_gpu_counts_as_the_processor(name, rng):
    plane, options = SCENES[name]
    assert len(plane) <= 50
    tips = many_tips(plane, rng, 9 if name == "both hands" else 3)
    tips[0, 3, 1] = np.nan * MM  # a tip with one missing coordinate is not a target
    here, there = (rs.collision.count_collisions(plane, tips, method=m, **options) for m in ("exact", "cuda"))
    for field in here.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(here, field), getattr(there, field))


def test_a_gpu_finds_the_same_pairs(rng):
    plane = lamost_like(3)
    for _ in range(2):
        arms = place_arms(plane, random_tips(plane, rng))
        here, there = (rs.find_collisions(plane, arms, method=m) for m in ("exact", "cuda"))
        np.testing.assert_array_equal(here.pairs, there.pairs)
        np.testing.assert_allclose(here.distances.value, there.distances.value, atol=1e-12)
        assert there.n_borderline == 0


def test_borderline_pairs_are_settled_there_too():
    for gap, n in ((4.5, 0), (np.nextafter(4.5, 0), 1)):
        plane = rs.FocalPlane([[0, 0], [0, gap]] * MM, rs.Positioner(4 * MM, 4 * MM, 2.25 * MM))
        report = rs.find_collisions(plane, [[8, 0], [8, gap]] * MM, method="cuda")
        assert (len(report.pairs), report.n_borderline) == (n, 1)
        assert rs.collision.count_collisions(plane, [[[8, 0], [8, gap]]] * MM, method="cuda").n_borderline.tolist() == [
            1
        ]


def test_tips_out_of_reach_are_named():
    plane = lamost_like(1)
    tips = np.stack([plane.xy + 3 * MM, plane.xy + 3 * MM])
    tips[1, 4] += 50 * MM
    with pytest.raises(rs.InputError, match="configuration 1: 1 tips .*; the first is the tip of positioner 4"):
        rs.collision.count_collisions(plane, tips, method="cuda")
    unequal = rs.FocalPlane(plane.xy, rs.Positioner(7 * MM, 9 * MM, 2 * MM))
    with pytest.raises(rs.InputError, match="configuration 0: 7 tips are out of reach"):
        rs.collision.count_collisions(unequal, unequal.xy[None] + 1 * MM, method="cuda")


COMPILE = """
from types import SimpleNamespace
from numba import cuda, types
from numba.cuda import dispatcher
dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(9, 0))
import rfpsurvey._kernels.gpu as gpu
F, I, B = types.float64, types.int64, types.boolean
A = lambda kind, n: types.Array(kind, n, "C")
SIGNATURES = {
    "pose_tips": (A(F, 3), A(F, 2), A(F, 2), F, F, A(F, 2), I, F, A(F, 2), A(F, 3), A(I, 1)),
    "count": (A(F, 3), A(F, 3), A(I, 1), A(I, 1), F, F, F, A(B, 1), A(I, 1), A(F, 2), F, A(I, 2), A(I, 1)),
    "list_pairs": (A(F, 2), A(I, 1), A(I, 1), F, F, A(I, 1), A(F, 1), A(I, 1)),
}
for name, types_of in SIGNATURES.items():
    ptx, _ = cuda.compile(getattr(gpu, name).py_func, types_of, device=False, abi="numba", cc=(9, 0), output="ptx")
    print(name, ".f64" in ptx, "call" in ptx)
"""


def test_the_kernels_compile_for_a_device():
    """Compile without a GPU, but with NVIDIA's compiler. The simulator accepts types that a device does not support."""
    pytest.importorskip("numba_cuda")
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_ENABLE_CUDASIM"}
    done = subprocess.run([sys.executable, "-c", COMPILE], capture_output=True, text=True, env=environment)
    if "NvvmSupportError" in done.stderr or "libNVVM" in done.stderr:
        pytest.skip("NVIDIA's compiler is not there: pip install 'rfpsurvey[cuda]'")
    if "CudaSupportError" in done.stderr:
        pytest.skip("this numba-cuda asks for a driver even to compile")
    assert done.stdout.split() == [
        "pose_tips",
        "True",
        "False",
        "count",
        "True",
        "False",
        "list_pairs",
        "True",
        "False",
    ]
