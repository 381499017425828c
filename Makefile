# `make demo` and `make test` need only Python 3.11+, git and make: they make .venv themselves.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
RUN ?= run

# constraints.txt states the exact version of everything that is installed, for the Python versions it was made for;
# on another Python the newest releases that fit are taken.
LOCKED = 3.11 3.12 3.13
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
CONSTRAINTS ?= $(if $(filter $(VERSION),$(LOCKED)),--constraint constraints.txt)
INSTALL = .ci/install $(BIN)/python $(CONSTRAINTS) --editable

# Tests start the program often, and pytest rewrites their assertions: compiled code is kept, whatever the user's settings.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-fast test-statistics fuzz lint golden schemas docs site lock sbom dist clean
.DELETE_ON_ERROR:

demo: $(VENV)/installed
	$(BIN)/occlog run sample_data/pose2sim/run.yaml -o $(RUN)/pose2sim
	$(BIN)/occlog run sample_data/room/run.yaml -o $(RUN)/room
	$(BIN)/occlog run examples/people.yaml -o $(RUN)/people
	$(BIN)/occlog start sample_data/people -o $(RUN)/walk
	@echo "Look at $(RUN)/people/report.html and overlay.webm beside it, $(RUN)/room/report.html, $(RUN)/pose2sim/report.html and $(RUN)/walk/report.html; the video is $(RUN)/walk/overlay.webm"

# A worker for each processor: threads of the linear algebra would wait for each other, and numbers depend on them.
test test-fast test-statistics: export OPENBLAS_NUM_THREADS = 1
test test-fast test-statistics: export OMP_NUM_THREADS = 1
test test-fast test-statistics: export MPLBACKEND = Agg

# worksteal gives each worker a contiguous part of the tests: those of a folder share kernels, and run in one worker.
test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal --durations 30 --durations-min 1 -m "not statistics" --ignore tests/report/browser

# Kernels as plain Python, which checks bounds: the fast tests of the folders that have kernels.
KERNELS = core filtering measure/clusters measure/regions scans simulate/balls simulate/render simulate/world \
	track/apf track/images/kernels track/imm track/in_space track/jipda track/map track/people track/sort
test-fast: $(VENV)/installed-dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m "not slow and not statistics and not jit" $(KERNELS:%=tests/%)

# Errors over many runs, which only change with the methods, and documents that are run: `make test` has shorter forms.
# Comparisons with TrackEval and py-motmetrics install these; without a network they are skipped, or fail with
# OCCLOG_PEERS_REQUIRED=1. OCCLOG_PEERS=/path/to/python names an environment that has them.
test-statistics: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal -m statistics $$(grep -rlw statistics tests --include="test_*.py")

# Changed files for every reader: a million each takes days; `make fuzz INPUTS=10000` looks for an hour or two.
INPUTS ?= 1000000
fuzz: $(VENV)/installed-dev
	$(INSTALL) ".[fuzz]"
	$(BIN)/python -m tests.fuzz --inputs $(INPUTS) --out fuzz

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
	$(BIN)/python -m docs.pictures
	$(MAKE) --no-print-directory VENV=$(VENV) site

# The pages as a site, with search: build/site/index.html. Links that lead nowhere fail.
site: $(VENV)/installed-dev
	$(BIN)/python -m sphinx -q -W --keep-going -b html -c docs . build/site

# The newest releases of everything, the oldest that pyproject.toml allows, which CI tries, and what users install by digests.
RESOLVE = $(BIN)/uv pip compile pyproject.toml --quiet --no-annotate --custom-compile-command "make lock"
COMPILE = $(RESOLVE) --upgrade
lock: $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet uv
	$(COMPILE) --extra dev --extra openvino --extra fuzz --extra s3 --extra gs --extra ray --universal --python-version 3.11 -o constraints.txt
	$(COMPILE) --extra test --extra cluster --extra qp --extra ros2 --extra sound --resolution lowest-direct --python-version 3.11 -o .ci/lowest.txt
	$(RESOLVE) --universal --python-version 3.11 --generate-hashes --constraint constraints.txt -o requirements.lock

# What occlog is made of, with the licences of what is installed (CycloneDX).
sbom: $(VENV)/installed-dev
	$(BIN)/python -m docs.sbom

# The sources, with tests and sample data, and of these the wheel.
dist: $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet build
	$(BIN)/python -m build --outdir dist

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) .
	touch $@

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) ".[dev]"
	touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) $(RUN) build dist *.egg-info
	find occlog tests -name "*.nb[ic]" -delete
