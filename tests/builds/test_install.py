# SPDX-License-Identifier: MIT
"""`make install`, seen from outside: other people's projects, in C and C++, through pkg-config and CMake."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from build_support import PLANAR, ROOT, copied, flags_of, make, onboard, run, tool

HEADERS = {str(path.relative_to(ROOT / "include" / "zygos")) for path in (ROOT / "include" / "zygos").rglob("*.h")}
INSTALLED = {
    *(f"include/zygos/{name}" for name in HEADERS),
    "lib/libzygos.a",
    "lib/cmake/zygos/zygosConfig.cmake",
    "lib/cmake/zygos/zygosConfigVersion.cmake",
    "lib/pkgconfig/zygos.pc",
    "share/zygos/LICENSE",
    "share/zygos/zygos.dbc",
    "share/zygos/zygos-coarse-gyro.dbc",
}
SAME = {"CC": "gcc", "CFLAGS": f" {flags_of('gcc')}", "CAPACITIES": PLANAR}
"""What `make` has to be told so that it finds nothing to compile in the library of `onboard()`."""
TREE = {"wire": "in", "snapshot": "loop", "capacities": "loop"}
"""Rooms of a source tree that is compiled anew, and their folders: enough to check frames."""
STRICT = ["-Wall", "-Wextra", "-pedantic", "-Werror"]
RELEASE = ".".join(re.findall(r"#define ZYGOS_VERSION_\w+ (\d+)", (ROOT / "include/zygos/types.h").read_text()))
VERSION = RELEASE.rpartition(".")[0]

# A rigid joint on a fixed base: the smallest configuration that the library accepts.
PROGRAM = """
#include <stdio.h>
#include <string.h>
#include <zygos/zygos.h>

static zygos_arm_t arm;
static zygos_work_t work;
static zygos_estimate_t estimate;

int main(void)
{
    zygos_config_t config;
    memset(&config, 0, sizeof config);
    config.abi = ZYGOS_ABI;
    config.joints = 1;
    config.base = ZYGOS_BASE_FIXED;
    config.smoother_half_width = 5;
    config.smoother_order = 6;
    config.smoother_lag = 5;
    config.arc_cycles = 1000;
    config.forgetting_factor = 1.0;
    config.period_s = 0.01;
    config.imu_to_base[0] = config.imu_to_base[4] = config.imu_to_base[8] = 1.0;
    config.joint[0].node = 1;
    config.joint[0].rigid = 1;
    config.joint[0].axis[2] = 1.0;
    config.joint[0].gear_ratio = 50.0;
    config.joint[0].link_sign = config.joint[0].motor_sign = 1.0;
    const int verdict = zygos_arm_init(&arm, &config);
    int used = 0;
    if (verdict == 1) {
        zygos_cycle_t cycle;
        memset(&cycle, 0, sizeof cycle);
        cycle.sync = 1;
        used = zygos_arm_cycle(&arm, &cycle);
        zygos_arm_take(&arm, &work);
        (void)zygos_work_solve(&work, &estimate);
    }
    printf("%d %d %d %d\\n", ZYGOS_MAX_JOINTS, verdict, used, (int)estimate.reason);
    return 0;
}
"""
SMALL_PROGRAM = """
#include <stdio.h>
#include <zygos/wire.h>

