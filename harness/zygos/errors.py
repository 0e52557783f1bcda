"""Errors that a user can cause and repair; the command line prints them and exits with their code."""

from __future__ import annotations


class ZygosError(Exception):
    """Bad input. The message says what is wrong and how to repair it: ``"what is wrong: …; remedy: …"``."""

    exit_code: int = 2


class Undecided(ZygosError):
    """The question is valid, but the data do not answer it."""

    exit_code = 3


class Damaged(ZygosError):
    """The question was answered, but from a log that is incomplete."""

    exit_code = 4
