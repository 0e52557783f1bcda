# SPDX-License-Identifier: MIT
"""The cache of simulated runs: tests name the run that they need, and each run is simulated once.

A run is kept in build/runs under a digest of all that it depends on: the arguments and the sources of what computes it.
`make clean` removes the folder, and other sources begin a new one. Only tests of the simulator itself call it directly.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import os
import pickle
import shutil
import types
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from zygos.arm import Arm
from zygos.dynamics.equations import EngineName, equations
from zygos.model.model import Model
from zygos.simulation import plant
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]
HARNESS = ROOT / "harness"
FOLDER = Path(os.environ.get("ZYGOS_RUNS", ROOT / "build" / "runs")).resolve()
SIMULATOR = tuple(
    f"zygos.{name}" for name in "simulation.plant dynamics.engines.mujoco dynamics.engines.pinocchio".split()
)
"""The modules whose sources, with what they import, a trajectory depends on."""


def trajectory_of(
    arm: Arm, model: Model, scenario: Scenario, *, engine: EngineName = "zygos", progress: Any = None, **options: Any
) -> Trajectory:
    """What `zygos.simulation.plant.simulate` returns for these arguments. The arrays are read-only."""

    def simulated() -> Trajectory:
        found = plant.simulate(arm, model, scenario, engine=engine, progress=progress, **options)
        return replace(found, dynamics=None, sensors=())  # type: ignore[arg-type]

    found: Trajectory = kept(simulated, SIMULATOR, arm, model, scenario, engine, options)
    sensors = tuple(effect for effect in model.effects if effect.kind.place == "sensor")
    return replace(found, dynamics=equations(found.arm, model, engine), sensors=sensors)


def kept(compute: Callable[[], Any], modules: tuple[str, ...], *arguments: Any) -> Any:
    """What `compute` returns, from the cache where it is known. modules: those whose sources it depends on;
    arguments: what else it depends on. The result is pickled, and its arrays are read-only."""
    digest = hashlib.sha256()
    for piece in _content((modules, arguments)):
        digest.update(piece)
    path = FOLDER / _sources(modules) / digest.hexdigest()
    if path in _recent:
        out = _recent.pop(path)
    elif path.exists():
        out = pickle.loads(path.read_bytes())
    else:
        out = compute()
        with contextlib.suppress(OSError):  # a checkout that cannot be written, as in a guest, keeps nothing
            _make(path.parent)
            partial = path.with_name(f"{path.name}.{os.getpid()}")
            partial.write_bytes(pickle.dumps(out, protocol=5))
            partial.replace(path)
    _freeze(out)
    _recent[path] = out
    if len(_recent) > LARGEST:
        del _recent[next(iter(_recent))]
    return out


_recent: dict[Path, Any] = {}
"""The results that this process used last; LARGEST of them."""
LARGEST = 48


def _make(folder: Path) -> None:
    """Make the folder of a state of the sources, and remove those of other states."""
    if not folder.exists():
        name, _, _ = folder.name.rpartition("-")
        for other in FOLDER.glob(f"{name}-*"):
            if other != folder:
                shutil.rmtree(other, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)


def _freeze(value: Any) -> None:
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif is_dataclass(value):
        for field in fields(value):
            _freeze(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for part in value:
            _freeze(part)


def _content(value: Any) -> Iterable[bytes]:
    """Bytes that are the same for equal values only. Where a file stands makes no difference."""
    if isinstance(value, Path):
        return
    yield type(value).__qualname__.encode() + b"("
    if is_dataclass(value):
        for field in fields(value):
            yield field.name.encode()
            yield from _content(getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype}{value.shape}".encode() + value.tobytes()
    elif isinstance(value, dict):
        yield from _content(sorted(value.items()))
    elif isinstance(value, frozenset):
        yield from _content(sorted(value, key=repr))
    elif isinstance(value, tuple | list | range):
        for part in value:
            yield from _content(part)
    elif isinstance(value, types.FunctionType):
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        yield from _content((value.__code__, value.__defaults__, value.__kwdefaults__, cells))
    elif isinstance(value, types.CodeType):
        yield value.co_code + repr(value.co_names).encode()
        yield from _content(value.co_consts)
    elif value is None or value is ... or isinstance(value, str | bytes | bool | int | float | complex | np.generic):
        yield repr(value).encode()
    elif isinstance(value, types.MethodType):
        yield from _content((value.__func__, value.__self__))
    elif isinstance(value, type | types.BuiltinFunctionType | np.ufunc):
        yield value.__name__.encode()
    else:
        raise TypeError(f"{value!r} cannot be an argument of a cached run; remedy: teach runs_support.py to tell it")
    yield b")"


@cache
def _sources(modules: tuple[str, ...]) -> str:
    """Name of the folder of these modules' results: digest of the sources that they import, and of compiled ones."""
    known: dict[Path, bytes] = {}
    for module in modules:
        _collect(module, known)
    for path in sorted((ROOT / "c" / "ports" / "host").iterdir()):
        known[path] = path.read_bytes()
    digest = hashlib.sha256()
    for path in sorted(known):
        digest.update(known[path])
    return f"{modules[0]}-{digest.hexdigest()[:16]}"


def _collect(module: str, known: dict[Path, bytes]) -> None:
    """Add the source of a module, and of all that it imports from zygos or from the oracles."""
    for folder in (HARNESS, ROOT / "tests"):
        path = folder.joinpath(*module.split("."))
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if path.exists() and path not in known:
            known[path] = path.read_bytes()
            for node in ast.walk(ast.parse(known[path])):
                if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    _collect(node.module, known)
                    for name in node.names:
                        _collect(f"{node.module}.{name.name}", known)
                elif isinstance(node, ast.Import):
                    for name in node.names:
                        _collect(name.name, known)
