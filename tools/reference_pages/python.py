# SPDX-License-Identifier: MIT
"""The page of the Python interface: signatures and docstrings of everything that `import zygos` offers."""

import ast
import inspect
from functools import cache
from pathlib import Path
from typing import Any

import zygos
from reference_pages.markdown import page, table


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _node(thing: Any) -> ast.ClassDef | ast.FunctionDef:
    """Where the function or class is written, as its module has it."""
    path = Path(inspect.getfile(thing))
    for node in _tree(path).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == thing.__name__:
            return node
    raise ValueError(f"{path}: {thing.__name__} not found; remedy: write it at the top level of its module")


def _text(words: str) -> str:
    """A docstring as Markdown: what looks like an element of HTML is shown."""
    return inspect.cleandoc(words).replace("<", "\\<")


def _first(words: str) -> str:
    return " ".join(_text(words).partition("\n\n")[0].split())


def _signature(name: str, node: ast.FunctionDef) -> str:
    """The call with types and defaults, without self."""
    arguments = node.args
    if arguments.args and arguments.args[0].arg in {"self", "cls"}:
        arguments = ast.arguments(
            posonlyargs=arguments.posonlyargs, args=arguments.args[1:], vararg=arguments.vararg,
            kwonlyargs=arguments.kwonlyargs, kw_defaults=arguments.kw_defaults, kwarg=arguments.kwarg,
            defaults=arguments.defaults,
        )  # fmt: skip
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"{name}({ast.unparse(arguments)}){returns}"


def _members(node: ast.ClassDef) -> list[tuple[str, str]]:
    """The documented attributes and methods of a class, with the first paragraph of their docstrings."""
    found = []
    for place, child in enumerate(node.body):
        behind = node.body[place + 1] if place + 1 < len(node.body) else None
        if isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
            said = behind.value if isinstance(behind, ast.Expr) else None
            words = said.value if isinstance(said, ast.Constant) and isinstance(said.value, str) else ""
            found.append((child.target.id, words, f"{child.target.id}: {ast.unparse(child.annotation)}"))
        elif isinstance(child, ast.FunctionDef):
            words, called = ast.get_docstring(child) or "", _signature(child.name, child)
            decorated = {getattr(one, "id", "") for one in child.decorator_list}
            if decorated & {"property", "cached_property"} and child.returns:
                called = f"{child.name}: {ast.unparse(child.returns)}"
            if child.name == "__getitem__" and child.returns:
                called = f"[{child.args.args[1].arg}]: {ast.unparse(child.returns)}"
            found.append((child.name, words, called))
    return [
        (f"`{called}`", _first(words))
        for name, words, called in found
        if words and not (name.startswith("_") and called.startswith("_"))
    ]


def _described(name: str) -> list[str]:
    """The parts of the page that describe one name."""
    thing = getattr(zygos, name)
    node = _node(thing)
    if isinstance(node, ast.FunctionDef):
        return [f"## Function `{name}`", f"```python\n{_signature(name, node)}\n```", _text(thing.__doc__)]
    homes = [one for one in thing.__mro__ if one.__module__.startswith("zygos")]
    members = [member for one in homes for member in _members(_node(one))]
    return [f"## Class `{name}`", _text(thing.__doc__), *([table(("Member", "Meaning"), members)] if members else [])]


def python_page() -> str:
    """The page of the Python interface."""
    names = [name for name in zygos.__all__ if name != "__version__"]
    functions = [name for name in names if not inspect.isclass(getattr(zygos, name))]
    classes = [name for name in names if name not in functions]
    lists = []
    for kind, of in (("Function", functions), ("Class", classes)):
        said = [(f"[`{one}`](#{kind.lower()}-{one.lower()})", _first(getattr(zygos, one).__doc__)) for one in of]
        lists.append(table((kind, "Meaning"), said))
    return page(
        "Python",
        "Everything that `import zygos` offers; [the manual](../python.md) has an example of each. Quantities are in "
        "SI units, and arrays are numpy's. `zygos.__version__` is the version. What is not listed here may change "
        "without notice.",
        *lists,
        *(part for name in (*functions, *classes) for part in _described(name)),
    )
