# SPDX-License-Identifier: MIT
"""Mutants of the C library: small changes of its source, all compiled into one library and selected by a number.

Each changed expression becomes `zygos_mutant_is(K) ? changed : original`, each statement that can be left out becomes
`if (!zygos_mutant_is(K)) statement`. The parser is pycparser, which cffi brings along.
"""

from __future__ import annotations

import copy
import hashlib
import json
import re
import shlex
import subprocess
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pycparser import c_ast
from pycparser.c_generator import CGenerator
from pycparser.c_parser import CParser

from conftest import ROOT, tool_module
from zygos.errors import ZygosError

HEADERS = Path(__file__).with_name("headers")
SWAPS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=",
    "!=": "==", "&&": "||", "||": "&&", "&": "|", "|": "&", "^": "&", "<<": ">>", ">>": "<<", "+=": "-=", "-=": "+=",
    "*=": "/=", "/=": "*=", "|=": "&=", "&=": "|=", "^=": "|=", "<<=": ">>=", ">>=": "<<=", "%=": "*=",
}  # fmt: skip
"""An operator, and what takes its place."""
DROPPED = ("-", "!", "~")
"""Unary operators that are left out."""
SELECTED = """
extern int zygos_mutant;
extern unsigned char zygos_reached[];
static inline int zygos_mutant_is(int number)
{
    zygos_reached[number] = 1;
    return __builtin_expect(zygos_mutant == number, 0);
}
#define offsetof __builtin_offsetof
"""
"""What each generated file begins with."""
NOTHING = "left out"


@dataclass(frozen=True)
class Mutant:
    """One change of the source."""

    file: str
    """Of c/, with its suffix."""
    function: str
    line: int
    original: str
    """Expression or statement, as the generator prints it."""
    changed: str
    again: int
    """How often the function has the same change before this one."""

    @property
    def key(self) -> str:
        """What names a mutant as long as its function has the change, wherever its lines are."""
        return f"{self.file}: {self.function}: {self.original} -> {self.changed} ({self.again})"


def _constant(node: c_ast.Constant) -> str | None:
    """Another constant of the same type; None for text."""
    if node.type in ("string", "char"):
        return None
    if "float" in node.type or "double" in node.type:
        return "1.0" if float(node.value.rstrip("fFlL")) == 0.0 else f"2.0 * {node.value}"
    digits, suffix = re.fullmatch(r"(0[xX][0-9a-fA-F]+|\d+)([uUlL]*)", node.value).groups()  # type: ignore[union-attr]
    value = int(digits, 0)
    return f"{ {0: 1, 1: 0}.get(value, value + 1) }{suffix}"


