"""Names in the alphabets of other formats: identifiers of a DBC or of C, comments in ASCII."""

from __future__ import annotations

import re
import unicodedata


def without_marks(text: str) -> str:
    """Text in ASCII, as far as leaving out accents and dots makes it so."""
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()


def ascii_name(text: str) -> str:
    """A name as identifier of a DBC: letters without their marks, digits, and _ for whatever else; may be empty."""
    return re.sub("[^A-Za-z0-9]+", "_", without_marks(text)).strip("_")


def printable(name: str) -> str:
    """A name in a comment: ASCII without quotes, for the format states no encoding."""
    plain = re.sub(r'[^ -~]|["\\]', " ", without_marks(name))
    return " ".join(plain.split()) or "unnamed"
