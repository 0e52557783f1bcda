# SPDX-License-Identifier: MIT
"""XML files whose attributes are changed in their own bytes: whatever is not changed stays as it was, byte for byte.

Expat says where each element begins. An editor that parses and writes again would lose comments, quotes, line ends and
the number of digits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from zygos.errors import ZygosError
from zygos.files.inputs import local

_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=/>"']+)(\s*=\s*)("[^"]*"|'[^']*')""")
_DEEPEST = 32
"""Files that include one another."""


@dataclass
class Element:
    """An element where it stands in its file."""

    tag: str
    attributes: dict[str, str]
    file: Path
    start: int
    """Offset of its first byte."""
    opened: int
    """Offset of the first byte behind its start tag."""
    line: int
    children: list[Element] = field(default_factory=list)
    closed: int = 0
    """Offset of the first byte behind the element."""

    def all(self, tag: str) -> Iterator[Element]:
        """Its children of a tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Its first child of a tag; None where there is none."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """Itself and everything in it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()


@dataclass(frozen=True)
class Document:
    """A file with those that it includes."""

    path: Path
    root: Element
    """With the content of the included files in the place of `<include>`."""
    content: Mapping[Path, bytes]
    """Bytes of each file."""
    included: Mapping[Path, tuple[Element, ...]]
    """The `<include>` elements that name each file but the first."""


def read_document(path: Path, includes: bool = False) -> Document:
    """Parse a file. includes: whether `<include file>` brings in another file, whose path is relative to the first one.

    Errors: ZygosError for a file that cannot be read, is not valid XML, is UTF-16, or includes itself.
    """
    content: dict[Path, bytes] = {}
    included: dict[Path, tuple[Element, ...]] = {}

    def read(file: Path, above: tuple[Path, ...]) -> Element:
        if file in above or len(above) > _DEEPEST:
            raise ZygosError(f"{file}: includes itself; remedy: remove that <include>")
        try:
            content[file] = local(file).read_bytes()
        except OSError as error:
            by = f" (included by {above[-1].name})" if above else ""
            raise ZygosError(f"{file}: cannot be read{by} ({error.strerror}); remedy: check the path") from None
        root = _parse(file, content[file])
        if includes:
            expand(root, (*above, file))
        return root

    def expand(element: Element, above: tuple[Path, ...]) -> None:
        children: list[Element] = []
        for child in element.children:
            if child.tag == "include" and "file" in child.attributes:
                file = path.parent / child.attributes["file"]
                included[file] = (*included.get(file, ()), child)
                children += read(file, above).children
            else:
                expand(child, above)
                children.append(child)
        element.children = children

    root = read(path, ())
    return Document(path, root, content, included)


def end_of(joint: Element, which: str) -> str:
    """The link that a joint of a URDF names as parent or child; empty where it names none."""
    link = joint.first(which)
    return "" if link is None else link.attributes.get("link", "")


def parsed(path: Path, content: bytes) -> Document:
    """A file that is not on the disk. Errors: as `read_document`."""
    return Document(path, _parse(path, content), {path: content}, {})


def _parse(file: Path, content: bytes) -> Element:
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ZygosError(f"{file}: is UTF-16, which is not edited in place; remedy: save it as UTF-8")
    parser = expat.ParserCreate()
    top = Element("", {}, file, 0, 0, 0)
    stack = [top]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        one = Element(tag, attributes, file, start, _end_of_tag(content, start), parser.CurrentLineNumber)
        stack[-1].children.append(one)
        stack.append(one)

    def end(_tag: str) -> None:
        one = stack.pop()
        at = parser.CurrentByteIndex
        # of an empty element expat gives the place of its start tag, or the one behind it
        one.closed = content.index(b">", at) + 1 if content[at : at + 2] == b"</" else one.opened

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ZygosError(f"{file}: is not valid XML ({error}); remedy: correct that line") from None
    return top.children[0]


def _end_of_tag(content: bytes, start: int) -> int:
    """Offset behind the `>` of the tag that begins at `start`; one within quotes does not end it."""
    quote = 0
    for at in range(start, len(content)):
        byte = content[at]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == ord(">"):
            return at + 1
    raise AssertionError("expat has read this tag to its end")


