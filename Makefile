# Needs make and Python 3.11 or later; everything else is set up in .venv by the first target.

RUN_ARGS ?= --line florence --from II --to III
PYTEST_ARGS ?=
QUICK_ARGS ?=
# Two workers mostly wait for real clocks, so their number is two more than the processors.
PYTEST_WORKERS ?= 4
BENCH_ARGS ?=
MUTATE_ARGS ?=
SENSITIVITY_ARGS ?=
FUZZ_ARGS ?=
SIMULATE_ARGS ?= --hours 10000 --workers 2 --journal runs/simulate.jsonl
EXPLORE_ARGS ?=
MODEL_ARGS ?=
BREAK_ARGS ?=
PYTHON ?=
DOCUMENTS ?=
WHEEL_ARGS ?=

# Container images often disable bytecode. Without it each of the hundreds of programs that the tests
# start would compile all of its sources.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
BIN := $(VENV)/bin
READY_TO_RUN := $(VENV)/.ready-to-run
READY_TO_TEST := $(VENV)/.ready-to-test
READY_TO_SITE := $(VENV)/.ready-to-site
READY_FOR_WHEELS := $(VENV)/.ready-for-wheels
# A relative name: the variables below split at blanks, which the path of a checkout may contain.
CONSTRAINTS := constraints.txt
# Only environment variables pass the constraints to pip's own build environment: the first up to pip
# 25.2, the second from then on.
PIP := PIP_CONSTRAINT=$(CONSTRAINTS) PIP_BUILD_CONSTRAINT=$(CONSTRAINTS) PIP_DISABLE_PIP_VERSION_CHECK=1 \
	$(BIN)/python -m pip install --quiet -c $(CONSTRAINTS)

# The unit tests of vobc/atp.
PROTECTION_TESTS = hil_tests/unit/vobc/atp hil_tests/unit/vobc/test_vobc_config.py

.DEFAULT_GOAL := help
.PHONY: help setup run test test-quick check collected format-check lint types layers prose mutate fuzz coverage bench bench-hil bench-atp bench-logs bench-page bench-energy bench-stops bench-plug bench-t2t bench-scaling bench-simulator simulate explore model compiled docs site format examples figures test-kernels break sensitivity wheels clean distclean

help: ## show this list
	@sed -n 's/^\([a-z0-9-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | while IFS='	' read -r name text; do \
		printf '  make %-13s %s\n' "$$name" "$$text"; done

setup: $(READY_TO_TEST) ## create .venv with all dependencies for development

WATCH ?= $(if $(filter --trains --and-back --service,$(RUN_ARGS)),,--watch)

run: $(READY_TO_RUN) ## bring up a bus and run from one station to the next; RUN_ARGS="--from I --to II"
	@# With the trap the run ends by itself on Ctrl-C, and its bus is removed afterwards. Without standard
	@# input the page ends with the run; `vobc watch` shows it again.
	@trap : INT TERM HUP; \
	$(BIN)/vcan status vcan0 >/dev/null 2>&1; was_up=$$?; \
	$(BIN)/vcan up vcan0 || exit; \
	$(BIN)/vobc run $(WATCH) $(RUN_ARGS) </dev/null; status=$$?; \
	[ $$was_up = 0 ] || $(BIN)/vcan down vcan0; \
	exit $$status

test: $(READY_TO_TEST) ## run all tests; PYTEST_ARGS="-k name"
	VOBC_NATIVE=$${VOBC_NATIVE:-on} $(BIN)/python -m pytest -n $(PYTEST_WORKERS) $(PYTEST_ARGS)

test-quick: $(READY_TO_TEST) ## run for a minute the tests that your changes can affect; QUICK_ARGS="--since HEAD~1"
	@$(BIN)/python -m metro_tools.quick_tests $(QUICK_ARGS) -- $(PYTEST_ARGS)

test-kernels: $(READY_TO_TEST) ## run the guest's tests on each of its three kernels; PYTEST_ARGS="-k name"
	@for kernel in stock newer qemu; do \
		echo "vcan-guest --kernel $$kernel"; \
		VCAN_GUEST_KERNEL=$$kernel $(BIN)/python -m pytest hil_tests/real_time/test_vcan_guest.py $(PYTEST_ARGS) || exit; \
	done

check: format-check lint ## run all checks of continuous integration
	@# Two at a time. `collected` compiles the bytecode of the test files once for all workers, and starts
	@# to build the compiled copy.
	@$(MAKE) --no-print-directory --output-sync --jobs 2 collected types layers prose
	@$(MAKE) --no-print-directory test

collected: $(READY_TO_TEST)
	@VOBC_NATIVE=$${VOBC_NATIVE:-on} $(BIN)/python -m pytest --collect-only --quiet >/dev/null 2>&1 || true # The test run reports errors.

