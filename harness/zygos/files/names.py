# SPDX-License-Identifier: MIT
"""Names in the character sets of other formats: identifiers of a DBC or of C, comments in ASCII."""

from __future__ import annotations

import re
import unicodedata


def without_marks(text: str) -> str:
    """Text with accents removed from its letters; characters that remain outside ASCII are dropped."""
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()


def ascii_name(text: str) -> str:
    """A name as a DBC identifier: letters without accents, digits, and _ for every other character; may be empty."""
    return re.sub("[^A-Za-z0-9]+", "_", without_marks(text)).strip("_")


def printable(name: str) -> str:
    """A name for a comment: ASCII without quotes, because the format does not state an encoding."""
    plain = re.sub(r'[^ -~]|["\\]', " ", without_marks(name))
    return " ".join(plain.split()) or "unnamed"
