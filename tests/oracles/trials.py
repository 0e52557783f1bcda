# SPDX-License-Identifier: MIT
"""`make gap`: hide effects in plants of MuJoCo, ask `zygos explain`, score its JSON, and keep every score in a ledger.

    python -m oracles.trials [WORD...] [draws=N] [from=N] [workers=N] [again]
    python -m oracles.trials table      only writes docs/trials.md and out/gap.json from the ledger
    python -m oracles.trials limits     only writes limits.json from the nulls in the ledger

Words select cells by parts of their names (`planar/null`, `pendulum/`, `without`). A run that is in the ledger for the
same product is not made again, so that a campaign that was cut short goes on where it stopped; `again` makes it again,
and the ledger keeps both.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from conftest import ROOT
from oracles import ledger
from oracles.cells import LIMITS, Case, case, cell_named, wanted
from oracles.score import Truth, as_json, multiple, overlaps, score, stated_limits, truth
from oracles.simulate import write
from zygos.arm import save_arm
from zygos.files.output import say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import save_model
from zygos.report.provenance import measured_commit
from zygos.runs.tables import write_cycles

TIMEOUT_S = 600
RUNS = "abc"


def make(one: Case, folder: Path, duration_s: float | None = None) -> Truth:
    """Write what the product is given into a folder, and return what it must not see."""
    suffix = "csv" if one.plant.trial.table else "blf"
    motions = []
    for k, name in enumerate(RUNS):
        cycles, motion = one.plant.run(k, one.seed, duration_s)
        motions.append(motion)
        path = folder / f"{name}.{suffix}"
        if one.plant.trial.table:
            write_cycles(path, cycles)
        else:
            write(cycles, one.plant.trial.arm, path)
    save_arm(one.arm, folder / "arm.toml")
    save_model(one.simulation, folder / "simulation.toml")
    return truth(one, motions[:2])


def ask(one: Case, folder: Path) -> tuple[dict[str, Any], str]:
    """The verdict of the product; where it gives none, its message."""
    runs = sorted(folder.glob("[abc].*"))
    command = [sys.executable, "-m", "zygos.cli", "explain", "--simulation", "simulation.toml", "--arm", "arm.toml"]
    command += [runs[0].name, runs[1].name, "--validate", runs[2].name]
    command += ["--without", one.cell.without] if one.cell.without else []
    command += ["-o", "new.toml", "--json", "verdict.json"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return {}, f"no answer in {TIMEOUT_S} s"
    file = folder / "verdict.json"
    if file.is_file():
        return json.loads(file.read_text()), ""
    # the ledger is committed: a traceback names files of the checkout, and not where it lies
    return {}, " ".join(done.stderr.replace(f"{ROOT}/", "").split())[-300:]


def line_of(one: Case, true: Truth, verdict: dict[str, Any], message: str) -> dict[str, Any]:
    """What the ledger keeps of a run."""
    cell, joints = one.cell, [joint.name for joint in one.arm.joints]
    verdict = verdict or {"answer": "refused", "sentence": message}
    gap = verdict.get("gap") or {}
    return {
        "cell": cell.name,
        "draw": one.draw,
        "seed": one.seed,
        "arm": cell.arm,
        "group": cell.group,
        "nominal": min((h.times for h in cell.hidden), default=0.0),
        "dirty": one.dirty,
        "declared": any(joint.torque_sigma for joint in one.arm.joints),
        "product": ledger.product(),
        "commit": measured_commit(),
        "generator": ledger.generator(),
        "truth": [[e["key"], e["joint"], _short(e["size"]), e["exact"]] for e in as_json(true)["effects"]],
        "answer": verdict["answer"],
        "sentence": verdict["sentence"],
        "findings": [
            [f["effect"], f["joint"], _short(f["value"]), *map(_short, f["interval"]), f["cannot_tell_from"]]
            for f in verdict.get("findings") or []
        ],
        "multiple": _short(multiple(true, verdict, joints)),
        "overlap": {k: _short(v) for k, v in overlaps(true, verdict, joints).items()},
        "limits": {k: _short(v) for k, v in stated_limits(verdict).items()} if cell.group == "null" else {},
        "gap": {k: _short(gap.get(k)) for k in ("as_delivered", "refit", "closed", "floor")} if gap else None,
        "score": score(true, verdict, joints),
    }


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def one_run(name: str, draw: int) -> dict[str, Any]:
    """Hide, ask, score. In a process of its own: MuJoCo's callback belongs to a process."""
    one = case(cell_named(name), draw)
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="zygos-trial-") as temporary:
        folder = Path(temporary)
        true = make(one, folder)
        made, plant = time.monotonic(), time.process_time()
        verdict, message = ask(one, folder)
        kept = os.environ.get("KEEP")
        if kept:
            target = Path(kept) / f"{name.replace('/', '-')}-{draw}"
            shutil.copytree(folder, target, dirs_exist_ok=True)
            write_json(str(target / "truth.json"), as_json(true))
    line = line_of(one, true, verdict, message)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    line["plant_s"], line["explain_s"] = _short(made - begin), _short(time.monotonic() - made)
    line["plant_cpu_s"], line["cpu_s"] = _short(plant), _short(spent.ru_utime + spent.ru_stime)
    return line


