# SPDX-License-Identifier: MIT
"""The machinery of `make verify`: mutants, judgements, missing tools, gaps without a reason, exceeded limits."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from cffi import FFI

import verify.__main__ as command
from conftest import ROOT, need
from verify import analysis, coverage, fuzzing, limits, mutants, mutation
from verify.result import FAILED, MISSING, PASSED, Result
from zygos.errors import ZygosError
from zygos.report.provenance import measured_commit

SMALL = """
#include <stdint.h>
static const uint32_t table[2] = { 3, 5 };
struct pair { uint32_t first; double second; };
uint32_t sum(const uint32_t *x, uint32_t n)
{
    uint32_t total = 0;
    for (uint32_t i = 0; i < n; i++) {
        total += x[i];
    }
    return total;
}
double chosen(double a, double b)
{
    struct pair one = { .first = table[0], .second = a };
    if (one.second > b) {
        one.second = b;
    }
    return -one.second;
}
"""
TESTS = """
import os
from cffi import FFI
ffi = FFI()
ffi.cdef("uint32_t sum(uint32_t *x, uint32_t n); double chosen(double a, double b);")
lib = ffi.dlopen(os.environ["SMALL"])
def test_sum():
    assert lib.sum([1, 2, 3, 9], 3) == 6
def test_chosen():
    assert lib.chosen(2.0, 1.0) == -1.0