class Edits:
    """Changes of a document, which are made together."""

    def __init__(self, document: Document) -> None:
        """Nothing is changed yet."""
        self.document = document
        self._attributes: dict[tuple[Path, int], tuple[Element, dict[str, str | None]]] = {}
        self._inserted: list[tuple[Element, str]] = []
        self._removed: list[Element] = []

    def give(self, element: Element, **attributes: str | None) -> None:
        """Give an element attributes; None removes one."""
        kept = self._attributes.setdefault((element.file, element.start), (element, {}))[1]
        kept.update(attributes)

    def insert(self, parent: Element, text: str) -> None:
        """Put an element, as text, before the first child, on a line of its own where the children have such."""
        self._inserted.append((parent, text))

    def remove(self, element: Element) -> None:
        """Take an element away, with the white space before it."""
        self._removed.append(element)

    @property
    def touched(self) -> set[Path]:
        """The files that change."""
        changed = {element.file for element, _ in self._attributes.values() if self._tag_of(element) is not None}
        return changed | {one.file for one, _ in self._inserted} | {one.file for one in self._removed}

    def _tag_of(self, element: Element) -> bytes | None:
        """The new start tag of an element; None where it stays as it is."""
        old = self.document.content[element.file][element.start : element.opened]
        _, attributes = self._attributes.get((element.file, element.start), (element, {}))
        new = old
        for name, value in attributes.items():
            if element.attributes.get(name) != value:
                new = _with_attribute(new, name, value)
        return None if new == old else new

    def result(self, rename: Callable[[Path], str] = lambda file: file.name) -> dict[Path, bytes]:
        """The bytes of each file that changes, and of the first one. rename: what an `<include>` calls a changed
        file, relative to the folder of the first one."""
        touched = self.touched
        # who includes a file that has another name changes as well
        todo = list(touched)
        while todo:
            file = todo.pop()
            for include in self.document.included.get(file, ()):
                self.give(include, file=rename(file))
                if include.file not in touched:
                    touched.add(include.file)
                    todo.append(include.file)
        out = {}
        for file in {*touched, self.document.path}:
            content = self.document.content[file]
            parts = [
                (one.start, one.opened, tag)
                for one, _ in self._attributes.values()
                if one.file == file and (tag := self._tag_of(one)) is not None
            ]
            parts += [_insertion(content, parent, text) for parent, text in self._inserted if parent.file == file]
            for one in self._removed:
                if one.file == file:
                    begin = len(content[: one.start].rstrip(b" \t\r\n"))
                    parts.append((begin, one.closed, b""))
            for start, stop, text in sorted(parts, key=lambda part: (part[0], part[1]), reverse=True):
                content = content[:start] + text + content[stop:]
            out[file] = content
        return out


def _with_attribute(tag: bytes, name: str, value: str | None) -> bytes:
    """A start tag with another value of an attribute; None: without it."""
    at_name = re.compile(rb"<[^\s/>]+").match(tag)
    assert at_name is not None
    last = at_name.end()
    for found in _ATTRIBUTE.finditer(tag, last):
        last = found.end()
        if found[2].decode() != name:
            continue
        if value is None:
            return tag[: found.start()] + tag[found.end() :]
        quote = found[4][:1].decode()
        inner = escape(value, {quote: "&quot;" if quote == '"' else "&apos;"})
        return tag[: found.start(4)] + f"{quote}{inner}{quote}".encode() + tag[found.end(4) :]
    return tag if value is None else tag[:last] + f" {name}={quoteattr(value)}".encode() + tag[last:]


def _insertion(content: bytes, parent: Element, text: str) -> tuple[int, int, bytes]:
    """Where a child is put, and the bytes."""
    if content[parent.opened - 2 : parent.opened] == b"/>":
        return parent.opened - 2, parent.opened, b">" + text.encode() + b"</" + parent.tag.encode() + b">"
    first = parent.children[0].start if parent.children else parent.opened
    between = content[parent.opened : first]
    # the line of the first child may have a comment before it
    indent = re.match(rb"\s*", between)
    return parent.opened, parent.opened, (indent[0] if indent else b"") + text.encode()
