"""The compiled simulator against torch, and what happens without a compiler."""

import ctypes
import dataclasses
import functools
import logging
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch

from racerl.vehicle import compiler as building
from racerl.vehicle import kernel
from racerl.vehicle.kernel import CompiledMotion, TorchMotion, choose_motion
from racerl.vehicle.parameter import values
from tests.vehicle.conftest import random_states

CPU = torch.device("cpu")
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this machine")
NAMES = ["friction", "mass", "front.p_Ky1", "steering.time_constant"]


def tables(car, names, count, seed=0):
    generator = torch.Generator().manual_seed(seed)
    nominal = values(car)
    column = torch.tensor([nominal[name] for name in names])[:, None]
    return column * (1 + 0.1 * torch.randn(len(names), count, generator=generator))


@needs_compiler
def test_kernel_follows_torch_for_100_steps(built_car):
    names = [name for name in NAMES if name in values(built_car)]
    step = 0.001 if hasattr(built_car.drive, "current_limit") else 0.01
    compiled = choose_motion(built_car, names, step, 5, CPU, torch.float32)
    assert isinstance(compiled, CompiledMotion)
    exact = TorchMotion(built_car, names, step, 5)
    state, command = random_states(built_car, 100)
    command = 0.5 * command
    state[3], state[7] = 3.0 + state[4], 3.0 + state[4]
    table = tables(built_car, names, 100)
    counts = (1, 15, 16, 17, 100)  # cars; 16 fill a group
    got, rounded = {n: state[:, :n].float() for n in counts}, state.float()
    for _ in range(20):
        state = exact(state, command, table.double())
        got = {n: compiled(each, command[:, :n].float(), table[:, :n]) for n, each in got.items()}
        rounded = exact(rounded, command.float(), table)
    scale = state.abs().amax(dim=1, keepdim=True).clamp(min=1.0)
    # all effects at once: torch in single precision is itself off by as much
    rounding = float(((rounded - state).abs() / scale).max())
    for n, each in got.items():
        assert ((each - state[:, :n]).abs() / scale).max() < max(1e-5, 3.0 * rounding), n


@needs_compiler
def test_gradients_follow_torch(built_car):
    names = [name for name in NAMES if name in values(built_car)]
    step = 0.001 if hasattr(built_car.drive, "current_limit") else 0.01
    compiled = choose_motion(built_car, names, step, 5, CPU, torch.float32)
    exact = TorchMotion(built_car, names, step, 5)
    state, command = random_states(built_car, 37, seed=3)
    direction = torch.randn(state.shape, generator=torch.Generator().manual_seed(1))

    def pulled(motion, dtype):
        inputs = [t.to(dtype).requires_grad_() for t in (state, 0.5 * command, tables(built_car, names, 37))]
        return torch.autograd.grad((motion(*inputs) * direction.to(dtype)).sum(), inputs)

    for got, expected in zip(pulled(compiled, torch.float32), pulled(exact, torch.float64), strict=True):
        assert (got - expected).abs().max() <= 1e-4 * (1.0 + expected.abs().max())


