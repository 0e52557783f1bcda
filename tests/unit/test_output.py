# SPDX-License-Identifier: MIT
"""What commands print: tables that lose nothing on a narrow terminal, and text that is no markup."""

from __future__ import annotations

import re

import pytest

from zygos.files.output import console, good, table

COLUMNS = ("signal of the arm", "largest difference", "at cycle", "verdict")
ROWS = [
    ("shoulder link angle", "-4.292e-06", "1,187", good("ok")),
    ("[red]elbow[/] torque", "0.0001234", "12,345", "steps [0, 1] of another encoder: look at its counts"),
]


def printed(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, width: int | None) -> str:
    monkeypatch.setattr(console, "_width", None)  # where COLUMNS was set when it was made, it is fixed
    if width is None:
        monkeypatch.delenv("COLUMNS", raising=False)
    else:
        monkeypatch.setenv("COLUMNS", str(width))
    table(COLUMNS, ROWS, title="the [first] table")
    return capsys.readouterr().out


@pytest.mark.parametrize("width", [None, 200, 80, 60, 40, 20])
def test_no_cell_of_a_table_is_cut(
    width: int | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    said = printed(capsys, monkeypatch, width)
    assert "…" not in said
    for word in " ".join([*COLUMNS, *(str(cell) for row in ROWS for cell in row)]).split():
        assert word in said
    for name, number, *_ in ROWS:
        assert re.search(rf"^{re.escape(str(name))} .*{re.escape(str(number))}", said, re.M), (
            "names and numbers are whole"
        )
    assert said.startswith("the [first] table")
    if width and width >= 40:
        assert max(map(len, said.splitlines())) <= width


def test_a_table_that_fits_is_one(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    whole, narrow = (printed(capsys, monkeypatch, width) for width in (None, 40))
    assert len(whole.splitlines()) == 4
    assert narrow.count("[red]elbow[/] torque") > 1, "the first column is in every part"
