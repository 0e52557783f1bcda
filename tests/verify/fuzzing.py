# SPDX-License-Identifier: MIT
"""Fuzzing for a stated time: bytes that a guided fuzzer chooses, and random frames and states of seeds that go on."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fuzz import fuzz_support
from verify.result import BUILD, Result, digest, judged, missing

PLACE = BUILD / "fuzz"
CAPACITIES = {"MAX_JOINTS": 2, "MAX_BLOCKS": 12, "SPATIAL": 0}
# What the kernel reports as most memory of a process includes that of its parent before exec: the limit is on requests.
LIMITS = ["-max_len=4096", "-timeout=20", "-rss_limit_mb=0", "-malloc_limit_mb=256"]
GUIDED = "-fsanitize=fuzzer,address,undefined,float-cast-overflow -fno-sanitize-recover=all".split()
FRAMES, STATES = 200_000, 800
"""Of one seed."""


def guided(folder: Path) -> Path | None:
    """Compile tests/fuzz/fuzz_bytes.c for libFuzzer. Returns None where clang or its library is missing."""
    program = folder / "fuzz_bytes"
    folder.mkdir(parents=True, exist_ok=True)
    flags = ["-std=c11", "-O1", "-g", "-ffp-contract=off", *GUIDED, f"-I{fuzz_support.ROOT / 'include'}"]
    defines = [f"-DZYGOS_{name}={value}" for name, value in CAPACITIES.items()]
    sources = [*sorted((fuzz_support.ROOT / "c").glob("*/*.c")), Path(fuzz_support.__file__).with_name("fuzz_bytes.c")]
    if shutil.which("clang") is None:
        return None
    command = ["clang", *flags, *defines, *map(str, sources), "-lm", "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "libclang_rt.fuzzer" in done.stderr:
        return None
    done.check_returncode()
    return program


def bytes_for(program: Path, seconds: float, folder: Path) -> tuple[int, list[str]]:
    """Let libFuzzer choose inputs; its corpus stays for the next time. Returns how many it tried, and what it found."""
    corpus = folder / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    options = [*LIMITS, f"-max_total_time={max(1, round(seconds))}", "-print_final_stats=1"]
    command = [str(program), *options, f"-artifact_prefix={folder}/", str(corpus)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    tried = re.search(r"stat::number_of_executed_units:\s+(\d+)", done.stderr)
    if done.returncode == 0:
        return int(tried[1]) if tried else 0, []
    kept = re.search(r"Test unit written to (\S+)", done.stderr)
    why = re.search(r"(?:ERROR|runtime error): .*", done.stderr)
    what = why[0] if why else done.stderr.strip()[-300:]
    return int(tried[1]) if tried else 0, [f"guided bytes: {what}; the input is {kept[1] if kept else 'not kept'}"]


def first_seed() -> int:
    """It follows from the sources: the same ones have the same seeds, others try what was not tried before."""
    return int(digest(), 16) % 1_000_000_000


def seeds_for(
    driver: str, build: Callable[[], Path], arguments: tuple[int, ...], seconds: float
) -> tuple[int, list[str]]:
    """Run a driver of tests/fuzz with one seed after the other until the time is over.

    Returns how many seeds were tried, and what the last one found.
    """
    program = build()
    first = first_seed()
    until, seed = time.monotonic() + seconds, first
    while time.monotonic() < until:
        done = subprocess.run([program, str(seed), *map(str, arguments)], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            text = (done.stdout + done.stderr).strip().replace(f"{fuzz_support.ROOT}/", "")
            return seed - first + 1, [f"{driver} with seed {seed} ends with status {done.returncode}: {text[-300:]}"]
        seed += 1
    return seed - first, []


def result(minutes: float) -> Result:
    """Three kinds of fuzzing, one after the other on one core, two at a time on more; crashes fail."""
    if shutil.which(os.environ.get("CC", "cc").split()[0]) is None:
        return missing("a C compiler", "build-essential")
    workers = 2 if (os.cpu_count() or 1) > 1 else 1
    seconds = 60.0 * minutes * workers / 4.0
    program = guided(PLACE)
    folders = {name: PLACE / name for name in ("frames", "states")}
    for folder in folders.values():
        folder.mkdir(parents=True, exist_ok=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    with ThreadPoolExecutor(workers) as pool:
        free = pool.submit(bytes_for, program, 2.0 * seconds, PLACE) if program else None
        frames = pool.submit(
            seeds_for, "fuzz_frames", lambda: fuzz_support.build(folders["frames"], "fuzz_frames", **CAPACITIES),
            (FRAMES, 2, 1), seconds,
        )  # fmt: skip
        states = pool.submit(
            seeds_for, "fuzz_states", lambda: fuzz_support.build(folders["states"], "fuzz_states", **CAPACITIES),
            (STATES, 2), seconds,
        )  # fmt: skip
        tried, found = free.result() if free else (0, [])
        found = [*found, *frames.result()[1], *states.result()[1]]
        counts = {"frames": frames.result()[0] * FRAMES, "states": states.result()[0] * STATES, "inputs": tried}
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    figure = (
        f"{minutes:g} minutes, of which the fuzzers had {processor / 60.0:.0f} of processor time: "
        f"{counts['inputs']:,} guided inputs, {counts['frames']:,} frames and "
        f"{counts['states']:,} damaged states under the sanitizers; {len(found)} failures"
    )
    if not program and not found:
        absent = missing("libFuzzer", "clang libclang-rt-14-dev")
        return Result(
            absent.verdict, f"{figure}; no guided inputs, as libFuzzer is not installed", absent.findings, counts
        )
    return judged(found, figure, minutes=minutes, **counts)
