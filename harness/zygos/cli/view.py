# SPDX-License-Identifier: MIT
"""`zygos view`: show the arm of a run moving."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy.spatial.transform import Rotation

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Json, Run, cuts
from zygos.cli.shared import not_whole, read_run
from zygos.dynamics.pose import motion, skeleton
from zygos.errors import ZygosError
from zygos.files.output import (
    check_outputs,
    counted,
    note,
    number,
    quiet,
    say,
    table,
    write_bytes,
    write_json,
    write_text,
)
from zygos.files.progress import progress
from zygos.model.model import load_model


def view_run(
    run_file: Path,
    arm_file: Path | None,
    model_file: Path | None,
    png_file: Path | None,
    at: float | None,
    html_file: Path | None,
    exaggerate: float,
    port: int,
    json: str | None,
) -> None:
    """Show a run; see `zygos view --help`."""
    from zygos.view.scene import (  # noqa: PLC0415  (the help needs no extra)
        FRAMES_PER_S,
        MOST_FRAMES,
        STILLS,
        film,
        frame_instants,
        page,
        png,
        serve,
    )

    chosen = find_arm(run_file, arm_file)
    check_outputs([png_file, html_file, json], [run_file, chosen, run_file.parent / "arm.toml", model_file])
    if at is not None and png_file is None:
        raise ZygosError("--at selects the instant of the still in --png; remedy: add --png FILE")
    arm = load_arm(chosen)
    lengths = skeleton(arm, load_model(model_file) if model_file else None)
    recorded = read_run(run_file, arm)
    run = motion(arm, recorded.cycles)
    last = float(run.time[-1])
    if at is not None and not 0.0 <= at <= last:
        raise ZygosError(f"--at {at:g}: the run lasts from 0 to {last:g} s; remedy: give a time in this range")
    content = ""
    if html_file is not None or png_file is None:
        frames = frame_instants(run, max(2, min(MOST_FRAMES, round(last * FRAMES_PER_S))))
        with progress() as bar:
            task = bar.add_task("drawing", total=len(frames))
            shown = film(arm, lengths, run, frames, exaggerate)
            content = page(shown, lambda done: bar.update(task, completed=done))
    if png_file is not None:
        stills = frame_instants(run, STILLS) if at is None else np.array([np.argmin(np.abs(run.time - at))])
        write_bytes(png_file, png(film(arm, lengths, run, stills, exaggerate)))
    if html_file is not None:
        write_text(html_file, content)
    figures = [
        (joint.name, float(run.q[:, i].min()), float(run.q[:, i].max()), float(np.abs(run.deflection[:, i]).max()))
        for i, joint in enumerate(arm.joints)
    ]
    turned = float(Rotation.from_matrix(run.base).magnitude().max())
    if json:
        summary = {
            "run": str(run_file),
            "arm": arm.name,
            "schematic": lengths.mass is None,
            "cycles": len(run.time),
            "gaps": run.gaps,
            "duration_s": last,
            "base_turned_rad": turned,
            "joints": [
                {"name": name, "least_rad": least, "largest_rad": largest, "largest_deflection_rad": deflection}
                for name, least, largest, deflection in figures
            ],
            "png": str(png_file) if png_file else None,
            "html": str(html_file) if html_file else None,
        }
        write_json(json, summary)
    if not quiet(png_file, html_file, json):
        rows = [(name, *(number(angle, 4) for angle in angles)) for name, *angles in figures]
        table(("joint", "least rad", "largest rad", "largest |θ − q| rad"), rows)
        drawn = ", ".join(str(file) for file in (png_file, html_file) if file) or "in the browser"
        base = f"the base turned up to {number(turned, 3)} rad" if arm.free else "the base is fixed"
        say(f"{drawn}: {counted(len(run.time), 'cycle')}, {number(last, 4)} s, {base}")
    if lengths.mass is None:
        note("drawn schematically with lengths of 1 m, since none are known; remedy: --model with a model by bodies")
    if run.gaps:
        note(f"cycles are missing in {counted(run.gaps, 'place')}; after them the base's attitude is approximate")
    if png_file is None and html_file is None:
        serve(content, port)
    not_whole(recorded.damage)


@cuts
def command(
    run: Run,
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.toml", help="Bodies with lengths and masses. Default: all lengths 1 m."),
    ] = None,
    png: Annotated[
        Path | None, typer.Option("--png", metavar="FILE", help="Draw six stills, or with --at one.")
    ] = None,
    at: Annotated[float | None, typer.Option("--at", metavar="SECONDS", help="The instant of the one still.")] = None,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write a page that a browser plays, also offline.")
    ] = None,
    exaggerate: Annotated[
        float, typer.Option(metavar="FACTOR", min=0.0, help="Enlarge theta - q by this factor.")
    ] = 1.0,
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="Port of the browser's page; 0 selects a free one.")
    ] = 0,
    json: Json = None,
) -> None:
    """Show the arm of a run moving in 3-D: in the browser, as a page in a file, or as still pictures.

    Joint angles and the gyro move it; a free-floating arm is drawn about its mass centre. The translucent arm shows
    the motor angles (theta). Without --png and --html a page opens in the browser until Ctrl-C. --png needs no
    screen. This command needs an extra: pip install 'zygos[view]'.

    Example: zygos view out/run.blf --model examples/paper/model.toml --png out/arm.png
    """
    view_run(run, arm, model, png, at, html, exaggerate, port, json)
