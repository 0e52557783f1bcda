# zygos: `make` sets up, runs the main job and shows the result; `make test` runs the tests; `make help` lists the rest.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
NATIVE := harness/zygos/_native/libzygos.so
SOURCES := $(wildcard c/*.c c/ports/host/*) $(wildcard include/zygos/*) tools/build_native.py
C_FILES := $(wildcard c/*.c c/ports/*/*.[ch] include/zygos/*.h tests/fuzz/*.c tests/bench/*.c tests/bench/*.cpp tools/*.c)
ifdef CI
export CFLAGS += -Werror
endif

.DEFAULT_GOAL := demo
.PHONY: demo build test hil gap bench accuracy demo-log lint format warnings clean help

demo: build ## set up, run the paper's example over CAN, show the result (out/demo/report.html)
	$(BIN)/python -m zygos.demo

build: $(VENV)/.core $(NATIVE) ## set up .venv and build the C library for it

$(VENV)/.core: pyproject.toml setup.py
	$(PYTHON) -c 'import sys; sys.exit("zygos needs Python 3.11 or later; remedy: make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.test: $(VENV)/.core
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,lint]'
	touch $@

$(NATIVE): $(SOURCES) | $(VENV)/.core
	$(BIN)/python tools/build_native.py $(@D)

test: build $(VENV)/.test ## unit, bus, fuzz and bench tests, a process for each core
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile tests/unit tests/bus tests/fuzz tests/bench

hil: build $(VENV)/.test ## the example across a real vcan (the kernel's, or User-Mode Linux)
	tools/with-vcan $(BIN)/python -m pytest tests/hil

gap: build $(VENV)/.test ## hide effects in a MuJoCo plant, explain them, score the verdicts (out/gap.json; 20 minutes)
	PYTHONPATH=tests $(BIN)/python -m oracles.campaign

bench: build $(VENV)/.test ## what it costs, beside its peers (out/bench.json, README.md, docs/cost.md; 6 minutes)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests $(BIN)/python -m bench out/bench.json

accuracy: build $(VENV)/.test ## errors, coverage and refusals of all estimators (docs/accuracy.html; 10 minutes; SEEDS= DRAWS= SCHEDULER= CASES=)
	$(BIN)/python -m zygos.accuracy $(CASES) $(if $(SEEDS),--seeds $(SEEDS)) $(if $(DRAWS),--draws $(DRAWS)) $(if $(SCHEDULER),--scheduler $(SCHEDULER))

demo-log: build $(VENV)/.test ## write the logs of examples/gap/demo again
	PYTHONPATH=tests $(BIN)/python -m oracles.demo_log

lint: build $(VENV)/.test ## ruff, mypy, clang-format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run --Werror $(C_FILES)

format: $(VENV)/.test ## rewrite Python and C in the house style
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(C_FILES)

clean: ## remove everything that was built
	rm -rf $(VENV) out build harness/zygos/_native harness/*.egg-info

help: ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10
