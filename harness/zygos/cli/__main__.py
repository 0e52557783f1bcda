# SPDX-License-Identifier: MIT
"""`python -m zygos.cli`, which is the command `zygos`."""

from zygos.cli import main

if __name__ == "__main__":
    main()