EMULATION = """
#include <math.h>
#define __CUDACC__
#define __device__
#define __global__
static const struct { int x; } blockIdx = {0}, threadIdx = {0}, blockDim = {1}, gridDim = {1};
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler on this machine")
def test_the_source_for_cuda_computes_the_same(built_car, tmp_path):
    names = [name for name in NAMES if name in values(built_car)]
    step = 0.001 if hasattr(built_car.drive, "current_limit") else 0.01
    (tmp_path / "kernel.cpp").write_text(EMULATION + kernel.source(built_car, names, step, 5))
    command = ["g++", "-O1", "-shared", "-fPIC", "kernel.cpp", "-o", "kernel.so"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "kernel.so"))

    def launch(name, tables, count):
        getattr(library, name)(*(ctypes.c_void_p(table.data_ptr()) for table in tables), count)

    deviation = kernel._deviation(CompiledMotion(launch), TorchMotion(built_car, names, step, 5), CPU)
    assert deviation < kernel.TOLERANCE


@needs_compiler
def test_a_lost_car_stays_lost_and_alone(car):
    compiled = choose_motion(car, ["friction"], 0.01, 5, CPU, torch.float32)
    state, command = random_states(car, 40)
    state[4, 7] = torch.nan
    state[3, 20] = torch.inf
    out = compiled(state.float(), command.float(), tables(car, ["friction"], 40))
    broken = ~torch.isfinite(out).all(dim=0)
    assert broken.nonzero().flatten().tolist() == [7, 20]


@needs_compiler
def test_many_processes_build_a_kernel_once(tmp_path):
    """The compiler counts its calls and dawdles."""
    (tmp_path / "bin").mkdir()
    compiler = tmp_path / "bin" / "cc"
    compiler.write_text(f'#!/bin/sh\necho "$@" >>{tmp_path}/calls\nsleep 0.1\nexec /usr/bin/cc "$@"\n')
    compiler.chmod(0o755)
    code = "from racerl.vehicle.compiler import build; print(build('int seven(void) { return 7; }').seven())"
    environment = {"XDG_CACHE_HOME": str(tmp_path), "PATH": f"{compiler.parent}:/usr/bin:/bin", "PYTHONPATH": "."}
    jobs = [subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE) for _ in range(3)]
    assert [job.communicate(timeout=120)[0].decode().strip() for job in jobs] == ["7"] * 3
    assert [path.suffix for path in (tmp_path / "racerl" / "kernels").iterdir()] == [".so"]
    assert (tmp_path / "calls").read_text().count(" -c ") == 1


@needs_compiler
def test_the_process_keeps_subnormal_numbers(car):
    assert choose_motion(car, [], 0.01, 5, CPU, torch.float32).name == "compiled"
    assert np.float64(5e-324) * 1.0 > 0.0


def test_without_a_compiler_torch_takes_over_and_says_so_once(car, monkeypatch, caplog):
    monkeypatch.setattr(building, "find_compiler", functools.cache(building.find_compiler.__wrapped__))
    monkeypatch.setattr(building.shutil, "which", lambda name: None)
    with caplog.at_level(logging.WARNING):
        motions = [choose_motion(car, [], 0.01, 5, CPU, torch.float32) for _ in range(2)]
    assert [motion.name for motion in motions] == ["torch", "torch"]
    assert caplog.text.count("no C compiler") == 1


def test_a_broken_compiler_is_survived(car, monkeypatch, caplog, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(building, "FLAGS", ("--no-such-flag",))
    with caplog.at_level(logging.WARNING):
        motion = choose_motion(car, [], 0.01, 5, CPU, torch.float32)
    assert motion.name == "torch" and "could not be compiled" in caplog.text


@needs_compiler
def test_a_wrong_kernel_is_refused(car, monkeypatch, caplog):
    other = dataclasses.replace(car, mass=car.mass * 1.3)
    monkeypatch.setattr(kernel, "source", lambda vehicle, *rest, honest=kernel.source: honest(other, *rest))
    with caplog.at_level(logging.WARNING):
        motion = choose_motion(car, [], 0.01, 5, CPU, torch.float32)
    assert motion.name == "torch" and "disagrees" in caplog.text


def test_other_devices_and_precisions_run_on_torch(car):
    assert choose_motion(car, [], 0.01, 5, CPU, torch.float64).name == "torch"


@pytest.mark.gpu
def test_the_kernel_on_a_gpu_is_the_one_on_the_cpu(built_car):
    names = [name for name in NAMES if name in values(built_car)]
    step = 0.001 if hasattr(built_car.drive, "current_limit") else 0.01
    motions = [choose_motion(built_car, names, step, 5, torch.device(kind), torch.float32) for kind in ("cpu", "cuda")]
    assert [motion.name for motion in motions] == ["compiled", "compiled"]
    state, command = random_states(built_car, 1000, seed=5)
    inputs = [tensor.float() for tensor in (state, 0.5 * command, tables(built_car, names, 1000))]
    on_cpu, on_gpu = motions[0](*inputs), motions[1](*(tensor.cuda() for tensor in inputs)).cpu()
    assert ((on_gpu - on_cpu).abs() / (1.0 + on_cpu.abs())).max() < 1e-4
