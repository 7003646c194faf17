# Two commands on a fresh machine with Python 3.11 or newer: `make demo` and `make test`. VENV=DIR puts the virtual
# environment elsewhere.

VENV ?= .venv
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do command -v $$p && break; done)
BIN := $(VENV)/bin
DEMO := runs/demo
FUZZ_SECONDS ?= 600
FUZZ_SEED ?= 0
FUZZ_COUNT ?= 1000000
FUZZ_FAULTS ?= 1000
BOUNDS := tests/kernels tests/mapping
OLDEST := tests
SELECT := not slow

.PHONY: help demo test oldest fuzz bounds check format-check lint types bench bench-peers figures docs samples golden clean

help:
	@echo "make demo | test | oldest | fuzz | bounds | check | bench | bench-peers | figures | docs | samples | golden | clean"

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

$(VENV)/.run: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable . --group dev
	@touch $@ $(VENV)/.run

demo: $(VENV)/.run
	$(BIN)/mavnav replay sample_logs/complex.bag --output $(DEMO) --force
	@echo "Pictures: $(DEMO)/map.png and $(DEMO)/wall_thickness.png; $(DEMO)/result.mcap opens in Foxglove."

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 -m "$(SELECT)"

$(VENV)-oldest/.dev: pyproject.toml
	$(PYTHON) -m venv $(VENV)-oldest
	$(VENV)-oldest/bin/python -m pip install --quiet --upgrade "pip>=25.1"
	sed -nE '/^dependencies/,/^]/s/^ *"([a-z0-9]+)>=([0-9.]+).*/\1==\2/p' pyproject.toml > $(VENV)-oldest/versions.txt
	$(VENV)-oldest/bin/python -m pip install --quiet --constraint $(VENV)-oldest/versions.txt --editable . --group dev
	@touch $@

oldest: $(VENV)-oldest/.dev
	$(VENV)-oldest/bin/python -m pytest -n 2 -m "$(SELECT)" $(OLDEST)

fuzz: $(VENV)/.dev
	$(BIN)/python benchmarks/fuzz_logs.py --seed $(FUZZ_SEED) --count $(FUZZ_COUNT) --attacks $(FUZZ_COUNT) \
		--seconds $$(($(FUZZ_SECONDS) / 3))
	$(BIN)/python benchmarks/fuzz_inputs.py --seed $(FUZZ_SEED) --count $(FUZZ_COUNT) --seconds $$(($(FUZZ_SECONDS) / 3))
	$(BIN)/python benchmarks/fuzz_faults.py --seconds $$(($(FUZZ_SECONDS) / 3)) --count $(FUZZ_FAULTS)

bounds: $(VENV)/.dev
	NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest -n 2 $(BOUNDS)

check: format-check lint types test

format-check: $(VENV)/.dev
	$(BIN)/ruff format --check

lint: $(VENV)/.dev
	$(BIN)/ruff check

types: $(VENV)/.dev
	$(BIN)/mypy

bench: $(VENV)/.dev
	$(BIN)/python -m pytest benchmarks --benchmark-only
	$(BIN)/python benchmarks/replays.py
	$(BIN)/python benchmarks/exactness.py
	$(BIN)/python benchmarks/exactness.py --method paper

$(VENV)-peers/.done: pyproject.toml
	$(PYTHON) -m venv $(VENV)-peers
	$(VENV)-peers/bin/python -m pip install --quiet --editable . kiss-icp small-gicp || \
		{ echo "pip cannot get kiss-icp and small-gicp: connect to a package index, then run make bench-peers again"; exit 1; }
	@touch $@

bench-peers: $(VENV)-peers/.done
	$(VENV)-peers/bin/python benchmarks/peers.py $(LOGS)

figures: $(VENV)/.dev
	$(BIN)/python benchmarks/figures.py

docs: $(VENV)/.run
	$(BIN)/python -m pip install --quiet --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --clean
	@echo "The site is in site/: open site/index.html"

samples: $(VENV)/.dev
	MAVNAV_UPDATE_SAMPLES=1 $(BIN)/python -m pytest tests/pipelines/test_sample_logs.py -m "" -k makes_it_again

golden: $(VENV)/.dev
	MAVNAV_UPDATE_GOLDEN=1 $(BIN)/python -m pytest tests/pipelines/test_golden.py

clean:
	rm -rf $(VENV) $(VENV)-oldest runs build dist site .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
	find mavnav tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +
