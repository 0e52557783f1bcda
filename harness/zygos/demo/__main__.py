# SPDX-License-Identifier: MIT
"""`python -m zygos.demo`, which `make` runs."""

from zygos.demo.demonstration import run_demo
from zygos.files.output import errors_end_the_program

if __name__ == "__main__":
    with errors_end_the_program():
        run_demo()