class Writer:
    """Rewrites the functions of one file."""

    def __init__(self, file: str, first: int, skipped: frozenset[str]) -> None:
        self.file, self.first, self.skipped = file, first, skipped
        self.mutants: list[Mutant] = []
        self.function = ""
        self.seen: Counter[tuple[str, str]] = Counter()
        self.printer = CGenerator()

    def _add(self, node: c_ast.Node, changed: str) -> c_ast.Node | None:
        """Note a mutant. Returns the expression that asks for it; None where it is one that does not compile."""
        original = self.printer.visit(node)
        again = self.seen[original, changed]
        self.seen[original, changed] += 1
        line = node.coord.line if node.coord else 0
        mutant = Mutant(self.file, self.function, line, original, changed, again)
        if mutant.key in self.skipped:
            return None
        self.mutants.append(mutant)
        number = c_ast.Constant("int", str(self.first + len(self.mutants) - 1))
        return c_ast.FuncCall(c_ast.ID("zygos_mutant_is"), c_ast.ExprList([number]))

    def _changes(self, node: c_ast.Node) -> Iterable[c_ast.Node]:
        """Other expressions in place of this one."""
        if isinstance(node, c_ast.BinaryOp | c_ast.Assignment) and node.op in SWAPS:
            other = copy.deepcopy(node)
            other.op = SWAPS[node.op]
            yield other
        elif isinstance(node, c_ast.UnaryOp) and node.op in DROPPED:
            yield copy.deepcopy(node.expr)
        elif isinstance(node, c_ast.UnaryOp) and node.op in ("++", "p++", "--", "p--"):
            other = copy.deepcopy(node)
            other.op = node.op.replace("++", "--") if "++" in node.op else node.op.replace("--", "++")
            yield other
        elif isinstance(node, c_ast.Constant):
            value = _constant(node)
            if value is not None:
                yield c_ast.Constant(node.type, f"({value})")

    def expression(self, node: Any, condition: tuple[str, ...] = ()) -> Any:
        """An expression of which a value is taken. condition: constants that may take its place, too."""
        if node is None:
            return None
        changed = list(self._changes(node)) + [c_ast.Constant("int", value) for value in condition]
        asked = [(self._add(node, self.printer.visit(other)), other) for other in changed]
        out = self._inside(node)
        for question, other in asked:
            if question is not None:
                out = c_ast.TernaryOp(question, other, out)
        return out

    def _inside(self, node: Any) -> Any:
        """The same expression with mutants in its parts."""
        out = copy.copy(node)
        if isinstance(node, c_ast.BinaryOp):
            out.left, out.right = self.expression(node.left), self.expression(node.right)
        elif isinstance(node, c_ast.Assignment):
            out.lvalue, out.rvalue = self.place(node.lvalue), self.expression(node.rvalue)
        elif isinstance(node, c_ast.UnaryOp):
            if node.op in ("sizeof", "_Alignof"):
                return node
            out.expr = (
                self.place(node.expr) if node.op in ("&", "++", "--", "p++", "p--") else self.expression(node.expr)
            )
        elif isinstance(node, c_ast.TernaryOp):
            out.cond = self.expression(node.cond, ("0", "1"))
            out.iftrue, out.iffalse = self.expression(node.iftrue), self.expression(node.iffalse)
        elif isinstance(node, c_ast.Cast):
            out.expr = self.expression(node.expr)
        elif isinstance(node, c_ast.FuncCall):
            plain = (
                isinstance(node.name, c_ast.ID) and not node.name.name.startswith("__") and node.name.name != "offsetof"
            )
            if node.args is not None and (
                plain or getattr(node.name, "name", "") in ("__builtin_sqrt", "__builtin_fabs")
            ):
                out.args = c_ast.ExprList([self.expression(one) for one in node.args.exprs])
        elif isinstance(node, c_ast.ArrayRef | c_ast.StructRef):
            return self.place(node)
        elif isinstance(node, c_ast.CompoundLiteral):
            out.init = self.initial(node.init)
        elif isinstance(node, c_ast.ExprList):
            out.exprs = [self.expression(one) for one in node.exprs]
        return out

    def place(self, node: Any) -> Any:
        """An expression that names a place in memory."""
        out = copy.copy(node)
        if isinstance(node, c_ast.ArrayRef):
            out.name, out.subscript = self.place(node.name), self.expression(node.subscript)
        elif isinstance(node, c_ast.StructRef):
            out.name = self.place(node.name)
        elif isinstance(node, c_ast.UnaryOp) and node.op == "*":
            out.expr = self._inside(node.expr) if isinstance(node.expr, c_ast.UnaryOp) else self.expression(node.expr)
        elif isinstance(node, c_ast.FuncCall | c_ast.BinaryOp | c_ast.CompoundLiteral | c_ast.Cast):
            return self._inside(node)
        return out

    def initial(self, node: Any) -> Any:
        """What a variable is initialised with."""
        out = copy.copy(node)
        if isinstance(node, c_ast.InitList):
            out.exprs = [self.initial(one) for one in node.exprs]
        elif isinstance(node, c_ast.NamedInitializer):
            out.expr = self.initial(node.expr)
        else:
            return self.expression(node)
        return out

    def statement(self, node: Any) -> Any:
        """A statement or a declaration."""
        out = copy.copy(node)
        if isinstance(node, c_ast.Compound):
            out.block_items = [self.statement(one) for one in node.block_items or []]
        elif isinstance(node, c_ast.Decl):
            if node.init is not None and "static" not in node.storage:
                out.init = self.initial(node.init)
        elif isinstance(node, c_ast.DeclList):
            out.decls = [self.statement(one) for one in node.decls]
        elif isinstance(node, c_ast.If):
            out.cond = self.expression(node.cond, ("0", "1"))
            out.iftrue, out.iffalse = self.statement(node.iftrue), self.statement(node.iffalse)
        elif isinstance(node, c_ast.While | c_ast.DoWhile):
            out.cond, out.stmt = self.expression(node.cond, ("0",)), self.statement(node.stmt)
        elif isinstance(node, c_ast.For):
            out.init = (
                self.statement(node.init) if isinstance(node.init, c_ast.DeclList) else self.expression(node.init)
            )
            out.cond, out.next = self.expression(node.cond, ("0",)), self.expression(node.next)
            out.stmt = self.statement(node.stmt)
        elif isinstance(node, c_ast.Switch):
            out.cond, out.stmt = self.expression(node.cond), self.statement(node.stmt)
        elif isinstance(node, c_ast.Case | c_ast.Default):
            out.stmts = [self.statement(one) for one in node.stmts]
        elif isinstance(node, c_ast.Return):
            out.expr = self.expression(node.expr)
        elif isinstance(node, c_ast.Label):
            out.stmt = self.statement(node.stmt)
        elif isinstance(node, c_ast.Assignment | c_ast.FuncCall | c_ast.UnaryOp | c_ast.Break | c_ast.Continue):
            question = self._add(node, NOTHING)
            if not isinstance(node, c_ast.Break | c_ast.Continue):
                out = self.expression(node)
            if question is not None:
                out = c_ast.If(c_ast.UnaryOp("!", question), c_ast.Compound([out]), None)
        return out

    def file_of(self, tree: c_ast.FileAST, path: Path) -> str:
        """The text of the file with all mutants of its functions."""
        for place, node in enumerate(tree.ext):
            if isinstance(node, c_ast.FuncDef) and node.coord and Path(node.coord.file).name == path.name:
                self.function = node.decl.name
                self.seen.clear()
                out = copy.copy(node)
                out.body = self.statement(node.body)
                tree.ext[place] = out
        return SELECTED + self.printer.visit(tree)


