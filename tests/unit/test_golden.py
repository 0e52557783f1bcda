# SPDX-License-Identifier: MIT
"""Bits of estimates from fixed runs: a change of how the library stores its sums must change none of them."""

from __future__ import annotations

import json

import pytest
from golden_support import CONFIGURATIONS, EXPECTED, bits, flown

from zygos.native.flight import lib


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_every_bit_is_what_it_was(name: str) -> None:
    expected = json.loads(EXPECTED.read_text())[name]
    found = [bits(estimate) for estimate in flown(name)]
    assert found == expected
    assert all(one["validity"] > lib.ZYGOS_REFUSED for one in found)
