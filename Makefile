# `make demo` and `make test` need only Python 3.11+, git and make: they make .venv themselves.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
RUN ?= run

.PHONY: demo test test-fast lint golden schemas docs clean
.DELETE_ON_ERROR:

demo: $(VENV)/installed
	$(BIN)/occlog run sample_data/pose2sim/run.yaml -o $(RUN)/pose2sim
	$(BIN)/occlog run sample_data/room/run.yaml -o $(RUN)/room
	@echo "Look at $(RUN)/room/report.html and $(RUN)/pose2sim/report.html"

# Comparisons with TrackEval and py-motmetrics install these; without a network they are skipped, or fail with
# OCCLOG_PEERS_REQUIRED=1. OCCLOG_PEERS=/path/to/python names an environment that has them.
test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal

test-fast: $(VENV)/installed-dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m "not slow and not jit" tests/core tests/measure tests/simulate tests/track tests/evaluate

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

golden: $(VENV)/installed-dev
	$(BIN)/python -m tests.golden.make

schemas: $(VENV)/installed-dev
	$(BIN)/occlog schema -o schemas --overwrite

docs: $(VENV)/installed-dev
	$(BIN)/python -m docs.make

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) $(RUN) build dist *.egg-info
