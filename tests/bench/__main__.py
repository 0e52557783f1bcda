# SPDX-License-Identifier: MIT
"""Measures what the flight library costs, here and on Cortex-M, beside its peers (`make bench`).

    python -m bench [out/bench.json [CONFIGURATION ...]]

Writes the file, a copy to docs/bench.json, and the tables of docs/cost.md from it. If configurations are
named, only their instructions and bytes are measured, and the rest is taken from docs/bench.json. The name `solutions`
stands for the dearest solution.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from bench import cortex, peers, solutions, tables
from bench.configurations import BARE, CONFIGURATIONS
from bench.rows import FOLDER, TARGETS, measure
from conftest import ROOT
from zygos.errors import ZygosError
from zygos.files.output import errors_end_the_program, note, say, write_json
from zygos.files.progress import progress
from zygos.report.provenance import measured_commit

PROFILED = ("paper, bare", "seven, bare")


SOLUTIONS = "solutions"
"""What bench/solutions.py counts."""
NO_VCAN = 3
"""Status of tools/with-vcan where there can be none."""


def throughput() -> dict[str, float]:
    """Frames per second through cffi, and through a vcan where there is one or can be."""
    path = FOLDER / "throughput.json"
    command = [sys.executable, "-m", "bench.throughput", str(path)]
    done = subprocess.run([str(ROOT / "tools" / "with-vcan"), *command], capture_output=True, text=True, check=False)
    if done.returncode == NO_VCAN:
        note(done.stderr.strip())
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"frames per second: {done.stderr.strip()[-500:]}; remedy: see there")
    found: dict[str, float] = json.loads(path.read_text())
    return found


def versions() -> dict[str, str]:
    """First lines of what the tools say of themselves."""
    named = ("gcc", "arm-none-eabi-gcc", "valgrind", "qemu-system-arm")
    said = {one: subprocess.run([one, "--version"], capture_output=True, text=True, check=True).stdout for one in named}
    return {one: text.splitlines()[0] for one, text in said.items()} | {"zygos": f"zygos of commit {measured_commit()}"}


def chosen(path: Path, names: list[str]) -> None:
    """Measure the named configurations, and put them in place of what docs/bench.json has of them."""
    possible = (*CONFIGURATIONS, SOLUTIONS)
    unknown = [name for name in names if name not in possible]
    if unknown:
        raise ZygosError(f"no configuration {unknown[0]!r}; remedy: use some of {' · '.join(possible)}")
    content = json.loads(tables.COMMITTED.read_text())
    if SOLUTIONS in names:
        content[SOLUTIONS] = solutions.measure(FOLDER / SOLUTIONS)
    known = {(row["target"], row["configuration"], row["stage"]): row for row in content["rows"]}
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        jobs = {
            (target, name): pool.submit(measure, target, name)
            for target in TARGETS
            for name in names
            if name != SOLUTIONS
        }
        for (target, name), job in jobs.items():
            rows, found = job.result()
            known |= {(target, name, row["stage"]): row for row in rows}
            if name in PROFILED:
                content["profiles"][target][name] = found
    order = [(target, name) for target in TARGETS for name in CONFIGURATIONS]
    content["rows"] = sorted(known.values(), key=lambda row: order.index((row["target"], row["configuration"])))
    store(path, content)


def store(path: Path, content: dict[str, Any]) -> None:
    """Write what was found, and the tables; print these."""
    for place in (path, tables.COMMITTED):
        write_json(place, content)
    for block in tables.blocks(content):
        block.write()
        say(block.text + "\n")


def main(path: Path) -> None:
    """Measure everything, write it, print the tables."""
    missing = [one for one in ("gcc", "g++", "valgrind", *cortex.firmware.TOOLS) if shutil.which(one) is None]
    missing += [] if peers.EIGEN.is_dir() else ["Eigen"]
    if missing:
        raise ZygosError(
            f"not installed: {', '.join(missing)}; remedy: apt install build-essential valgrind libeigen3-dev "
            + cortex.firmware.PACKAGES
        )
    counted = [(target, name) for target in TARGETS for name in CONFIGURATIONS]
    compared = [name for name in CONFIGURATIONS if name.endswith(BARE)]
    folder = FOLDER / "peers"
    with progress() as bar:
        task = bar.add_task("counting", total=len(counted) + len(peers.OPTIMISED) + len(compared) + 1)

        def done(_: object) -> None:
            bar.advance(task)

        with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
            jobs = {}
            for key in sorted(counted, key=lambda key: list(CONFIGURATIONS).index(key[1]), reverse=True):
                jobs[key] = pool.submit(measure, *key)  # what takes longest begins first
            builds = {one: pool.submit(peers.build, folder / one.replace(" ", ""), one) for one in peers.OPTIMISED}
            for counting in jobs.values():
                counting.add_done_callback(done)
            for building in builds.values():
                building.add_done_callback(done)
            results = {key: job.result() for key, job in jobs.items()}
            programs = {one: job.result().resolve() for one, job in builds.items()}
        bar.update(task, description="timing")  # alone
        found = []
        for name in compared:
            found += [*peers.native(name, folder, programs), *peers.interpreted(name)]
            done(None)
        frames = throughput()
        done(None)
    content = {
        "tools": versions(),
        "rows": [row for key in counted for row in results[key][0]],
        "peers": [asdict(peer) for peer in found],
        "frames_per_second": frames,
        SOLUTIONS: solutions.measure(FOLDER / SOLUTIONS),
        "profiles": {target: {name: results[target, name][1] for name in PROFILED} for target in TARGETS},
    }
    store(path, content)


if __name__ == "__main__":
    with errors_end_the_program():
        out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/bench.json")
        chosen(out, sys.argv[2:]) if len(sys.argv) > 2 else main(out)