format-check: $(READY_TO_TEST)
	$(BIN)/ruff format --check .

lint: $(READY_TO_TEST)
	$(BIN)/ruff check .

types: $(READY_TO_TEST)
	$(BIN)/mypy

prose: $(READY_TO_TEST) ## find words that docs/design/development.md excludes
	$(BIN)/python -m metro_tools.prose

layers: $(READY_TO_TEST)
	$(BIN)/lint-imports

# The C code would hide the changes.
mutate: export VOBC_NATIVE := off
mutate: $(READY_TO_TEST) ## check that tests detect every small code change in the safety half; MUTATE_ARGS=...
	@# Mutates code, then data. A survivor of either fails the target.
	$(if $(filter-out data,$(firstword $(MUTATE_ARGS) code)),$(BIN)/python -m metro_tools.mutate $(MUTATE_ARGS); code=$$?;) \
	$(if $(filter-out data,$(MUTATE_ARGS)),,$(BIN)/python -m metro_hil.proof.data; data=$$?;) \
	exit $$(($${code:-0} | $${data:-0}))

sensitivity: $(READY_TO_TEST) ## check that a scenario detects each semantic mutant of the controller; SENSITIVITY_ARGS=...
	$(BIN)/hil sensitivity acceptance $(SENSITIVITY_ARGS)

fuzz: $(READY_TO_TEST) ## attack a controller with 10 million frames; FUZZ_ARGS="--frames N --seed S"
	$(BIN)/python -m metro_hil.proof $(FUZZ_ARGS)

# Only the unit tests of the protection count: a whole run executes most lines but checks few.
coverage: $(READY_TO_TEST) ## measure branch coverage of vobc/atp by its own tests; fails below 100 %
	$(BIN)/python -m pytest -p no:cacheprovider --cov=vobc.atp --cov-branch --cov-fail-under=100 \
		--cov-report=term-missing:skip-covered $(PROTECTION_TESTS)

bench: $(READY_TO_TEST) ## measure the figures of docs/results; BENCH_ARGS=...
	$(BIN)/python -m metro_hil.benchmarks.bench $(BENCH_ARGS)

bench-hil: compiled ## measure campaigns: overhead, tables of [Allotta 2013], kills, 10,000 stops; BENCH_ARGS=...
	$(BIN)/python -m metro_hil.benchmarks.campaigns $(BENCH_ARGS)

bench-page: $(READY_TO_TEST) ## measure the pages of logs, of live runs and of campaigns
	$(BIN)/python -m metro_tools.page_bench $(BENCH_ARGS)

bench-atp: $(READY_TO_TEST) ## measure the cost of protection in each cycle, and its braking distances
	$(BIN)/python -m metro_hil.benchmarks.protection $(BENCH_ARGS)

bench-logs: $(READY_TO_TEST) ## compare canlog with similar tools on a log of 2 M frames
	$(BIN)/python -m hil_tests.log_benchmarks $(BENCH_ARGS)

bench-scaling: compiled ## measure how processor time grows with trains, frames, cores and length of run; BENCH_ARGS=...
	$(BIN)/python -m hil_tests.scaling_bench $(BENCH_ARGS)

bench-energy: compiled ## measure running curves, DC network, green line and seven whole trains; BENCH_ARGS=...
	$(BIN)/python -m metro_hil.benchmarks.energy $(BENCH_ARGS)

bench-stops: compiled ## measure stops over the envelope of trains and lines, law by law; BENCH_ARGS="gain --seeds 4"
	$(BIN)/python -m metro_hil.benchmarks.stops $(BENCH_ARGS)

bench-plug: $(READY_TO_TEST) ## measure controllers and plants of your own: time to the first hop, speed in lockstep, cost of a frame, FMUs; BENCH_ARGS=...
	$(BIN)/python -m metro_hil.benchmarks.plug $(BENCH_ARGS)

bench-t2t: $(READY_TO_TEST) ## measure the takeover after masters are killed or stopped, over real zenoh; BENCH_ARGS="--trains N --timers B"
	$(BIN)/python -m metro_hil.line.failover_trial --fault kill $(BENCH_ARGS)
	$(BIN)/python -m metro_hil.line.failover_trial --fault stop $(BENCH_ARGS)
	$(BIN)/python -m metro_hil.line.failover_trial --fault switch $(BENCH_ARGS)
	$(BIN)/python -m metro_hil.line.failover_trial --fault none --trains 8 $(BENCH_ARGS)
	$(BIN)/python -m metro_hil.line.sessions

simulate: $(READY_TO_TEST) ## simulate trains that command themselves under random faults, 10,000 hours; SIMULATE_ARGS=...
	@mkdir -p runs
	VOBC_NATIVE=wait $(BIN)/hil simulate $(SIMULATE_ARGS)