def parsed(path: Path, defines: Sequence[str] = ()) -> c_ast.FileAST:
    """The syntax of a C file. Errors: ZygosError where it has an extension that the parser does not know."""
    command = [
        "cc",
        "-E",
        "-std=c11",
        "-nostdinc",
        "-D__attribute__(x)=",
        f"-I{HEADERS}",
        f"-I{ROOT / 'include'}",
        *defines,
    ]
    text = subprocess.run([*command, str(path)], capture_output=True, text=True, check=True).stdout
    text = re.sub(r"^#pragma.*$", "", text, flags=re.M)
    try:
        return CParser().parse(text, str(path))
    except Exception as error:
        raise ZygosError(
            f"{path.name} has C that pycparser does not read ({error}); remedy: write it without an extension, or "
            f"teach tests/verify/mutants.py to leave it out"
        ) from error


def written(paths: Iterable[Path], folder: Path, skipped: frozenset[str] = frozenset()) -> list[Mutant]:
    """Write the files with their mutants into a folder. Returns the mutants; the number of one is its index."""
    mutants: list[Mutant] = []
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        writer = Writer(path.name, len(mutants), skipped)
        (folder / path.name).write_text(writer.file_of(parsed(path), path))
        mutants += writer.mutants
    (folder / "selected.c").write_text(
        f"int zygos_mutant = -1;\nunsigned char zygos_reached[{len(mutants)}];\n"
        f"unsigned zygos_mutants = {len(mutants)};\n"
    )
    return mutants


def _refused(text: str, source: Path) -> set[int]:
    """Numbers of the mutants that the errors of a compiler are about."""
    lines = source.read_text().splitlines()
    found = set()
    for line, column in re.findall(rf"{re.escape(str(source))}:(\d+):(\d+): error", text):
        numbers = list(re.finditer(r"zygos_mutant_is\((\d+)\)", lines[int(line) - 1]))
        before = [int(one[1]) for one in numbers if one.start() < int(column)]
        if before:
            found.add(before[-1])
    return found


def _state(paths: Iterable[Path]) -> str:
    """Digest of what the mutants are made of."""
    total = hashlib.sha256(Path(__file__).read_bytes())
    for path in [*paths, *sorted((ROOT / "include" / "zygos").rglob("*.h")), *sorted(HEADERS.iterdir())]:
        total.update(path.read_bytes())
    return total.hexdigest()


def library(folder: Path, jobs: int) -> list[Mutant]:
    """Compile all mutants of c/ into folder/libzygos.so, with what the binding needs beside it.

    A change that does not compile, a sum of two pointers for example, is no mutant. Errors: ZygosError where the
    unchanged code does not compile.
    """
    build = tool_module("build_native")
    paths = sorted((ROOT / "c").glob("*/*.c"))
    skipped: frozenset[str] = frozenset()
    compiler = shlex.split("cc -std=c11 -O1 -w -fPIC -ffp-contract=off -fno-math-errno -c")
    sources, objects = folder / "source", folder / "objects"
    objects.mkdir(parents=True, exist_ok=True)
    built, state = folder / "built.json", _state(paths)
    if built.exists() and (known := json.loads(built.read_text()))["state"] == state:
        return written(paths, sources, frozenset(known["skipped"]))
    for _ in range(8):
        mutants = written(paths, sources, skipped)
        numbers: set[int] = set()

        def compiled(source: Path) -> tuple[Path, subprocess.CompletedProcess[str]]:
            command = [*compiler, str(source), "-o", str(objects / f"{source.stem}.o")]
            return source, subprocess.run(command, capture_output=True, text=True, check=False)

        with ThreadPoolExecutor(jobs) as pool:
            for source, done in pool.map(compiled, sorted(sources.glob("*.c"))):
                if done.returncode != 0:
                    refused = _refused(done.stderr, source)
                    if not refused:
                        raise ZygosError(f"{source} does not compile: {done.stderr[:500]}; remedy: see there")
                    numbers |= refused
        if not numbers:
            break
        skipped |= {mutants[number].key for number in numbers}
    else:
        raise ZygosError("the mutants do not compile; remedy: leave out what the compiler refuses")
    package = folder / "harness" / "zygos"
    native = package / "_native"
    native.mkdir(parents=True, exist_ok=True)
    for path in (ROOT / "harness" / "zygos").iterdir():
        link = package / path.name
        if path.name != "_native" and not link.is_symlink():
            link.symlink_to(path)
    build.main(native)  # what stands beside the library
    digest = build.digest_of(build.declarations())
    command = [
        *shlex.split("cc -shared"),
        *build.FLAGS.split(),
        f"-DZYGOS_DECLARATIONS_DIGEST={digest}u",
        *build.INCLUDES,
    ]
    command += [*map(str, sorted(objects.glob("*.o"))), *map(str, sorted(build.HOST.glob("*.c")))]
    subprocess.run([*command, "-o", str(native / "libzygos.so")], check=True)
    built.write_text(json.dumps({"state": state, "skipped": sorted(skipped)}))
    return mutants
