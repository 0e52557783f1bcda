# zygos: `make` sets up, runs the main job and shows the result; `make test` runs the tests; `make help` lists the rest.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
NATIVE := harness/zygos/_native/libzygos.so
SOURCES := $(wildcard c/*/*.c c/ports/host/*) c/flags.txt $(wildcard include/zygos/* include/zygos/priv/*) tools/build_native.py
C_FILES := $(wildcard c/*/*.c c/ports/*/*.[ch] include/zygos/*.h include/zygos/priv/*.h tests/builds/*.c tests/fuzz/*.[ch] tests/bench/*.c tests/upset/*.c tests/bench/*.cpp tests/pil/*.c tools/*.c) \
           $(filter-out %/arm_config.h,$(wildcard examples/onboard/*.[ch]))
ifdef CI
export CFLAGS := $(filter-out -Werror,$(CFLAGS)) -Werror
endif

# The library for linking. It needs a C compiler and no Python.
BUILD  ?= build
PREFIX ?= /usr/local
LIBRARY := $(BUILD)/libzygos.a
NODE := $(BUILD)/zygos-node
OBJECTS := $(patsubst c/%.c,$(BUILD)/objects/%.o,$(wildcard c/*/*.c))
HEADERS := $(patsubst include/zygos/%,%,$(wildcard include/zygos/*.h include/zygos/priv/*.h))
DATABASES := $(notdir $(wildcard include/zygos/*.dbc))
PACKAGES := zygos.pc zygosConfig.cmake zygosConfigVersion.cmake
# What sizes the structs goes on to those who link, wherever it was written.
SIZES := $(sort $(filter -DZYGOS_%,$(CAPACITIES) $(CFLAGS)))
COMPILE = $(CC) $(strip $(file <c/flags.txt)) $(CFLAGS) $(CAPACITIES) -Iinclude
ifeq ($(origin AR),default)
AR = $(shell $(CC) -print-prog-name=ar)
endif
ifneq ($(filter-out -DZYGOS_%,$(CAPACITIES)),)
$(error CAPACITIES holds $(filter-out -DZYGOS_%,$(CAPACITIES)), which is no capacity; remedy: CAPACITIES="-DZYGOS_MAX_JOINTS=2 ..", other options in CFLAGS)
endif

.DEFAULT_GOAL := demo
.PHONY: lock demo real build library amalgamation install dist install-node uninstall FORCE node test test-slow test-all coverage times kernels hil latency pil gap loop bench verify limits accuracy mission soak upset ground demo-log reference docs lint format warnings clean help

demo: build ## set up, run the paper's example over CAN, show the result (out/demo/report.html)
	$(BIN)/python -m zygos.demo

real: build $(VENV)/.test ## measured runs of real arms: estimate, validate, compare, explain, correct the MJCF (out/real/, docs/pendulum-gap.svg; a minute)
	$(BIN)/python -m zygos.demo.real
	cp out/real/gap.svg docs/pendulum-gap.svg

build: $(VENV)/.core $(NATIVE) ## set up .venv and build the C library for it

$(VENV)/.core: pyproject.toml setup.py constraints.txt include/zygos/types.h
	$(PYTHON) -c 'import sys; sys.exit("zygos needs Python 3.11 or later; remedy: make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	touch $@

$(VENV)/.test: $(VENV)/.core
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test,lint]'
	touch $@

$(VENV)/.docs: $(VENV)/.core
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	touch $@

$(NATIVE): $(SOURCES) | $(VENV)/.core
	$(BIN)/python tools/build_native.py $(@D)

library: $(LIBRARY) ## build/libzygos.a, for linking (CC= CFLAGS= CAPACITIES="-DZYGOS_MAX_JOINTS=2 .." BUILD=)

$(LIBRARY): $(OBJECTS)
	rm -f $@
	$(AR) rcs $@ $^

$(BUILD)/objects/%.o: c/%.c $(BUILD)/command
	@mkdir -p $(@D)
	$(COMPILE) -MMD -MP -c $< -o $@

-include $(OBJECTS:.o=.d)

# Changes when the command that compiles does, and all objects with it.
$(BUILD)/command: export COMMAND = $(COMPILE)
$(BUILD)/command: FORCE
	@mkdir -p $(@D)
	@echo "$$COMMAND" | cmp -s - $@ || echo "$$COMMAND" >$@

$(PACKAGES:%=$(BUILD)/%): $(BUILD)/%: tools/package/%.in include/zygos/types.h $(BUILD)/command
	sed -e 's/@VERSION@/$(shell sed -n 's/^#define ZYGOS_VERSION_[A-Z]* //p' include/zygos/types.h | paste -sd .)/' \
		-e 's/@SIZES@/$(SIZES)/' $< >$@

amalgamation: ## the library as one file: build/amalgamation/zygos.c, with its headers in zygos/ (BUILD=)
	$(PYTHON) tools/amalgamate.py $(BUILD)/amalgamation

install: export TO = $(DESTDIR)$(PREFIX)
install: $(LIBRARY) $(PACKAGES:%=$(BUILD)/%) ## library, headers, DBC, licence, pkg-config and CMake files (PREFIX=/usr/local DESTDIR=)
	install -d "$$TO/include/zygos/priv" "$$TO/lib/cmake/zygos" "$$TO/lib/pkgconfig" "$$TO/share/zygos"
	install -m 644 include/zygos/*.h "$$TO/include/zygos"
	install -m 644 include/zygos/priv/*.h "$$TO/include/zygos/priv"
	install -m 644 $(DATABASES:%=include/zygos/%) LICENSE "$$TO/share/zygos"
	install -m 644 $(LIBRARY) "$$TO/lib"
	install -m 644 $(BUILD)/zygos.pc "$$TO/lib/pkgconfig"
	install -m 644 $(BUILD)/zygosConfig.cmake $(BUILD)/zygosConfigVersion.cmake "$$TO/lib/cmake/zygos"

dist: $(VENV)/.test ## a release of the newest commit: sdist, wheel, C sources, SBOM, checksums (dist/; the same bytes each time)
	$(BIN)/python tools/dist.py dist

UNIT := zygos-node@.service
install-node: export TO = $(DESTDIR)$(PREFIX)
install-node: $(NODE) ## zygos-node and its unit for systemd (PREFIX=/usr/local DESTDIR=)
	install -d "$$TO/bin" "$$TO/lib/systemd/system"
	install -m 755 $(NODE) "$$TO/bin"
	sed 's|/usr/local|$(PREFIX)|' c/ports/linux/$(UNIT) >"$$TO/lib/systemd/system/$(UNIT)"

uninstall: export TO = $(DESTDIR)$(PREFIX)
uninstall: ## remove what install and install-node put there (same PREFIX and DESTDIR)
	cd "$$TO" && rm -f $(HEADERS:%=include/zygos/%) $(DATABASES:%=share/zygos/%) share/zygos/LICENSE lib/libzygos.a lib/pkgconfig/zygos.pc \
		bin/zygos-node lib/systemd/system/$(UNIT) lib/cmake/zygos/zygosConfig.cmake lib/cmake/zygos/zygosConfigVersion.cmake
	cd "$$TO" && for folder in include/zygos/priv include/zygos share/zygos lib/cmake/zygos; do rmdir $$folder 2>/dev/null || true; done

node: $(NODE) ## build build/zygos-node, the flight node for SocketCAN (docs/node.md)

$(NODE): $(LIBRARY) $(wildcard c/ports/linux/*.[ch] c/ports/telemetry/* include/zygos/*.h include/zygos/priv/*.h)
	$(COMPILE) -D_GNU_SOURCE -Ic/ports/telemetry $(filter %.c,$^) $(LIBRARY) -lm -o $@.partial
	mv $@.partial $@

# Folders of tests that need no bus of the kernel's and no emulator of a board; docs/testing.md has the tiers.
TESTS := $(addprefix tests/,unit bus fuzz bench builds statistics campaigns soak upset verify)
# Compiled test modules are kept: pytest rewrites every assertion of a module that it compiles.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile
# What all quick tests and all tests may take, in units of a loop that tests/support/tiers.py measures on the same machine.
QUICK_BUDGET := 6000
WHOLE_BUDGET := 33000
test: build node $(VENV)/.test ## the quick tests, a process for each core
	$(PYTEST) --budget $(QUICK_BUDGET) -m "not slow" $(TESTS)

test-slow: build node $(VENV)/.test ## the slow tests alone
	$(PYTEST) --dist worksteal -m slow $(TESTS)

test-all: build node $(VENV)/.test ## the quick and the slow tests, without hil and pil (out/tests.json)
	$(PYTEST) --budget $(WHOLE_BUDGET) --times $${ZYGOS_OUT:-out}/tests.json $(TESTS)

# The package as links to its files, so that the library beside them can be another one.
COVERED := $(BUILD)/coverage
COVERED_TESTS := $(wildcard tests/unit/test_guard*.py) $(addprefix tests/unit/test_,scrub.py flight_joints.py change.py)
coverage: build node $(VENV)/.test ## the quick tests and some slow ones, counting lines and branches; fails below the floors in pyproject.toml
	rm -rf $(COVERED)
	mkdir -p $(COVERED)/harness
	cp -rs $(CURDIR)/harness/zygos $(COVERED)/harness
	rm -r $(COVERED)/harness/zygos/_native
	CFLAGS="$(CFLAGS) --coverage" $(BIN)/python tools/build_native.py $(COVERED)/harness/zygos/_native
	ZYGOS_RUNS=$(abspath $(COVERED))/runs PYTHONPATH=$(abspath $(COVERED))/harness $(PYTEST) -m "not slow" -o quick_limit=0 --cov --cov-report= $(TESTS)
	ZYGOS_RUNS=$(abspath $(COVERED))/runs PYTHONPATH=$(abspath $(COVERED))/harness $(PYTEST) -m slow --cov --cov-append --cov-report= $(COVERED_TESTS)
	$(BIN)/gcovr --json-summary $(COVERED)/c.json
	$(BIN)/coverage report

times: ## write the table of docs/testing.md from the last `make test-all`
	$(BIN)/python tools/test_times.py $${ZYGOS_OUT:-out}/tests.json docs/testing.md

KERNEL_TESTS := $(addprefix tests/unit/test_,c_equals_numpy.py effects.py any_arm.py momentum_sums.py) tests/statistics/test_noise.py
kernels: build node $(VENV)/.test ## C against numpy under two more sets of BLAS and numpy kernels (other processors' rounding)
	$(BIN)/python tools/with_kernels.py $(BIN)/python -m pytest -n auto --dist loadfile -m "not slow" $(KERNEL_TESTS)

DRILLS := tests/hil/test_drills.py tests/hil/test_node.py tests/hil/test_can_utils.py
hil: build node $(VENV)/.test ## fault drills across a real vcan (the kernel's, or User-Mode Linux); or CHANNEL=can0 DUT=external (docs/hil.md)
	PYTHONPATH=tests:tests/support $(BIN)/python -c "import conftest"
	ZYGOS_RUNS=$${ZYGOS_OUT:-out}/runs $(if $(CHANNEL),ZYGOS_VCAN_IFS=$(CHANNEL) ZYGOS_OUT=$${ZYGOS_OUT:-out},ZYGOS_VCAN_TIMEOUT=$${ZYGOS_VCAN_TIMEOUT:-1500} tools/with-vcan) $(BIN)/python -m pytest -rs \
	    $(if $(DUT),$(DRILLS),tests/hil) --zygos-channel $(or $(CHANNEL),$(firstword $(ZYGOS_VCAN_IFS)),vcan0) \
	    --zygos-dut $(or $(DUT),$(NODE)) --zygos-scenario build/examples/lively/scenario.toml --zygos-json $${ZYGOS_OUT:-out}/hil.json

latency: $(VENV)/.test ## write the latencies of docs/results.md and docs/latency.svg from the last `make hil`
	$(BIN)/python tools/latency.py $${ZYGOS_OUT:-out}/hil.json docs/results.md docs/latency.svg

pil: build $(VENV)/.test ## the library as firmware on an emulated Cortex-M7 and Cortex-M4F: the host's bits (QEMU)
	$(PYTEST) tests/pil

gap: build $(VENV)/.test ## hide effects in MuJoCo plants, explain them, score the verdicts (docs/trials.md, out/gap.json; 90 minutes, resumes; CELLS= DRAWS= FROM=)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:tests/support $(BIN)/python -m oracles.trials $(CELLS) $(if $(DRAWS),draws=$(DRAWS)) $(if $(FROM),from=$(FROM))

bench: build $(VENV)/.test ## what it costs, beside its peers (out/bench.json, README.md, docs/cost.md; 20 minutes)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:tests/support $(BIN)/python -m bench out/bench.json

VERIFY = OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:tests/support $(BIN)/python -m verify
verify: build $(VENV)/.test ## evidence for the C library (docs/verification.md; 3 hours; STEPS="gcc coverage" MUTANTS=400 SEED=0 MINUTES=30 COUNTERS=.)
	$(VERIFY) $(STEPS) $(if $(MUTANTS),mutants=$(MUTANTS)) $(if $(SEED),seed=$(SEED)) $(if $(MINUTES),minutes=$(MINUTES)) $(if $(COUNTERS),counters=$(COUNTERS))

limits: build $(VENV)/.test ## make the measured stack, sizes and instructions the limits of `make verify` (tests/verify/limits.json)
	$(VERIFY) limits

accuracy: build $(VENV)/.test ## errors, coverage, refusals and distance from the bound of all estimators (docs/accuracy.html; half an hour; SEEDS= DRAWS= SCHEDULER= CASES= AGAINST=)
	$(BIN)/python -m zygos.accuracy $(CASES) $(if $(SEEDS),--seeds $(SEEDS)) $(if $(DRAWS),--draws $(DRAWS)) $(if $(SCHEDULER),--scheduler $(SCHEDULER)) $(if $(AGAINST),--against $(AGAINST))

mission: build $(VENV)/.test ## intervals over missions of up to 30 days of fresh noise (docs/mission.md; 30 minutes; LENGTHS="300s 3h" DRAWS=)
	$(BIN)/python -m zygos.accuracy.missions $(LENGTHS) $(if $(DRAWS),--draws $(DRAWS))

soak: build $(VENV)/.test ## 30 days of 2 joints, 3.6 hours of 7: estimates, intervals, counters (out/soak.json, docs/soak.md; 10 minutes; NAMES= FULL=1)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:tests/support $(BIN)/python -m soak $(NAMES) $(if $(FULL),--full)

upset: build $(VENV)/.test ## flip bits in the memory of the library, count what comes of it (out/upset.json, docs/upset.md; an hour; SHARE= SEED=)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:tests/support $(BIN)/python -m upset $(if $(SHARE),share=$(SHARE)) $(if $(SEED),seed=$(SEED))

ground: build $(VENV)/.test ## simulated laboratory arms: do the intervals hold (docs/laboratory.md; 40 minutes; ARMS= DRAWS=)
	$(BIN)/python -m zygos.accuracy.ground $(ARMS) $(if $(DRAWS),--draws $(DRAWS))

loop: build node $(VENV)/.test ## from the bus to the model and back, beside a node of this machine (out/loop.json, docs/loop.svg; a minute)
	$(BIN)/python -m zygos.demo.loop
	cp $${ZYGOS_OUT:-out}/loop/loop.svg docs/loop.svg

demo-log: build $(VENV)/.test ## write the logs of examples/gap/demo and docs/gap.svg again
	PYTHONPATH=tests:tests/support $(BIN)/python -m oracles.demo_log
	$(BIN)/python -m zygos.demo
	cp out/demo/gap.svg docs/gap.svg

reference: build $(VENV)/.test ## the pages in docs/reference/: command line, keys of the files, codes of the C library, JSON outputs
	$(BIN)/python tools/reference.py

docs: build $(VENV)/.docs ## the documentation as a site for reading offline (out/docs/index.html); a broken link ends it
	$(BIN)/sphinx-build -W --keep-going -q -b html docs $${ZYGOS_OUT:-out}/docs
	cp $${ZYGOS_OUT:-out}/docs/README.html $${ZYGOS_OUT:-out}/docs/index.html

lock: ## resolve all Python packages anew and write their versions (constraints.txt)
	tools/lock.sh $(PYTHON)

lint: build $(VENV)/.test ## ruff, mypy, the order of sub-packages, clang-format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/clang-format --dry-run --Werror $(C_FILES)

format: $(VENV)/.test ## rewrite Python and C in the house style
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(C_FILES)

clean: ## remove everything that was built
	rm -rf $(VENV) out build dist examples/onboard/build harness/zygos/_native harness/*.egg-info
	find harness tests tools -name __pycache__ -prune -exec rm -r {} +

help: ## this list
	@grep -E '^[a-z-]+:.*##' $(firstword $(MAKEFILE_LIST)) | sed 's/:.*## /\t/' | expand -t 10
