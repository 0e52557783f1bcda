# SPDX-License-Identifier: MIT
pytest_plugins = ["zygos.testing"]
