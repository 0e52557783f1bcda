"""`make install`, seen from outside: other people's projects, in C and C++, through pkg-config and CMake."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from build_support import ROOT, make, run, tool

HEADERS = {path.name for path in (ROOT / "include" / "zygos").glob("*.h")}
INSTALLED = {
    *(f"include/zygos/{name}" for name in HEADERS),
    "lib/libzygos.a",
    "lib/cmake/zygos/zygosConfig.cmake",
    "lib/cmake/zygos/zygosConfigVersion.cmake",
    "lib/pkgconfig/zygos.pc",
    "share/zygos/zygos.dbc",
    "share/zygos/zygos-coarse-gyro.dbc",
}
SMALL = "-DZYGOS_MAX_JOINTS=2 -DZYGOS_SPATIAL=0"
STRICT = ["-Wall", "-Wextra", "-pedantic", "-Werror"]
VERSION = ".".join(re.findall(r"#define ZYGOS_VERSION_M\w+ (\d+)", (ROOT / "include/zygos/types.h").read_text()))

# A rigid joint on a fixed base: the smallest configuration that the library accepts.
PROGRAM = """
#include <stdio.h>
#include <string.h>
#include <zygos/zygos.h>

static zygos_t arm;
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
    const int verdict = zygos_init(&arm, &config);
    int used = 0;
    if (verdict == 1) {
        zygos_cycle_t cycle;
        memset(&cycle, 0, sizeof cycle);
        cycle.sync = 1;
        used = zygos_cycle(&arm, &cycle);
        zygos_take(&arm, &work);
        (void)zygos_solve(&work, &estimate);
    }
    printf("%d %d %d %d\\n", ZYGOS_MAX_JOINTS, verdict, used, (int)estimate.reason);
    return 0;
}
"""
WORKS = "2 1 1 1"  # two joints at the most, accepted, one cycle in, ZYGOS_REASON_NO_DATA

CMAKE = """
cmake_minimum_required(VERSION 3.16)
project(outside C CXX)
{find}
add_executable(in_c program.c)
add_executable(in_cpp program.cpp)
set_target_properties(in_cpp PROPERTIES CXX_STANDARD 17 CXX_STANDARD_REQUIRED ON)
target_link_libraries(in_c PRIVATE zygos::zygos)
target_link_libraries(in_cpp PRIVATE zygos::zygos)
"""


def files(tree: Path) -> set[str]:
    return {str(path.relative_to(tree)) for path in tree.rglob("*") if not path.is_dir()}


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A prefix with a build for two joints in the plane."""
    folder = tmp_path_factory.mktemp("installed")
    make("install", folder / "build", PREFIX=folder / "prefix", CAPACITIES=SMALL)
    return folder / "prefix"


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """Somebody's project: the same program in C and C++."""
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "program.c").write_text(PROGRAM)
    (folder / "program.cpp").write_text(PROGRAM)
    return folder


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


def through_cmake(folder: Path, find: str, *options: str) -> list[str]:
    """What the programs of a CMake project print, in C and in C++."""
    (folder / "CMakeLists.txt").write_text(CMAKE.format(find=find))
    shutil.rmtree(folder / "b", ignore_errors=True)
    cmake = tool("cmake")
    run([cmake, "-S", ".", "-B", "b", *options], folder)
    run([cmake, "--build", "b"], folder)
    return [run([str(folder / "b" / name)], folder).strip() for name in ("in_c", "in_cpp")]


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
    assert version.strip() == VERSION


def test_links_through_cmake(installed: Path, outside: Path) -> None:
    find = f"find_package(zygos {VERSION} REQUIRED)"
    assert through_cmake(outside, find, f"-DCMAKE_PREFIX_PATH={installed}") == [WORKS, WORKS]


def test_cmake_finds_no_other_version(installed: Path, outside: Path) -> None:
    major, minor = VERSION.split(".")
    for other in (f"{major}.{int(minor) + 1}", f"{int(major) + 1}.0"):
        (outside / "CMakeLists.txt").write_text(CMAKE.format(find=f"find_package(zygos {other} REQUIRED)"))
        command = [tool("cmake"), "-S", ".", "-B", "b", f"-DCMAKE_PREFIX_PATH={installed}"]
        done = subprocess.run(command, cwd=outside, capture_output=True, text=True, check=False)
        assert done.returncode != 0
        assert f'compatible with requested version "{other}"' in " ".join(done.stderr.split())


@pytest.mark.slow
def test_links_as_a_folder_of_a_cmake_project(outside: Path, installed: Path) -> None:
    """add_subdirectory(), which is what FetchContent does with a checkout; the rooms compile as by the Makefile."""
    find = f'set(ZYGOS_CAPACITIES ZYGOS_MAX_JOINTS=2 ZYGOS_SPATIAL=0)\nadd_subdirectory("{ROOT}" zygos)'
    assert through_cmake(outside, find) == [WORKS, WORKS]
    code = []
    for archive in (outside / "b" / "zygos" / "libzygos.a", installed / "lib" / "libzygos.a"):
        sizes = run([tool("size"), str(archive)], outside).splitlines()[1:]
        code.append(sorted((Path(line.split()[5]).name.split(".")[0], line.split()[0]) for line in sizes))
    assert code[0] == code[1]
    assert len(code[0]) == len(list((ROOT / "c").glob("*.c")))