def _child(name: str, draw: int) -> dict[str, Any]:
    """`one_run` in a process that ends with it."""
    code = "import json, sys; from oracles.trials import one_run as run; "
    code += "print('LINE' + json.dumps(run(sys.argv[1], int(sys.argv[2]))))"
    done = subprocess.run([sys.executable, "-c", code, name, str(draw)], capture_output=True, text=True, check=False)
    found = [text for text in done.stdout.splitlines() if text.startswith("LINE")]
    if not found:
        raise RuntimeError(f"{name} {draw}: {done.stderr[-2000:]}")
    return json.loads(found[-1][4:])


def campaign(jobs: Sequence[tuple[str, int]], workers: int) -> list[dict[str, Any]]:
    """Run jobs side by side, and append each to the ledger as it ends."""
    out = []
    with ThreadPoolExecutor(workers) as pool, progress() as bar:
        task = bar.add_task("trials", total=len(jobs))
        futures = [pool.submit(_child, *job) for job in jobs]
        try:
            for future in as_completed(futures):
                line = future.result()
                ledger.append(line)
                out.append(line)
                bar.advance(task)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return out


def spread(words: Sequence[str], draws: int | None, first: int) -> list[tuple[str, int]]:
    """Cells and draws, dealt out in turns, so that a campaign that is cut short has some of every arm and kind."""
    jobs = []
    for cell in wanted(words):
        for k in range(draws or cell.draws):
            jobs.append((k / (draws or cell.draws), cell.name, first + k))
    return [(name, draw) for _, name, draw in sorted(jobs, key=lambda job: job[0])]


def show(lines: Sequence[dict[str, Any]]) -> int:
    """Print the figures and the runs that are not right, and write out/gap.json; 1 if anything is missed."""
    found = ledger.measures(lines)
    wrong = [line for line in lines if not line["score"]["right"]]
    if wrong:
        table(
            ("cell", "draw", "hidden", "multiple", "answer"),
            [
                (line["cell"], str(line["draw"]), ", ".join(f"{k} {s:.3g}" for k, _, s, _ in line["truth"]),
                 str(line["multiple"]), ledger.instead(line) if line["answer"] != "refused" else line["sentence"][:80])
                for line in wrong
            ],
            title="not right",
        )  # fmt: skip
    table(
        ("measure", "asked", "found", "exact limit", "runs", ""),
        [
            (
                m.name,
                m.asked,
                ledger.shown(m),
                m.limit,
                str(m.runs),
                ledger.verdict(m),
            )
            for m in found
        ],
    )
    write_json("out/gap.json", {"measures": [vars(m) for m in found], "runs": list(lines)})
    return int(any(ledger.verdict(m) == "missed" for m in found))


def main(arguments: Sequence[str]) -> int:
    """See the head of this file."""
    options = dict(word.split("=", 1) for word in arguments if "=" in word)
    words = [word for word in arguments if "=" not in word and word != "again"]
    if words == ["limits"]:
        LIMITS.write_text(json.dumps(ledger.typical_limits(ledger.read()), indent=1) + "\n")
        return 0
    if words == ["table"]:
        names = [cell.name for cell in wanted([])]
        ledger.write_page(names)
        return show(ledger.newest(ledger.counted(ledger.read(), names)))
    draws = int(options["draws"]) if "draws" in options else None
    jobs = spread(words, draws, int(options.get("from", 0)))
    if "again" not in arguments:
        done = {(line["cell"], line["draw"]) for line in ledger.read() if line["product"] == ledger.product()}
        jobs = [job for job in jobs if job not in done]
    begin = time.monotonic()
    lines = campaign(jobs, int(options.get("workers", os.cpu_count() or 1)))
    say(f"{len(lines)} runs in {time.monotonic() - begin:.0f} s, in {ledger.LEDGER}")
    of = {(line["cell"], line["draw"]) for line in lines}
    names = {cell.name for cell in wanted(words)}
    return show([x for x in ledger.newest(ledger.read()) if x["cell"] in names or (x["cell"], x["draw"]) in of])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
