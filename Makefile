# One virtual environment, made once; every target sets up what it needs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
HENON_HEILES := "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3"
# The CPU build that is tested; a plain `pip install torch` may bring several GB of CUDA builds.
TORCH := torch==2.13.0

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-wheel coverage lint bench bench-quick tables docs clean

help: ## List what can be done
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed 's/:.*## /: /' | awk -F': ' '{printf "  make %-11s %s\n", $$1, $$2}'

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(TORCH) --editable '.[dev]'
	@touch $@

demo: $(VENV)/installed ## Train the paper's oscillator, compare, draw (two minutes)
	$(BIN)/python examples/oscillator.py --out output

test: $(VENV)/installed ## Run the test suite (four minutes)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

test-slow: $(VENV)/installed ## Run the slow checks too
	$(BIN)/python -m pytest -n 2 --dist worksteal

test-wheel: $(VENV)/installed ## Build a wheel, install it elsewhere, see that it works
	VENV_BIN="$(abspath $(BIN))" PYTHON="$(PYTHON)" TORCH="$(TORCH)" bash tests/wheel.sh

coverage: $(VENV)/installed ## Run the test suite and print which lines of hamsym it does not reach
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -n 2 --dist worksteal -m "not slow"
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

lint: $(VENV)/installed ## Check style, formatting, types and the layers of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/installed ## Measure all benchmarks into tests/benchmarks/results.json (half an hour)
	$(BIN)/python -m tests.benchmarks

bench-quick: $(VENV)/installed ## Run all benchmarks in seconds, to see that they run
	$(BIN)/python -m tests.benchmarks --quick

tables: $(VENV)/installed ## Make the tables and the figure of examples/benchmarks.md from the results
	$(BIN)/python -m tests.benchmarks.tables

docs: tables ## Make tables and pictures of the documentation again (five minutes)
	$(BIN)/hamsym solve $(HENON_HEILES) --z0 0.3,-0.3,0.3,0.15 --t-end 40 --plot examples/pictures/trajectory.png
	$(BIN)/python examples/oscillator.py --out examples/pictures
	$(BIN)/python examples/henon_heiles.py --out examples/pictures
	$(BIN)/python examples/chaos.py --out examples/pictures
	$(BIN)/python examples/chaos_map.py --out examples/pictures
	$(BIN)/python examples/pendulum_period.py --out examples/pictures

clean: ## Remove the environment and everything built
	rm -rf $(VENV) build dist output *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage .coverage.*
