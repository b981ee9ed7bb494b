# One virtual environment, made once; every target sets up what it needs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The CPU build that is tested; a plain `pip install torch` may bring several GB of CUDA builds.
TORCH := torch==2.13.0

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-wheel lint bench clean

help: ## List what can be done
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed 's/:.*## /: /' | awk -F': ' '{printf "  make %-11s %s\n", $$1, $$2}'

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(TORCH) --editable '.[dev]'
	@touch $@

demo: $(VENV)/installed ## Train the paper's oscillator, compare, draw (two minutes)
	$(BIN)/python examples/oscillator.py --out output

test: $(VENV)/installed ## Run the test suite
	$(BIN)/python -m pytest -n 2 -m "not slow"

test-slow: $(VENV)/installed ## Run the slow checks too
	$(BIN)/python -m pytest -n 2

test-wheel: $(VENV)/installed ## Build a wheel, install it elsewhere, see that it works
	VENV_BIN="$(abspath $(BIN))" PYTHON="$(PYTHON)" TORCH="$(TORCH)" bash tests/wheel.sh

lint: $(VENV)/installed ## Check style, formatting and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/installed ## Print the benchmarks' ratios (twenty minutes)
	$(BIN)/python tests/benchmarks/derivation.py
	$(BIN)/python tests/benchmarks/integrators.py
	$(BIN)/python tests/benchmarks/training_epoch.py
	$(BIN)/python tests/benchmarks/growth.py
	$(BIN)/python tests/benchmarks/work_precision.py
	$(BIN)/python tests/benchmarks/certificates.py

clean: ## Remove the environment and everything built
	rm -rf $(VENV) build dist output *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
