"""The C code in README.md and in the manual is C: it compiles without a warning, links, and starts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from build_support import INCLUDE, ONBOARD, ROOT, onboard, run, tool

FLAGS = "-std=c11 -Wall -Wextra -Wconversion -Wshadow -pedantic -Werror".split()
PAGES = (ROOT / "README.md", ROOT / "docs" / "integrate.md")
MAIN = """
void can_enable(bool enabled) { (void)enabled; }
int main(void)
{
    double stiffness = 0.0;
    const int begun = arm_start();
    const zygos_frame_t frame = { .id = 0x7FFu };
    can_receive(&frame);
    return (begun == 1 && estimator_task() == 1 && solver_task(&stiffness) == 0 && arm_learned() == 0 &&
            arm_has_changed() == 0 && payload_was_taken() == 1) ? 0 : 1;
}
"""


def program(page: Path) -> str:
    """The blocks of C on a page as one file; statements without a function become one."""
    blocks = re.findall(r"^```c\n(.*?)^```$", page.read_text(), re.M | re.S)
    assert blocks
    whole = [
        block
        if re.match(r"static |int |#include|/\*", block)
        else f"void configure(zygos_config_t config)\n{{\n{block}(void)config;\n}}\n"
        for block in blocks
    ]
    return '#include "zygos/zygos.h"\n' + "\n".join(whole)


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
