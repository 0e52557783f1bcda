pytest_plugins = ["zygos.testing"]