def test_cmake_alone_installs_nothing(tmp_path: Path) -> None:
    cmake = tool("cmake")
    run([cmake, "-S", str(ROOT), "-B", "b"], tmp_path)
    done = subprocess.run(
        [cmake, "--install", "b", "--prefix", "p"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "remedy: make install" in done.stderr
    assert not (tmp_path / "p").exists()


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
    make("install", tmp_path / "build", PREFIX=tmp_path / "p", CFLAGS=f"-O0 {SMALL} -fPIC")
    assert [word for word in flags(tmp_path / "p", "--cflags") if word.startswith("-D")] == SMALL.split()


def test_nothing_but_c_is_installed(installed: Path) -> None:
    assert files(installed) == INSTALLED
    for name in INSTALLED - {"lib/libzygos.a"}:
        text = (installed / name).read_text()
        assert not re.search(r"Eigen|#include *<(?!std(int|bool)\.h>)|\btemplate\b|Python\.h", text), name
        assert str(ROOT) not in text, name
        assert str(installed.parent) not in text, name
        assert not re.search(r"@[A-Z]+@", text), name
    members = run([tool("ar"), "t", "lib/libzygos.a"], installed).split()
    assert sorted(members) == sorted(f"{path.stem}.o" for path in (ROOT / "c").glob("*.c"))


@pytest.mark.slow
def test_destdir_is_put_in_front(tmp_path: Path, installed: Path) -> None:
    make("install", tmp_path / "build", DESTDIR=tmp_path / "root", PREFIX="/opt/zygos", CAPACITIES=SMALL)
    staged = tmp_path / "root" / "opt" / "zygos"
    assert files(tmp_path / "root") == {f"opt/zygos/{name}" for name in INSTALLED}
    assert not Path("/opt/zygos").exists()
    for name in INSTALLED:  # the tree is the same wherever it goes
        assert (staged / name).read_bytes() == (installed / name).read_bytes(), name


def test_uninstall_removes_what_install_put_there(tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    others = {"lib/libother.a", "include/zygos/mine.h", "lib/pkgconfig/other.pc"}
    for name in others:
        (prefix / name).parent.mkdir(parents=True, exist_ok=True)
        (prefix / name).touch()
    make("install", tmp_path / "build", PREFIX=prefix, CFLAGS="-O0")
    assert files(prefix) == INSTALLED | others
    make("uninstall", tmp_path / "build", PREFIX=prefix)
    assert files(prefix) == others
    assert not (prefix / "lib" / "cmake" / "zygos").exists()
    assert not (prefix / "share" / "zygos").exists()


@pytest.mark.slow
def test_two_installations_of_one_tree_keep_their_capacities(tmp_path: Path, outside: Path) -> None:
    for joints in (2, 3, 2):
        make(
            "install",
            tmp_path / "build",
            PREFIX=tmp_path / str(joints),
            CAPACITIES=f"-DZYGOS_MAX_JOINTS={joints}",
            CFLAGS="-O0",
        )
    for joints in (2, 3):
        answer = through_pkg_config(tmp_path / str(joints), outside, "gcc", "c11", "program.c")
        assert answer == f"{joints} 1 1 1"


def test_a_tree_with_a_space_that_is_moved_still_links(installed: Path, outside: Path, tmp_path: Path) -> None:
    moved = tmp_path / "another place"
    shutil.copytree(installed, tmp_path / "first")
    (tmp_path / "first").rename(moved)
    assert through_pkg_config(moved, outside, "gcc", "c11", "program.c") == WORKS
    assert through_cmake(outside, "find_package(zygos REQUIRED)", f"-Dzygos_ROOT={moved}") == [WORKS, WORKS]
    # a Makefile hands what pkg-config answers to the shell, which reads the escaped space
    (outside / "Makefile").write_text(
        "program: program.c\n\tcc $(shell pkg-config --cflags zygos) $< $(shell pkg-config --libs zygos) -o $@\n"
    )
    (outside / "program").unlink()
    run([tool("make")], outside, PKG_CONFIG_PATH=str(moved / "lib" / "pkgconfig"))
    assert run([str(outside / "program")], outside).strip() == WORKS


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of what `make install` needs, below a folder with a space."""
    tree = tmp_path / "my sources"
    tree.mkdir()
    shutil.copy(ROOT / "Makefile", tree)
    for folder in ("c", "include", "tools/package"):
        shutil.copytree(ROOT / folder, tree / folder)
    return tree


@pytest.mark.slow
def test_installs_from_and_to_paths_with_a_space(sources: Path, outside: Path, tmp_path: Path) -> None:
    prefix = tmp_path / "my prefix"
    make("install", Path("build"), sources, PREFIX=prefix, CAPACITIES=SMALL)
    assert files(prefix) == INSTALLED
    assert through_pkg_config(prefix, outside, "gcc", "c11", "program.c") == WORKS
    make("uninstall", Path("build"), sources, PREFIX=prefix)
    assert files(prefix) == set()


@pytest.mark.slow
def test_what_changed_is_compiled_again(sources: Path) -> None:
    def compiled(**variables: str) -> set[str]:
        """The rooms that `make library` compiles."""
        return set(re.findall(r"-c c/(\w+)\.c", make("library", Path("build"), sources, **variables)))

    off = "-O0"
    everything = {path.stem for path in (ROOT / "c").glob("*.c")}
    assert compiled(CFLAGS=off) == everything
    assert compiled(CFLAGS=off) == set()
    with (sources / "include" / "zygos" / "wire.h").open("a") as header:
        header.write("/* changed */\n")
    assert {"wire", "cycle", "zygos"} <= compiled(CFLAGS=off) < everything
    assert compiled(CFLAGS=off, CAPACITIES=SMALL) == everything
    assert compiled(CFLAGS=off, CAPACITIES=SMALL) == set()
    assert compiled(CFLAGS="-O1", CAPACITIES=SMALL) == everything
    (sources / "c" / "gram.c").unlink()
    (sources / "c" / "wire.c").touch()
    make("library", Path("build"), sources, CFLAGS="-O1", CAPACITIES=SMALL)
    members = run([tool("ar"), "t", "build/libzygos.a"], sources).split()
    assert "gram.o" not in members


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


@pytest.mark.slow
def test_the_manual_links_as_it_says(outside: Path, tmp_path: Path) -> None:
    """The commands of docs/integrate.md, with another folder in place of /opt/zygos."""
    section = (ROOT / "docs" / "integrate.md").read_text().split("\n## Link\n")[1].split("\n## ")[0]
    shell, cmake, folder, cross = re.findall(r"```(?:sh|cmake)\n(.*?)```", section, re.S)
    prefix = tmp_path / "opt"
    install, rest = shell.replace("/opt/zygos", str(prefix)).split("\n", 1)
    (outside / "program.c").rename(outside / "main.c")
    run(["sh", "-ec", f"{install} BUILD={tmp_path / 'build'}"], ROOT)
    run(["sh", "-ec", rest], outside)
    assert run([str(outside / "main")], outside).strip() == WORKS
    assert "target_link_libraries(main PRIVATE zygos::zygos)" in cmake
    for k, text in enumerate((cmake, folder.replace("path/to/zygos", str(ROOT)) + cmake.split("\n", 1)[1])):
        head = "cmake_minimum_required(VERSION 3.16)\nproject(outside C)\nadd_executable(main main.c)\n"
        (outside / "CMakeLists.txt").write_text(head + text)
        run([tool("cmake"), "-S", ".", "-B", f"b{k}", f"-DCMAKE_PREFIX_PATH={prefix}"], outside)
        run([tool("cmake"), "--build", f"b{k}"], outside)
        assert run([str(outside / f"b{k}" / "main")], outside).strip() == WORKS
    run(["sh", "-ec", f"{cross.strip()} BUILD={tmp_path / 'm7'} ".replace("/opt/zygos", str(prefix))], ROOT)
    assert files(tmp_path / "opt-m7") == INSTALLED


TARGETS = {
    "gcc": ("gcc", ""),
    "clang": ("clang", ""),
    "m7": ("arm-none-eabi-gcc", "-mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard"),
    "m4f": ("arm-none-eabi-gcc", "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard"),
    "leon3": ("sparc64-linux-gnu-gcc", "-m32 -mcpu=leon3 -fno-pie"),
}
# What C compilers call on their own, and the square root of processors that have none for doubles.
CALLED = {"memcpy", "memmove", "memset", "memcmp", "sqrt"}


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_archive_exports_zygos_and_needs_the_compilers_runtime_only(target: str, tmp_path: Path) -> None:
    compiler, options = TARGETS[target]
    make("library", tmp_path, CC=tool(compiler), CFLAGS=f"{options} {SMALL} -Werror")

    def symbols(archive: str, kinds: str) -> set[str]:
        done = subprocess.run([nm, archive], cwd=tmp_path, capture_output=True, text=True, check=True)
        return {m[1] for m in re.finditer(rf"^[0-9a-f ]* [{kinds}] (\S+)$", done.stdout, re.M)}

    nm = tool(run([compiler, "-print-prog-name=nm"], tmp_path).strip())
    exported = symbols("libzygos.a", "A-TV-Z")  # all capitals but U
    assert exported
    assert {name for name in exported if not name.startswith("zygos_")} == set()
    runtime = run([compiler, *options.split(), "-print-libgcc-file-name"], tmp_path).strip()
    needed = symbols("libzygos.a", "U") - exported - CALLED
    assert needed <= symbols(runtime, "TW"), "the library calls what is neither its own nor the compiler's"
    root = symbols("libzygos.a", "U") & {"sqrt"}
    assert root == ({"sqrt"} if target == "m4f" else set())