int main(void)
{
    zygos_frame_t frame = { 0, 0, 0, { 0 }, { 0 } };
    printf("%d\\n", ZYGOS_MAX_JOINTS);
    return zygos_wire_check(&frame, 1, 0) == ZYGOS_WIRE_OK;
}
"""
WORKS = "2 1 1 1"  # two joints at the most, accepted, one cycle in, ZYGOS_REASON_NO_DATA

CMAKE = "cmake_minimum_required(VERSION 3.16)\nproject(outside C)\nadd_executable(main program.c)\n"
SHELL, FIND, FOLDER, CROSS = re.findall(
    r"```(?:sh|cmake)\n(.*?)```",
    (ROOT / "docs" / "integrate.md").read_text().split("\n## Link\n")[1].split("\n## ")[0],
    re.S,
)
"""What docs/integrate.md has: an installation, find_package(), add_subdirectory(), another processor."""


def files(tree: Path) -> set[str]:
    return {str(path.relative_to(tree)) for path in tree.rglob("*") if not path.is_dir()}


@pytest.fixture(scope="module")
def installed() -> Path:
    """A prefix with a build for two joints in the plane."""
    return onboard() / "zygos"


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """A folder of objects from which `make .. **SAME` installs without compiling."""
    return copied(onboard() / "library", tmp_path / "library")


def project(folder: Path, program: str) -> Path:
    """Somebody's project: the same program in C and C++."""
    folder.mkdir()
    (folder / "program.c").write_text(program)
    (folder / "program.cpp").write_text(program)
    return folder


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A project that uses the whole library."""
    return project(tmp_path / "outside", PROGRAM)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A project that uses the rooms of TREE."""
    return project(tmp_path / "small", SMALL_PROGRAM)


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A source tree with the rooms of TREE, below a folder with a space."""
    tree = tmp_path / "my sources"
    for folder in ("include", "tools/package"):
        shutil.copytree(ROOT / folder, tree / folder)
    for name in (
        "Makefile",
        "CMakeLists.txt",
        "LICENSE",
        "c/flags.txt",
        *(f"c/{TREE[room]}/{room}.c" for room in TREE),
    ):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tree / name)
    return tree


def flags(prefix: Path, *wanted: str) -> list[str]:
    """What pkg-config says of a prefix."""
    words = run([tool("pkg-config"), *wanted, "zygos"], prefix, PKG_CONFIG_PATH=str(prefix / "lib" / "pkgconfig"))
    return shlex.split(words)


def through_pkg_config(prefix: Path, folder: Path, compiler: str, standard: str, source: str) -> str:
    run(
        [tool(compiler), f"-std={standard}", *STRICT, *flags(prefix, "--cflags"), source,
         *flags(prefix, "--libs"), "-o", "program"],
        folder,
    )  # fmt: skip
    return run([str(folder / "program")], folder).strip()


def through_cmake(folder: Path, text: str, *options: str) -> str:
    """What a CMake project prints that has these lines of the manual."""
    (folder / "CMakeLists.txt").write_text(CMAKE + text)
    run([tool("cmake"), "-S", ".", "-B", "b", *options], folder)
    run([tool("cmake"), "--build", "b"], folder)
    return run([str(folder / "b" / "main")], folder).strip()


@pytest.mark.parametrize(
    ("compiler", "standard", "source"),
    [("gcc", "c11", "program.c"), ("clang", "c11", "program.c"), ("g++", "c++17", "program.cpp")],
)
def test_links_through_pkg_config(compiler: str, standard: str, source: str, installed: Path, outside: Path) -> None:
    assert through_pkg_config(installed, outside, compiler, standard, source) == WORKS
    version = run(
        [tool("pkg-config"), "--modversion", "zygos"],
        outside,
        PKG_CONFIG_PATH=str(installed / "lib" / "pkgconfig"),
    )
    assert version.strip() == RELEASE


def test_cmake_finds_no_other_version(installed: Path, outside: Path) -> None:
    major, minor = VERSION.split(".")
    for other in (f"{major}.{int(minor) + 1}", f"{int(major) + 1}.0"):
        find = f"cmake_minimum_required(VERSION 3.16)\nproject(outside NONE)\nfind_package(zygos {other} REQUIRED)\n"
        (outside / "CMakeLists.txt").write_text(find)
        command = [tool("cmake"), "-S", ".", "-B", "b", f"-DCMAKE_PREFIX_PATH={installed}"]
        done = subprocess.run(command, cwd=outside, capture_output=True, text=True, check=False)
        assert done.returncode != 0
        assert f'compatible with requested version "{other}"' in " ".join(done.stderr.split())


def test_cmake_installs_the_same_tree_and_obeys_the_build_type(sources: Path, small: Path, tmp_path: Path) -> None:
    """Another project finds it, with its capacities, and no option of ours takes the place of the user's."""
    prefix, build = tmp_path / "by cmake", tmp_path / "b"
    options = ["-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_C_FLAGS=-O1", "-DZYGOS_CAPACITIES=ZYGOS_MAX_JOINTS=2"]
    run([tool("cmake"), "-S", str(sources), "-B", str(build), "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *options], tmp_path)
    commands = (build / "compile_commands.json").read_text()
    assert " -O1 -g " in commands and "-O2" not in commands and "-ffp-contract=off" in commands
    run([tool("cmake"), "--build", str(build)], tmp_path)
    run([tool("cmake"), "--install", str(build), "--prefix", str(prefix)], tmp_path)
    assert files(prefix) == INSTALLED | {"lib/cmake/zygos/zygosConfig-debug.cmake"}
    assert through_cmake(small, FIND, f"-DCMAKE_PREFIX_PATH={prefix}") == "2"
    assert through_pkg_config(prefix, small, "gcc", "c11", "program.c") == "2"


def test_a_project_around_exports_the_library_with_its_own(sources: Path, small: Path, tmp_path: Path) -> None:
    """A static library that links zygos, in an export set of its own; warnings are those of that project."""
    (small / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(outer C)\n"
        f'add_subdirectory("{sources}" zygos)\nadd_library(outer STATIC program.c)\n'
        "target_link_libraries(outer PUBLIC zygos::zygos)\n"
        "install(TARGETS outer EXPORT outer ARCHIVE DESTINATION lib)\n"
        "install(EXPORT outer FILE outerConfig.cmake NAMESPACE outer:: DESTINATION lib/cmake/outer)\n"
    )
    run([tool("cmake"), "-S", ".", "-B", "b", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON"], small)
    commands = (small / "b" / "compile_commands.json").read_text()
    assert "-O2" in commands and "-Wconversion" not in commands
    run([tool("cmake"), "--build", "b"], small)
    run([tool("cmake"), "--install", "b", "--prefix", str(tmp_path / "p")], small)
    assert "zygos::zygos" in (tmp_path / "p" / "lib" / "cmake" / "outer" / "outerConfig.cmake").read_text()


def unlinked(said: str) -> str:
    """The name with the capacities of an object that the linker has refused."""
    found = re.search(r"undefined reference to `(zygos_capacities_\w+)'", said)
    assert found, said
    return found[1]


@pytest.mark.parametrize("other", ["-DZYGOS_MAX_JOINTS=3", "-DZYGOS_MAX_BLOCKS=12", "-DZYGOS_CYCLE_QUEUE=16"])
def test_a_caller_with_other_capacities_does_not_link(other: str, installed: Path, outside: Path) -> None:
    name = other.partition("=")[0]
    mine = [word for word in flags(installed, "--cflags") if not word.startswith(name)]
    command = [tool("gcc"), "-std=c11", *mine, other, "program.c", *flags(installed, "--libs"), "-o", "program"]
    done = subprocess.run(command, cwd=outside, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert f"_{other.rpartition('_')[2].lower().replace('=', '_')}_" in unlinked(done.stderr)


def test_a_caller_that_ignores_pkg_config_does_not_link(installed: Path, outside: Path) -> None:
    include, lib = f"-I{installed / 'include'}", f"-L{installed / 'lib'}"
    command = [tool("gcc"), include, "program.c", lib, "-lzygos", "-lm", "-o", "program"]
    done = subprocess.run(command, cwd=outside, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "_joints_7_" in unlinked(done.stderr)


def test_capacities_among_other_flags_go_on_to_the_caller(tmp_path: Path) -> None:
    sizes = "-DZYGOS_MAX_JOINTS=2 -DZYGOS_SPATIAL=0"
    make(str(tmp_path / "lib" / "pkgconfig" / "zygos.pc"), tmp_path / "lib" / "pkgconfig", CFLAGS=f"-O0 {sizes} -fPIC")
    assert [word for word in flags(tmp_path, "--cflags") if word.startswith("-D")] == sizes.split()


def test_nothing_but_c_is_installed(installed: Path) -> None:
    assert files(installed) == INSTALLED
    for name in INSTALLED - {"lib/libzygos.a"}:
        text = (installed / name).read_text()
        assert not re.search(r"Eigen|#include *<(?!std(int|bool)\.h>)|\btemplate\b|Python\.h", text), name
        assert str(ROOT) not in text, name
        assert str(installed.parent) not in text, name
        assert not re.search(r"@[A-Z]+@", text), name
    members = run([tool("ar"), "t", "lib/libzygos.a"], installed).split()
    assert sorted(members) == sorted(f"{path.stem}.o" for path in (ROOT / "c").glob("*/*.c"))


def test_destdir_is_put_in_front(library: Path, tmp_path: Path, installed: Path) -> None:
    make("install", library, DESTDIR=tmp_path / "root", PREFIX="/opt/zygos", **SAME)
    staged = tmp_path / "root" / "opt" / "zygos"
    assert files(tmp_path / "root") == {f"opt/zygos/{name}" for name in INSTALLED}
    assert not Path("/opt/zygos").exists()
    for name in INSTALLED:  # the tree is the same wherever it goes
        assert (staged / name).read_bytes() == (installed / name).read_bytes(), name


def test_uninstall_removes_what_install_put_there(library: Path, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    others = {"lib/libother.a", "include/zygos/mine.h", "lib/pkgconfig/other.pc"}
    for name in others:
        (prefix / name).parent.mkdir(parents=True, exist_ok=True)
        (prefix / name).touch()
    make("install", library, PREFIX=prefix, **SAME)
    assert files(prefix) == INSTALLED | others
    make("uninstall", library, PREFIX=prefix)
    assert files(prefix) == others
    assert not (prefix / "lib" / "cmake" / "zygos").exists()
    assert not (prefix / "share" / "zygos").exists()


def test_a_tree_with_a_space_that_is_moved_still_links(installed: Path, outside: Path, tmp_path: Path) -> None:
    moved = tmp_path / "another place"
    shutil.copytree(installed, tmp_path / "first")
    (tmp_path / "first").rename(moved)
    assert through_pkg_config(moved, outside, "gcc", "c11", "program.c") == WORKS
    assert f"find_package(zygos {VERSION} REQUIRED)\n" in FIND
    assert through_cmake(outside, FIND, f"-Dzygos_ROOT={moved}") == WORKS
    # a Makefile hands what pkg-config answers to the shell, which reads the escaped space
    (outside / "Makefile").write_text(
        "program: program.c\n\tcc $(shell pkg-config --cflags zygos) $< $(shell pkg-config --libs zygos) -o $@\n"
    )
    (outside / "program").unlink()
    run([tool("make")], outside, PKG_CONFIG_PATH=str(moved / "lib" / "pkgconfig"))
    assert run([str(outside / "program")], outside).strip() == WORKS


def test_two_installations_of_one_tree_keep_their_capacities(sources: Path, small: Path, tmp_path: Path) -> None:
    """From and to paths with a space."""
    prefix = {joints: tmp_path / f"my {joints}" for joints in (2, 3)}
    for joints in (2, 3, 2):
        sizes = f"-DZYGOS_MAX_JOINTS={joints}"
        make("install", Path("build"), sources, PREFIX=prefix[joints], CAPACITIES=sizes, CFLAGS="-O0")
    for joints in (2, 3):
        assert files(prefix[joints]) == INSTALLED
        assert through_pkg_config(prefix[joints], small, "gcc", "c11", "program.c") == f"{joints}"
    make("uninstall", Path("build"), sources, PREFIX=prefix[2])
    assert files(prefix[2]) == set()


def test_what_changed_is_compiled_again(sources: Path) -> None:
    def compiled(**variables: str) -> set[str]:
        """The rooms that `make library` compiles."""
        return set(re.findall(r"-c c/\w+/(\w+)\.c", make("library", Path("build"), sources, **variables)))

    off = "-O0"
    assert compiled(CFLAGS=off) == set(TREE)
    assert compiled(CFLAGS=off) == set()
    with (sources / "include" / "zygos" / "wire.h").open("a") as header:
        header.write("/* changed */\n")
    assert {"wire", "snapshot"} <= compiled(CFLAGS=off) < set(TREE)
    assert compiled(CFLAGS=off, CAPACITIES=PLANAR) == set(TREE)
    assert compiled(CFLAGS=off, CAPACITIES=PLANAR) == set()
    assert compiled(CFLAGS="-O1", CAPACITIES=PLANAR) == set(TREE)
    (sources / "c" / "loop" / "snapshot.c").unlink()
    (sources / "c" / "in" / "wire.c").touch()
    make("library", Path("build"), sources, CFLAGS="-O1", CAPACITIES=PLANAR)
    assert run([tool("ar"), "t", "build/libzygos.a"], sources).split() == ["wire.o", "capacities.o"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("CAPACITIES=ZYGOS_MAX_JOINTS=2", "CAPACITIES holds ZYGOS_MAX_JOINTS=2"),
        ("CAPACITIES=-O3", "remedy: CAPACITIES="),
        ("CAPACITIES=-DZYGOS_MAX_JOINTS=9", "ZYGOS_MAX_JOINTS must be 1..7"),
        ("CFLAGS=-ffast-math", "remedy: compile without -ffast-math"),
        ("CC=no-such-compiler", "no-such-compiler"),
    ],
)
def test_nothing_is_installed_of_a_build_that_is_refused(words: str, told: str, tmp_path: Path) -> None:
    command = [tool("make"), "install", f"BUILD={tmp_path / 'build'}", f"PREFIX={tmp_path / 'p'}", words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert told in done.stderr
    assert not (tmp_path / "p").exists()


def test_the_manual_links_as_it_says(sources: Path, small: Path, tmp_path: Path) -> None:
    """The commands of docs/integrate.md, with other folders in place of /opt/zygos and path/to/zygos. As a folder of a
    CMake project, as by FetchContent, the rooms compile as by the Makefile."""
    prefix = tmp_path / "opt"
    install, rest = SHELL.replace("/opt/zygos", str(prefix)).split("\n", 1)
    shutil.copy(small / "program.c", small / "main.c")
    run(["sh", "-ec", install], sources)
    run(["sh", "-ec", rest], small)
    assert run([str(small / "main")], small).strip() == "2"
    link = FIND.split("\n", 1)[1]
    assert link == "target_link_libraries(main PRIVATE zygos::zygos)\n"
    assert through_cmake(small, FOLDER.replace("path/to/zygos", f'"{sources}"') + link) == "2"
    code = []
    for archive in (small / "b" / "zygos" / "libzygos.a", prefix / "lib" / "libzygos.a"):
        sizes = run([tool("size"), str(archive)], small).splitlines()[1:]
        code.append(sorted((Path(line.split()[5]).name.split(".")[0], line.split()[0]) for line in sizes))
    assert code[0] == code[1]
    assert len(code[0]) == len(TREE)
    run(["sh", "-ec", f"{CROSS.strip()} BUILD=m7".replace("/opt/zygos", str(prefix))], sources)
    assert files(tmp_path / "opt-m7") == INSTALLED
