# SPDX-License-Identifier: MIT
"""How deep the stack of the flight library is: its call graph, as GCC tells it."""

from __future__ import annotations

import re
from pathlib import Path


class Calls:
    """Call graph of the whole library, from GCC's -fcallgraph-info=su."""

    def __init__(self, folder: Path) -> None:
        self.frame: dict[str, int] = {}
        self.bounded: dict[str, bool] = {}
        self.calls: dict[str, set[str]] = {}
        for graph in sorted(folder.rglob("*.ci")):
            text = graph.read_text()
            for title, label in re.findall(r'node: \{ title: "([^"]*)" label: "([^"]*)"', text):
                size = re.search(r"(\d+) bytes \(([^)]*)\)", label)
                if size:
                    self.frame[title] = int(size[1])
                    self.bounded[title] = size[2] == "static"
                self.calls.setdefault(title, set())
            for source, target in re.findall(r'edge: \{ sourcename: "([^"]*)" targetname: "([^"]*)"', text):
                self.calls.setdefault(source, set()).add(target)

    def depth(self, name: str, above: tuple[str, ...] = ()) -> int:
        """Bytes of stack below and including a function. Fails on recursion."""
        assert name not in above, f"recursion: {' -> '.join([*above, name])}"
        return self.frame.get(name, 0) + max((self.depth(x, (*above, name)) for x in self.calls[name]), default=0)