"""


def small(folder: Path) -> tuple[list[mutants.Mutant], Path]:
    """The mutants of a file of two functions, and the library that has them all."""
    need(shutil.which("cc"), "a C compiler")
    source = folder / "small.c"
    source.write_text(SMALL)
    found = mutants.written([source], folder / "out")
    library = folder / "harness" / "zygos" / "_native" / "small.so"
    library.parent.mkdir(parents=True)
    compiler = ["cc", "-std=c11", "-w", "-O1", "-shared", "-fPIC", *map(str, (folder / "out").glob("*.c"))]
    subprocess.run([*compiler, "-o", str(library)], check=True)
    return found, library


def test_every_mutant_is_in_one_library_and_the_number_selects_it(tmp_path: Path) -> None:
    found, path = small(tmp_path)
    ffi = FFI()
    ffi.cdef("uint32_t sum(uint32_t *x, uint32_t n); double chosen(double a, double b); extern int zygos_mutant;")
    lib: Any = ffi.dlopen(str(path))

    def with_mutant(original: str, changed: str) -> tuple[int, float, float]:
        numbers = [k for k, one in enumerate(found) if (one.original, one.changed) == (original, changed)]
        lib.zygos_mutant = numbers[0] if original else -1
        return lib.sum([1, 2, 3], 2), lib.chosen(2.0, 1.0), lib.chosen(1.0, 2.0)

    assert with_mutant("", "") == (3, -1.0, -1.0)
    assert with_mutant("i < n", "i <= n") == (6, -1.0, -1.0)
    assert with_mutant("total += x[i]", mutants.NOTHING) == (0, -1.0, -1.0)
    assert with_mutant("one.second > b", "0") == (3, -2.0, -1.0)
    assert with_mutant("one.second > b", "1") == (3, -1.0, -2.0)
    assert with_mutant("-one.second", "one.second") == (3, 1.0, 1.0)
    assert not any("{" in one.original or one.original in ("3", "5") for one in found), (
        "a table is no code of a function"
    )


def test_the_parser_reads_the_public_header() -> None:
    need(shutil.which("cc"), "a C compiler")
    path = ROOT / "c" / "loop" / "attach.c"
    functions = [node.decl.name for node in mutants.parsed(path).ext if type(node).__name__ == "FuncDef"]
    assert functions[-1] == "zygos_refine"


def test_a_mutant_is_named_by_its_function_and_not_by_its_line(tmp_path: Path) -> None:
    source = tmp_path / "small.c"
    source.write_text(SMALL)
    before = mutants.written([source], tmp_path / "a")
    source.write_text("\n\n" + SMALL)
    after = mutants.written([source], tmp_path / "b")
    assert [one.key for one in before] == [one.key for one in after]
    assert len({one.key for one in before}) == len(before)
    assert before[0].line + 2 == after[0].line


@pytest.mark.slow
def test_the_tests_of_the_library_reach_and_kill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, path = small(tmp_path)
    tests = tmp_path / "test_small.py"
    tests.write_text(TESTS)
    monkeypatch.setenv("SMALL", str(path))
    results = tmp_path / "results.jsonl"
    wanted = {
        ("i < n", "i <= n"): "killed",
        ("i++", "i--"): "crash",  # reads far beyond the array
        ("one.second > b", "one.second >= b"): "survived",
        ("one.second > b", "1"): "survived",
        ("one.second = b", mutants.NOTHING): "killed",
    }
    numbers = [k for k, one in enumerate(found) if (one.original, one.changed) in wanted]
    outcomes = mutation.run([str(tests)], found, numbers, 2, tmp_path / "run", results, path)
    verdicts = {(one.mutant.original, one.mutant.changed): one.verdict for one in outcomes}
    assert {key: verdicts[key] for key in wanted if key[0] != "i++"} == {
        k: v for k, v in wanted.items() if k[0] != "i++"
    }
    assert next(one for one in outcomes if one.mutant.changed == "i <= n").test.endswith("::test_sum")
    lines = results.read_text()
    again = mutation.run([str(tests)], found, numbers[:2], 2, tmp_path / "run", results, path)
    assert results.read_text() == lines, "what was tried is tried again"
    assert [one.verdict for one in again] == [one.verdict for one in outcomes[:2]]
    other = tmp_path / "test_other.py"
    other.write_text(TESTS.replace("2.0, 1.0) == -1.0", "1.0, 2.0) == -1.0").replace("def test_", "def test_other_"))
    more = mutation.run([str(tests), str(other)], found, numbers, 2, tmp_path / "run", results, path)
    verdicts = {(one.mutant.original, one.mutant.changed): one.verdict for one in more}
    assert verdicts["one.second > b", "1"] == "killed", "a survivor is not tried with the test that was added"
    assert verdicts["one.second > b", "one.second >= b"] == "survived"
    tried = [json.loads(line)["number"] for line in results.read_text().removeprefix(lines).splitlines()]
    assert {found[number].original for number in tried} == {"one.second > b"}, "a kill is tried again"
    tests.write_text(TESTS + "    assert lib.sum([1], 1) == 2\n")
    with pytest.raises(ZygosError, match=r"do not pass with unchanged code: .*test_chosen"):
        mutation.run([str(tests)], found, numbers, 2, tmp_path / "run", tmp_path / "other.jsonl", path)


def outcome(changed: str, verdict: str) -> mutation.Outcome:
    return mutation.Outcome(mutants.Mutant("gram.c", "f", 1, "a + b", changed, 0), verdict, "")


def test_the_score_leaves_out_equivalent_mutants_and_asks_for_judgements() -> None:
    outcomes = [outcome(str(k), "killed") for k in range(17)] + [outcome("a", "survived"), outcome("b", "not reached")]
    keys = [one.mutant.key for one in outcomes[-2:]]
    assert mutation.assessed(outcomes, dict.fromkeys(keys, mutation.ACCEPTED)).verdict == PASSED
    found = mutation.assessed(outcomes, {keys[0]: mutation.EQUIVALENT})
    assert found.verdict == FAILED
    assert found.figures is not None and found.figures["score"] == round(17 / 18, 4)
    assert found.findings[0] == "not judged: gram.c: f: a + b -> b (0) (line 1)"
    few = mutation.assessed(outcomes[12:], dict.fromkeys(keys, mutation.LACKING))
    assert few.verdict == FAILED and "kill 71.4% of the mutants" in few.findings[0]
    assert mutation.assessed([*outcomes[:17], outcome("c", "timeout")], {}).verdict == PASSED


def test_a_judgement_is_written_in_the_page_and_stays_with_its_mutant(tmp_path: Path) -> None:
    page = tmp_path / "mutants.md"
    assert mutation.judgements(page) == {}
    first, again = (mutants.Mutant("gram.c", "f", 1, "a || b", "a && b", k) for k in (0, 2))
    page.write_text(mutation.text_of_page("some", [first, again], {}))
    assert mutation.judgements(page) == {}
    judged = page.read_text().replace("`a && b` |  |  |", "`a && b` | equivalent | b follows from a |")
    page.write_text(judged)
    assert mutation.judgements(page) == {first.key: ("equivalent", "b follows from a")}
    page.write_text(mutation.text_of_page("others", [again, first], mutation.judgements(page)))
    assert mutation.judgements(page) == {first.key: ("equivalent", "b follows from a")}
    page.write_text(judged.replace("`a && b` #2 |  |  |", "`a && b` #2 | accepted | rounding |"))
    assert mutation.judgements(page)[again.key] == ("accepted", "rounding")
    for wrong in ("| fine | b follows from a |", "| equivalent |  |"):
        page.write_text(judged.replace("| equivalent | b follows from a |", wrong))
        with pytest.raises(ZygosError, match=r"no judgement '.*' with a reason; remedy: use equivalent"):
            mutation.judgements(page)


def test_a_larger_sample_begins_with_the_smaller_one() -> None:
    assert mutation.sample(1000, 50, 0) == mutation.sample(1000, 90, 0)[:50]
    assert mutation.sample(1000, 50, 0) != mutation.sample(1000, 50, 1)
    assert sorted(mutation.sample(1000, 0, 0)) == list(range(1000))


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_a_warning_fails(compiler: str, tmp_path: Path) -> None:
    need(shutil.which(compiler), compiler)
    bad = tmp_path / "bad.c"
    bad.write_text("#include <stdint.h>\nuint8_t f(uint32_t x);\nuint8_t f(uint32_t x)\n{\n    return x;\n}\n")
    found = analysis.warnings(compiler, [bad])
    assert found.verdict == FAILED
    assert "bad.c:5" in found.findings[0]
    bad.write_text(bad.read_text().replace("return x", "return (uint8_t)x"))
    assert analysis.warnings(compiler, [bad]).verdict == PASSED


def test_a_rule_without_a_reason_fails_and_a_reason_without_a_breach(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    need(shutil.which("cppcheck"), "cppcheck")
    bad, deviations = tmp_path / "bad.c", tmp_path / "misra.txt"
    bad.write_text("static int f(int x)\n{\n    int y = x * 2 + 1;\n    goto end;\nend:\n    return y;\n}\n")
    deviations.write_text("# none\n12.1 Only products are not in brackets.\n9.9 There is no such rule.\n")
    monkeypatch.setattr(analysis, "sources", lambda: [bad])
    found = analysis.misra(deviations=deviations)
    assert found.verdict == FAILED
    assert found.findings == ("bad.c:4: rule 15.1", "misra.txt: nothing breaks rule 9.9; remedy: remove it")


def test_an_entry_accepts_one_finding_of_its_check_in_its_file(tmp_path: Path) -> None:
    entry = '[[entry]]\ncheck = "zero"\nfile = "small.c"\nreason = "n is checked"\n'
    accepted = tmp_path / "accepted.toml"
    accepted.write_text(entry)
    text = "src/small.c:2:9: warning: Division by zero [zero,other]\n"
    assert analysis.left(analysis.found_in(text), accepted) == []
    second = text + text.replace(":2:", ":7:")
    assert analysis.left(analysis.found_in(second), accepted) == ["small.c:7: Division by zero [zero,other]"]
    assert len(analysis.left(analysis.found_in(text.replace("small", "large")), accepted)) == 1
    accepted.write_text(2 * entry)
    assert analysis.left(analysis.found_in(second), accepted) == []
    accepted.write_text(entry.replace('reason = "n is checked"\n', ""))
    with pytest.raises(ZygosError, match="has no 'reason'"):
        analysis.left([], accepted)


def test_a_missing_tool_is_not_evaluated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    given = command.DEFAULTS
    for step in (
        "gcc",
        "clang",
        "clang-tidy",
        "cppcheck",
        "misra",
        "coverage",
        "fuzzing",
        "limits-x86-64",
        "limits-m7",
    ):
        found = command.STEPS[step](given)
        assert found.verdict == MISSING, step
        assert "not installed; remedy: apt install" in found.findings[0]


def test_the_end_says_what_failed_and_what_was_not_evaluated() -> None:
    def content(**verdicts: str) -> dict[str, Any]:
        steps = {step: PASSED for step in command.STEPS} | {k.replace("_", "-"): v for k, v in verdicts.items()}
        return {step: {"verdict": verdict} for step, verdict in steps.items()}

    every = list(command.STEPS)
    assert command.ending(content(), every) == (0, "verify: 10 steps passed")
    status, text = command.ending(content(clang_tidy=MISSING), every)
    assert (status, text) == (3, "verify: 9 steps passed; 1 not evaluated: clang-tidy")
    status, text = command.ending(content(clang_tidy=MISSING, fuzzing=FAILED), every)
    assert status == 1 and text.endswith("1 failed: fuzzing; 1 not evaluated: clang-tidy")
    assert command.ending(content(fuzzing=FAILED), ["gcc", "clang"])[0] == 0
    assert command.ending({}, every)[0] == 3


def test_the_page_says_of_which_commit_a_result_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, file = tmp_path / "verification.md", tmp_path / "verification.json"
    page.write_text(f"above\n{command.BEGIN}{command.END}below\n")
    monkeypatch.setattr(command, "PAGE", page)
    monkeypatch.setattr(command, "FILE", file)
    monkeypatch.setitem(command.STEPS, "gcc", lambda _: Result(PASSED, "no warning"))
    monkeypatch.setitem(command.STEPS, "clang", lambda _: Result(MISSING, "no clang", ("remedy: install it",)))
    assert command.main("gcc", "clang") == 3
    text = page.read_text()
    assert f"| `gcc` | warnings of gcc | passed | no warning | {measured_commit(ROOT)} |" in text
    assert "| `clang` | warnings of clang | **not evaluated** | no clang | " in text
    assert "- remedy: install it" in text
    assert "| `fuzzing` | fuzzing | **not evaluated** | it was never run |" in text
    assert json.loads(file.read_text())["gcc"]["commit"] == measured_commit(ROOT)
    with pytest.raises(ZygosError, match="no step or option 'lint'; remedy: steps gcc"):
        command.main("lint")


def report(**rows: Any) -> dict[str, Any]:
    line = {"line_number": 2, "count": 1, "function_name": "caller", "branches": [], **rows}
    return {"files": [{"file": "small.c", "lines": [line]}]}


def test_coverage_below_a_floor_fails(tmp_path: Path) -> None:
    (tmp_path / "small.c").write_text("int f(void)\n    if (a || b) {\n    g(a);\n")
    branches = [{"count": 4}, {"count": 0}, {"count": 2}, {"count": 2}]
    gaps, totals = coverage.gaps_of(report(branches=branches), tmp_path)
    assert totals == {"lines": 1, "lines run": 1, "branches": 4, "branches taken": 3}
    assert list(map(str, gaps)) == ["small.c:2: f: 1 of 4 branches: if (a || b) {"]
    missed, _ = coverage.gaps_of(report(count=0), tmp_path)
    assert missed[0].what == "line"
    assert coverage.gaps_of(report(), tmp_path)[0] == []
    assert coverage.below(totals, {"fail-under-line": "99", "fail-under-branch": "75"}) == []
    (found,) = coverage.below(totals, {"fail-under-line": "99", "fail-under-branch": "76"})
    assert "75.0% are run, and fail-under-branch is 76; remedy: test those of build/verify/gaps.txt" in found


def test_two_per_cent_above_a_limit_fail() -> None:
    known = {"bytes of code": 1000.0, "stack": 200.0}
    assert limits.exceeded({"bytes of code": 1020, "stack": 100}, known) == []
    found = limits.exceeded({"bytes of code": 1021, "stack": 200}, known)
    assert len(found) == 1 and "bytes of code: 1,021 is +2.1% of its limit 1,000.0; remedy" in found[0]
    assert "has no limit" in limits.exceeded({**known, "more": 1}, known)[0]
    assert "stack: not measured" in limits.exceeded({"bytes of code": 1000}, known)[0]


def test_every_public_call_has_a_limit() -> None:
    stored = json.loads(limits.LIMITS.read_text())
    assert set(stored) == set(limits.COUNTED)
    for target, known in stored.items():
        for call in (
            "zygos_init",
            "zygos_frame",
            "zygos_step",
            "zygos_solve",
            "zygos_restart",
            "zygos_seal",
            "zygos_resume",
        ):
            assert call in limits.public()
            assert f"bytes of stack below {call}(): paper" in known, target


def test_a_crash_of_the_guided_fuzzer_is_told(tmp_path: Path) -> None:
    program = tmp_path / "fuzz"
    program.write_text(
        "#!/bin/sh\necho '==1==ERROR: AddressSanitizer: stack-buffer-overflow' >&2\n"
        "echo 'artifact; Test unit written to /tmp/crash-1' >&2\nexit 77\n"
    )
    program.chmod(0o755)
    _, found = fuzzing.bytes_for(program, 1.0, tmp_path)
    assert found == [
        "guided bytes: ERROR: AddressSanitizer: stack-buffer-overflow; the input is /tmp/crash-1",
    ]
    program.write_text("#!/bin/sh\necho 'stat::number_of_executed_units: 12' >&2\n")
    assert fuzzing.bytes_for(program, 1.0, tmp_path) == (12, [])


def test_a_driver_that_fails_is_told_with_its_seed(tmp_path: Path) -> None:
    bad = fuzzing.first_seed() + 2
    program = tmp_path / "driver"
    program.write_text(f"#!/bin/sh\ntest $1 -lt {bad} || {{ echo 'changed what it must not'; exit 1; }}\n")
    program.chmod(0o755)
    seeds, found = fuzzing.seeds_for("fuzz_frames", lambda: program, (2,), 20.0)
    assert seeds == 3
    assert found == [f"fuzz_frames with seed {bad} ends with status 1: changed what it must not"]


@pytest.mark.slow
def test_the_guided_fuzzer_runs(tmp_path: Path) -> None:
    need(shutil.which("clang"), "clang: the guided fuzzer stays untried")
    program = fuzzing.guided(tmp_path)
    need(program, "libFuzzer")
    assert program is not None
    tried, found = fuzzing.bytes_for(program, 2.0, tmp_path)
    assert tried > 0 and found == []
