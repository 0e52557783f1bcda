# SPDX-License-Identifier: MIT
"""The C code in README.md and in the manual is C: it compiles without a warning, links, and starts. The program of
README.md, as it stands, has no data race between its three contexts, and withstands flipped bits."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from build_support import INCLUDE, ONBOARD, PLANAR, ROOMS, ROOT, kept, onboard, run, tool
from runs_support import trajectory_of

from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.native import flight
from zygos.simulation.scenario import load_scenario

FLAGS = "-std=c11 -Wall -Wextra -Wconversion -Wshadow -pedantic -Werror".split()
PAGES = (ROOT / "README.md", ROOT / "docs" / "integrate.md", ROOT / "docs" / "refine.md")
CONTEXTS = Path(__file__).parent / "contexts.c"
SYNC_MODULUS = 240
MAIN = """
int main(void)
{
    double stiffness = 0.0;
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    const zygos_frame_t frame = { .id = 0x7FFu };
    const int begun = arm_start();
    can_receive(&frame);
    return (begun == 1 && estimator_task() == 0 && solver_task(&stiffness) == 0 && payload_was_taken() == 1 &&
            before_the_end(head) == 1 && after_the_start(head, sizeof head + sizeof arm.state) == 1) ? 0 : 1;
}
"""


def program(page: Path) -> str:
    """The blocks of C on a page as one file."""
    blocks = re.findall(r"^```c\n(.*?)^```$", page.read_text(), re.M | re.S)
    assert blocks
    return '#include "zygos/zygos.h"\n' + "\n".join(blocks)


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_it_compiles_without_a_warning(page: Path, compiler: str, tmp_path: Path) -> None:
    (tmp_path / "page.c").write_text(program(page))
    run([tool(compiler), *FLAGS, INCLUDE, f"-I{ONBOARD}", "-c", "page.c"], tmp_path)


def test_the_program_of_the_manual_starts(tmp_path: Path) -> None:
    (tmp_path / "page.c").write_text(program(PAGES[1]) + MAIN)
    library = onboard() / "zygos" / "lib"
    said = run(
        [tool("pkg-config"), "--cflags", "--libs", "zygos"], tmp_path, PKG_CONFIG_LIBDIR=str(library / "pkgconfig")
    )
    run([tool("gcc"), *FLAGS, f"-I{ONBOARD}", "page.c", *said.split(), "-o", "page"], tmp_path)
    run([str(tmp_path / "page")], tmp_path)


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of frames of examples/paper."""
    folder = ROOT / "examples" / "paper"
    arm, model = load_arm(folder / "arm.toml"), load_model(folder / "model.toml")
    cycles = trajectory_of(arm, model, load_scenario(folder / "scenario.toml")).cycles()
    assert len(cycles) % SYNC_MODULUS == 0
    path = tmp_path_factory.mktemp("bus") / "frames"
    path.write_bytes(flight.encode(arm, cycles)[:-1].tobytes())
    return path


def contexts(memory: str, sanitizers: str, level: str, *flags: str) -> Path:
    """README's program with this memory for solutions, the library and contexts.c, with sanitizers."""
    source = program(PAGES[0])
    assert source.count("zygos_background_t memory;") == 1
    source = source.replace("zygos_background_t memory;", f"{memory} memory;")
    command = [
        tool("gcc"), *FLAGS, level, "-g", "-ffp-contract=off", "-D_POSIX_C_SOURCE=200809L", *PLANAR.split(), *flags,
        f"-fsanitize={sanitizers}", "-fno-sanitize-recover=all", "-pthread", INCLUDE, f"-I{ONBOARD}", "-I.",
        str(CONTEXTS), *map(str, ROOMS), "-lm", "-o", "contexts",
    ]  # fmt: skip

    def build(folder: Path) -> None:
        (folder / "page.c").write_text(source)
        run(command, folder)

    return kept(build, source, *command, sources=[CONTEXTS, ONBOARD / "arm_config.h"]) / "contexts"


def flown(program: Path, bus: Path, *words: int) -> dict[str, int]:
    """What contexts.c counts. A sanitizer that finds something writes it and ends the program with an error."""
    names = ("begun_again", "cycles", "overrun", "estimates", "values", "repairs", "losses")
    out = run([str(program), str(bus), *map(str, words)], bus.parent)
    return dict(zip(names, map(int, out.split()), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("memory", "flags"),
    [("zygos_background_t", ()), ("zygos_in_place_t", ()), ("zygos_background_t", ("-DREFINE",))],
    ids=["background", "in-place", "refining"],
)
def test_the_program_of_the_readme_has_no_data_race(memory: str, flags: tuple[str, ...], bus: Path) -> None:
    """An interrupt thread, the task and the background, under ThreadSanitizer."""
    frames = int(os.environ.get("ZYGOS_RACE_FRAMES", "30000"))
    found = flown(contexts(memory, "thread", "-O2", *flags), bus, frames)
    assert found["cycles"] > frames / 7.1  # seven frames a cycle, and FTIME
    assert found["values"] > 0
    assert found["overrun"] == found["repairs"] == found["losses"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("memory", ["zygos_background_t", "zygos_in_place_t"], ids=["background", "in-place"])
def test_flipped_bits_take_the_program_of_the_readme_not_out_of_its_memory(memory: str, bus: Path) -> None:
    """Bits of `arm` and of its memory flip between the calls, under the sanitizers of addresses and of undefined
    behaviour; there are still estimates with values."""
    found = flown(contexts(memory, "address,undefined", "-O0"), bus, 300_000, 3_000)
    assert found["repairs"] > 30
    assert found["values"] > 3
