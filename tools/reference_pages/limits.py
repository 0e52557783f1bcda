# SPDX-License-Identifier: MIT
"""The page of the limits, from their table."""

import re
from pathlib import Path

from reference_pages.markdown import page, table
from zygos import limits
from zygos.limits import Limit

_TABLE = Path(limits.__file__)
_INTRO = (
    "Every threshold and every setting that decides an answer of `zygos explain`, of an estimate on the ground, "
    "of `zygos check-arm` or of a refinement, and what `zygos convert` leaves out of a recording, stands in this "
    "table, and nowhere else. The JSON of `zygos explain` lists those that decided the answer under `decided_by`. "
    "The unit 1 means that a value has no unit. Sources: a *convention* is usual in the field or chosen by its "
    "purpose, *derived* values follow from others, and those of a *trial* were set with runs whose truth is "
    "known."
)


def _shown(limit: Limit[object]) -> str:
    value = limit.value
    listed = value if isinstance(value, tuple) else (value,)
    return ", ".join(str(one) if isinstance(one, tuple) else f"{one:.6g}" for one in listed)


def limits_page() -> str:
    """The page of the limits, in the parts of the table."""
    by_name = {limit.name: limit for limit in limits.TABLE}
    parts: list[str] = []
    for part in re.split(r"^# (?!fmt|SPDX)", _TABLE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        title, _, text = part.partition("\n")
        rows = [by_name[name] for name in re.findall(r'^[A-Z_]+ = Limit\("([^"]+)"', text, flags=re.MULTILINE)]
        parts.append(f"## {title}")
        parts.append(
            table(
                ("Limit", "Value", "Unit", "Source", "Meaning"),
                ((one.name, _shown(one), one.unit, one.source, one.meaning) for one in rows),
            )
        )
    return page("Limits", _INTRO, *parts)
