# zygos: `make` sets up, runs the main job and shows the result; `make test` runs the tests; `make help` lists the rest.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
NATIVE := harness/zygos/_native/libzygos.so
SOURCES := $(wildcard c/*.c c/ports/host/*) $(wildcard include/zygos/*) tools/build_native.py
NODE := build/zygos-node
NODE_SOURCES := $(wildcard c/*.c c/ports/linux/*.c)
C_FLAGS := -std=c11 -O2 -ffp-contract=off -fno-math-errno -Wall -Wextra -Wconversion -Wsign-conversion -Wdouble-promotion -Wshadow -pedantic
C_FILES := $(wildcard c/*.c c/ports/*/*.[ch] include/zygos/*.h tests/fuzz/*.c tests/bench/*.c tools/*.c)
ifdef CI
export CFLAGS += -Werror
endif

.DEFAULT_GOAL := demo
.PHONY: demo build node test hil gap count accuracy demo-log lint format warnings clean help

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

node: $(NODE) ## build build/zygos-node, the flight node for SocketCAN (docs/node.md)

$(NODE): $(NODE_SOURCES) $(wildcard c/ports/linux/*.h include/zygos/*.h)
	mkdir -p $(@D)
	$(CC) $(C_FLAGS) $(CFLAGS) -D_GNU_SOURCE -Iinclude $(NODE_SOURCES) -lm -o $@.partial
	mv $@.partial $@

test: build node $(VENV)/.test ## unit, bus, fuzz and bench tests, a process for each core
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile tests/unit tests/bus tests/fuzz tests/bench

DRILLS := tests/hil/test_drills.py tests/hil/test_node.py tests/hil/test_can_utils.py
hil: build node $(VENV)/.test ## fault drills across a real vcan (the kernel's, or User-Mode Linux); or CHANNEL=can0 DUT=external (docs/hil.md)
	$(if $(CHANNEL),ZYGOS_VCAN_IFS=$(CHANNEL) ZYGOS_OUT=$${ZYGOS_OUT:-out},tools/with-vcan) $(BIN)/python -m pytest \
	    $(if $(DUT),$(DRILLS),tests/hil) --zygos-channel $(or $(CHANNEL),$(firstword $(ZYGOS_VCAN_IFS)),vcan0) \
	    --zygos-dut $(or $(DUT),$(NODE)) --zygos-scenario examples/paper/scenario.toml --zygos-json $${ZYGOS_OUT:-out}/hil.json

gap: build $(VENV)/.test ## hide effects in a MuJoCo plant, explain them, score the verdicts (out/gap.json; 20 minutes)
	PYTHONPATH=tests $(BIN)/python -m oracles.campaign

count: build $(VENV)/.test ## count the instructions of a cycle, by valgrind (out/count.json)
	PYTHONPATH=tests $(BIN)/python -m bench.count out/count.json

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
