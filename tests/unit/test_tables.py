# SPDX-License-Identifier: MIT
"""Tables with faults: rows that are not whole, names that come twice, and files that are no tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zygos.can.bus import check_log
from zygos.can.run import find_arm
from zygos.errors import ZygosError
from zygos.files.tables import read_columns
from zygos.telemetry.ros import check_mcap

ROWS = "".join(f"{k},{k / 8},{-k}\n" for k in range(30))


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("30,3.75\n", "has 2 of 3 columns in line 32, which is left out"),
        ("30,3.75", "has 2 of 3 columns in line 32, which is left out"),
        ("30,3.75,1,2\n", "has 4 of 3 columns in line 32, which is left out"),
        ("30,3.7\n,,,\n1,2\n", "has 2 of 3 columns in line 32, which is left out, and 1 row after it do not have 3"),
    ],
)
def test_a_row_with_other_columns_is_left_out_and_said(row: str, said: str, tmp_path: Path) -> None:
    """A trailing separator, as in ",,,", is no column more."""
    file = written(tmp_path / "x.csv", "t,q,w\n" + ROWS + row)
    damage: list[str] = []
    columns = read_columns(file, damage)
    assert damage == [said]
    np.testing.assert_array_equal(columns["q"][:30], np.arange(30) / 8)
    assert len(columns["q"]) == (31 if ",,," in row else 30)
    with pytest.raises(ZygosError, match=r"columns in line 32.*; remedy: export it again"):
        read_columns(file)


def test_a_row_below_the_names_that_is_not_whole(tmp_path: Path) -> None:
    """The format follows from most rows, not from the first two."""
    damage: list[str] = []
    columns = read_columns(written(tmp_path / "x.csv", "t;q;w\n0,5;1\n" + ROWS.replace(",", ";")), damage)
    assert damage == ["has 2 of 3 columns in line 2, which is left out"]
    assert columns["w"].tolist() == [-k for k in range(30)]


def test_names_that_come_twice_are_numbered(tmp_path: Path) -> None:
    """As the columns of an array in an NPZ; nobody is given the first in silence."""
    columns = read_columns(written(tmp_path / "x.csv", "t,q,q\n1,2,3\n4,5,6\n"))
    assert {name: values.tolist() for name, values in columns.items()} == {"t": [1, 4], "q[0]": [2, 5], "q[1]": [3, 6]}


@pytest.mark.parametrize("text", ["t,q,w\n1,2,3,\n4,5,6,\n", "t,q,w,\n1,2,3\n4,5,6\n", "t,q,w,\n1,2,3,\n4,5,6,\n"])
def test_separators_at_the_end_of_lines(text: str, tmp_path: Path) -> None:
    columns = read_columns(written(tmp_path / "x.csv", text))
    assert {name: columns[name].tolist() for name in ("t", "q", "w")} == {"t": [1, 4], "q": [2, 5], "w": [3, 6]}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,q\n" + ROWS, "the first row has 2 fields, but most rows have 3"),
        ("Arm of May,4 axes\nt,q,w\n" + ROWS, "the first row has 2 fields, but most rows have 3"),
    ],
)
def test_a_first_row_that_does_not_name_the_columns(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match=said + r"; remedy: .* give every column a name"):
        read_columns(written(tmp_path / "x.csv", text), [])


@pytest.mark.parametrize("content", [b"PAR1\x15\x04\x15\x00", b"t,q\n1,\x00\x00\x00\x00", b"\x89MCAP0\r\n\x00\x00"])
def test_a_csv_that_is_binary_is_called_so(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(content)
    with pytest.raises(ZygosError, match=r"is not text, but binary; remedy: .* the suffix of that"):
        read_columns(tmp_path / "x.csv")


@pytest.mark.parametrize("name", ["run.csv", "run.blf", "run.mcap", "recording"])
def test_a_folder_is_called_so(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(ZygosError, match=rf"{name}: is a folder; remedy: give a file in it"):
        find_arm(tmp_path / name)
    check = check_mcap if name.endswith(".mcap") else check_log
    with pytest.raises(ZygosError, match=rf"{name}: is a folder"):
        check(tmp_path / name)


def test_numbers_of_a_csv(tmp_path: Path) -> None:
    """Whole numbers keep all digits; too large ones, and ones beside a missing value, are floats; text stays text."""
    head = "whole,large,missing,text\n"
    columns = read_columns(
        written(tmp_path / "x.csv", head + "1700000000123456789,1e30,7,a\n2,99999999999999999999,,7\n")
    )
    assert columns["whole"].tolist() == [1700000000123456789, 2]
    assert columns["large"].tolist() == [1e30, 1e20]
    np.testing.assert_array_equal(columns["missing"], [7.0, np.nan])
    assert columns["text"].tolist() == ["a", "7"]