break: $(READY_TO_TEST) ## check that random kills and full disks do not change the reports of campaigns; BREAK_ARGS=...
	unshare --map-root-user --mount $(BIN)/python -m metro_hil.engine.kill_trial --kills 30 --full-disks 10 \
		--campaign stops --limit 6 $(BREAK_ARGS)

explore: $(READY_TO_TEST) ## check every schedule of two trains and their arbiters with one or two faults; EXPLORE_ARGS=...
	$(BIN)/python -m metro_hil.simulation.model_check $(EXPLORE_ARGS)

model: $(READY_TO_TEST) ## check the TLA+ model of trains that command themselves, and without each guard; MODEL_ARGS=...
	@# Needs Java and TLC, which docs/design/t2t_model.md says how to get.
	$(BIN)/python -m metro_hil.formal.model_runs $(MODEL_ARGS)

bench-simulator: compiled ## measure simulator, failover and headway in virtual time; BENCH_ARGS=...
	PYTHONSAFEPATH=1 PYTHONPATH=$$($(BIN)/python -m metro_tools.compiled --part simulator --wait) \
		$(BIN)/python -m metro_hil.benchmarks.simulator $(BENCH_ARGS)

docs: $(READY_TO_TEST) ## write tables, pages and pictures of the documents; fails if figures are older than the code
	@# Stops if the current code gives other figures; `make figures` measures them again.
	$(BIN)/hil laws --check --write
	$(BIN)/hil requirements --out docs/reference/requirements.md
	$(BIN)/python -m metro_tools.picture_doc
	$(BIN)/python -m metro_tools.parsed_dbc
	$(BIN)/python -m metro_tools.interface_doc
	$(BIN)/python -m metro_tools.fault_doc
	$(BIN)/python -m metro_tools.table_doc
	$(BIN)/python -m metro_tools.law_doc
	$(BIN)/python -m metro_tools.t2t_doc
	$(BIN)/python -m metro_tools.key_doc
	$(BIN)/python -m metro_tools.command_doc
	$(BIN)/python -m metro_tools.api_doc
	$(BIN)/python -m metro_tools.figure_doc

site: $(READY_TO_SITE) ## build the documentation site in site/; opens without a network
	$(BIN)/python -m metro_tools.site

figures: $(READY_TO_TEST) ## measure the figures that `make docs` calls stale; takes up to an hour
	$(BIN)/hil laws --measure
	$(MAKE) --no-print-directory docs

examples: $(READY_TO_TEST) ## run every command of README and docs in a fresh clone; DOCUMENTS=docs/guide/hil.md
	$(BIN)/python -m metro_tools.doc_blocks $(DOCUMENTS)

format: $(READY_TO_TEST) ## format and fix the code with ruff
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

compiled: $(READY_TO_TEST) ## compile controller, train and simulator now and not in the background of a run
	$(BIN)/python -m metro_tools.compiled --part train --wait
	$(BIN)/python -m metro_tools.compiled --part simulator --wait
	$(BIN)/python -m hil_tests.simulator_copy

wheels: $(READY_FOR_WHEELS) ## build compiled wheels for Linux on x86-64 and arm64 in dist/, and try the one for this machine; WHEEL_ARGS=...
	$(BIN)/python -m metro_tools.wheels $(WHEEL_ARGS)
	$(BIN)/python -m hil_tests.wheel_trial "$$(ls -t dist/*_$$(uname -m).whl | head -1)"

clean: ## remove caches and build results; runs/ and .venv stay
	rm -rf build dist site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean ## remove .venv, too
	rm -rf $(VENV)

$(READY_TO_RUN): pyproject.toml $(CONSTRAINTS) | $(BIN)/python
	@echo "setting up $(VENV) to run (once; may take a minute)"
	@$(PIP) -e .
	@touch $@

$(READY_TO_TEST): pyproject.toml $(CONSTRAINTS) | $(BIN)/python
	@echo "setting up $(VENV) for development (once; may take a minute)"
	@$(PIP) -e '.[dev]'
	@touch $(READY_TO_RUN) $@

$(READY_FOR_WHEELS): pyproject.toml $(CONSTRAINTS) $(READY_TO_TEST)
	@echo "setting up $(VENV) for building wheels (once; downloads a C compiler of 100 MB)"
	@$(PIP) -e '.[dev,wheels]'
	@touch $@

# The library that draws charts is no Python package; its tarball is checked against a pinned hash.
$(READY_TO_SITE): pyproject.toml $(CONSTRAINTS) $(READY_TO_TEST)
	@echo "setting up $(VENV) for the documentation site (once; may take a minute)"
	@$(PIP) -e '.[dev,site]'
	@$(BIN)/python -m metro_tools.site fetch
	@touch $@

$(BIN)/python:
	@PYTHON="$(PYTHON)" tools/make-venv $(VENV)
