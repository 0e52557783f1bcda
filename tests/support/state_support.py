# SPDX-License-Identifier: MIT
"""Members of the library's structs by size and role: where they lie is what the compiler says, whatever their names.

Tests of upsets choose their places here. A name is for messages only: no test may know that of a private member.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.native.flight import Flight, ffi, lib

SUMS = 8
"""From so many doubles on that are not zero, an array is one of sums, or of rows that wait."""
BESIDE_GROUPS = ("joints.count", "joints.fade")
"""Of each group of joint rows, in arrays of their own."""


@dataclass(frozen=True)
class Leaf:
    """A number of a struct, or an array of numbers."""

    path: str
    offset: int
    kind: str
    """C type of an element."""
    count: int

    @property
    def size(self) -> int:
        """Bytes of an element."""
        return int(ffi.sizeof(self.kind))

    @property
    def member(self) -> str:
        """The path without indices: one for all elements of an array of structs."""
        return re.sub(r"\[\d+\]", "", self.path)

    @property
    def dtype(self) -> str:
        """Of numpy, for an element."""
        return f"{'f' if self.kind == 'double' else 'u'}{self.size}"


@dataclass(frozen=True)
class Place:
    """An element of a leaf."""

    leaf: Leaf
    index: int

    def flip(self, native: Any, bit: int) -> None:
        """Change one bit of it in a struct."""
        at = self.leaf.offset + self.index * self.leaf.size + bit // 8
        memory = ffi.cast("unsigned char *", native)
        memory[at] ^= 1 << bit % 8

    def values(self, native: Any) -> NDArray[Any]:
        """(1,) a view of it, through which it may be changed."""
        first = self.leaf.offset + self.index * self.leaf.size
        view: NDArray[Any] = np.frombuffer(ffi.buffer(native), self.leaf.dtype, 1, first)
        return view

    def bits(self, rng: np.random.Generator, count: int) -> list[int]:
        """Some of its bits: of a double those from a relative change of 1e-7 on, of which the highest always."""
        last = 8 * self.leaf.size
        first = 29 if self.leaf.kind == "double" else 0
        return [last - 2, *rng.integers(first, last, size=count - 1).tolist()]

    def __str__(self) -> str:
        return f"{self.leaf.path}, element {self.index}"


def leaves(kind: Any, path: str = "", offset: int = 0, sizeof: Callable[[Any], int] = ffi.sizeof) -> Iterator[Leaf]:
    """All numbers of a type of cffi, in the order of their places. sizeof: that of its build."""
    if kind.kind == "struct":
        for name, field in kind.fields:
            yield from leaves(field.type, f"{path}.{name}" if path else name, offset + field.offset, sizeof)
    elif kind.kind == "array" and kind.item.kind != "primitive":
        for k in range(kind.length):
            yield from leaves(kind.item, f"{path}[{k}]", offset + k * sizeof(kind.item), sizeof)
    elif kind.kind == "array":
        yield Leaf(path, offset, kind.item.cname, kind.length)
    else:
        yield Leaf(path, offset, kind.cname, 1)


@cache
def members(struct: str = "zygos_arm_t") -> dict[str, list[Leaf]]:
    """The numbers of a struct by member. Those of its sums (zygos_sums_t) count as its own."""
    out = defaultdict(list)
    for leaf in leaves(ffi.typeof(struct)):
        named = replace(leaf, path=leaf.path.removeprefix("sums."))
        out[named.member].append(named)
    return out


def used(native: Any, leaf: Leaf) -> NDArray[np.int64]:
    """Elements that are not zero."""
    image = np.frombuffer(ffi.buffer(native), leaf.dtype, leaf.count, leaf.offset)
    return np.flatnonzero(image)


def one_of_each(native: Any, rng: np.random.Generator, without: Sequence[str] = ()) -> list[Place]:
    """Of each member of zygos_arm_t an element, one in use if any is. without: the first names of some members."""
    out = []
    for name, group in members().items():
        if name.split(".")[0] in without:
            continue
        few = [group[k] for k in rng.permutation(len(group))]
        leaf, at = next(((one, at) for one in few if len(at := used(native, one))), (few[0], np.array([0])))
        out.append(Place(leaf, int(rng.choice(at))))
    return out


def sums(native: Any, rng: np.random.Generator, each: int = 3) -> list[Place]:
    """Of each member that is an array of sums in some elements of an array of structs: the largest entry of the first,
    of the last and of others."""
    out = []
    for group in members().values():
        if group[0].kind != "double" or group[0].count < SUMS or group[0].member in BESIDE_GROUPS:
            continue
        full = [leaf for leaf in group if len(used(native, leaf)) >= SUMS]
        chosen = [*full[:1], *full[-1:], *(full[k] for k in rng.permutation(len(full)))][:each]
        for leaf in dict.fromkeys(chosen):
            image = np.frombuffer(ffi.buffer(native), leaf.dtype, leaf.count, leaf.offset)
            out.append(Place(leaf, int(np.nanargmax(np.abs(image)))))
    return out


def beside_sums(native: Any, rng: np.random.Generator, each: int = 2) -> list[Place]:
    """Numbers of the elements of an array of structs that have sums: how many rows these are of, and the like. Of each
    member that of some elements, those in use before the others; of a short array an entry."""
    element = re.compile(r"[^\[]*\[\d+\]")
    numbers = [leaf for group in members().values() for leaf in group if leaf.kind == "double"]
    numbers = [leaf for leaf in numbers if not leaf.path.startswith("joint.")]  # stored twice
    inside = [(leaf, at[0]) for leaf in numbers if (at := element.match(leaf.path))]
    with_sums = {at for leaf, at in inside if leaf.count > 8 * SUMS}
    places = defaultdict(list)
    for leaf, at in inside:
        if at in with_sums and leaf.count <= SUMS:
            places[leaf.member].append(leaf)
    places |= {name: members()[name] for name in BESIDE_GROUPS}
    out = []
    for group in places.values():
        few = sorted((group[k] for k in rng.permutation(len(group))), key=lambda leaf: not len(used(native, leaf)))
        out += [Place(leaf, int(rng.integers(leaf.count))) for leaf in few[:each]]
    return out


def config_of_its_own(flight: Flight) -> Any:
    """The caller's own configuration, as zygos_arm_scrub() wants it."""
    return ffi.new("zygos_config_t *", flight.native.sums.config)


def lose_the_way(flight: Flight) -> Place:
    """Flip a bit of an index or a count, so that it is impossible and nothing but zygos_arm_scrub() may go on."""
    config, work = config_of_its_own(flight), ffi.new("zygos_work_t *")
    for place in one_of_each(flight.native, np.random.default_rng(0), without=("config", "magic", "receiver")):
        if place.leaf.kind == "uint32_t":
            place.flip(flight.native, 20)
            if lib.zygos_arm_check(flight.native, config, work) == lib.ZYGOS_E_STATE:
                return place
            place.flip(flight.native, 20)
    raise AssertionError("no index or count is impossible with another bit")
