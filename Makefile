# One virtual environment, made once; every target sets up what it needs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The CPU build that is tested; a plain `pip install torch` may bring several GB of CUDA builds.
TORCH := torch==2.13.0

.DEFAULT_GOAL := help
# Bytecode of hamsym and of the tests is kept, whatever the caller's environment says: otherwise every
# process of the suite would compile both again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-docs test-portable test-slow test-browser test-wheel coverage lint bench bench-quick tables pictures docs clean

help: ## List what can be done
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed 's/:.*## /: /' | awk -F': ' '{printf "  make %-13s %s\n", $$1, $$2}'

$(VENV)/installed: $(VENV)/packages hamsym/kernel/build_backend.py $(wildcard hamsym/kernel/*.[ch])
	$(BIN)/python -P hamsym/kernel/build_backend.py
	@touch $@

$(VENV)/packages: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(TORCH) --editable '.[dev]'
	@touch $@

demo: $(VENV)/installed ## Train the paper's oscillator, compare, draw (two minutes)
	$(BIN)/python examples/oscillator.py --out output

test: $(VENV)/installed ## Run the test suite (three minutes; five when nothing is compiled yet)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not page and not browser"

test-docs: $(VENV)/installed ## Run the docstrings, pages and examples of the documentation
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "page and not slow" tests/docs tests/cli

# The folders whose tests compute, without files that mostly compile, that these settings do not
# reach, or whose arithmetic rounds alike on every processor: Arb and single steps of float64.
PORTABLE := $(addprefix tests/,codegen dynamics families fitting flow_maps integrators invariant_manifolds networks numerics \
    orbits proof random_features solution systems workbench/test_animation.py docs/test_documentation.py) \
    $(addprefix --ignore=tests/codegen/test_,jax.py other_languages.py numba_cache.py generated_code.py) \
    $(addprefix --ignore=tests/integrators/test_,coefficients.py integrate.py) \
    $(addprefix --ignore-glob=tests/proof/test_,ball* box* chebyshev* *_attack.py forced* generated.py \
    mutations.py root* sets* spectrum.py taylor_models.py window_steps.py)

test-portable: $(VENV)/installed ## Test the numerics with the code for an older processor
	$(BIN)/python -m tests.older_processor -n 2 --dist worksteal -m "not slow and not browser" $(PORTABLE)

test-slow: $(VENV)/installed ## Run the slow checks too
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not browser"

test-browser: $(VENV)/installed ## Test pages in a headless Chromium (the system's, package chromium)
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || \
	    { echo "make test-browser needs the system's package chromium: apt-get install chromium"; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(TORCH) --editable '.[dev,browser,explore]'
	$(BIN)/python -m pytest -n 2 --dist worksteal -m browser tests/browser

test-wheel: $(VENV)/installed ## Build a wheel, install it elsewhere, see that it works
	VENV_BIN="$(abspath $(BIN))" PYTHON="$(PYTHON)" TORCH="$(TORCH)" bash tests/wheel.sh

coverage: $(VENV)/installed ## Run the test suite and print which lines of hamsym it does not reach
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -n 2 --dist worksteal -m "not slow and not browser"
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

lint: $(VENV)/installed ## Check style, formatting, types, the layers of imports and lengths
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -q -n 0 tests/test_structure.py

bench: $(VENV)/installed ## Measure all benchmarks into tests/benchmarks/results.json (half an hour)
	$(BIN)/python -m tests.benchmarks

bench-quick: $(VENV)/installed ## Run all benchmarks in seconds, to see that they run
	$(BIN)/python -m tests.benchmarks --quick

tables: $(VENV)/installed ## Make the tables and the figure of examples/guide/benchmarks.md from the results
	$(BIN)/python -m tests.benchmarks.tables

pictures: tables ## Make tables and pictures of the pages again (five minutes)
	$(BIN)/python examples/oscillator.py --out examples/guide/pictures
	$(BIN)/python examples/chaos.py --out examples/guide/pictures
	$(BIN)/python examples/chaos_map.py --out examples/guide/pictures
	$(BIN)/python examples/pendulum_period.py --out examples/guide/pictures
	$(BIN)/python examples/figures.py --out examples/guide/pictures
	$(BIN)/python examples/periodic_orbits.py --out examples/guide/pictures
	$(BIN)/python examples/lagrange_points.py --out examples/guide/pictures
	$(BIN)/python examples/double_pendulum.py --out examples/guide/pictures

$(VENV)/documented: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(TORCH) --editable '.[dev,docs]'
	@touch $@

docs: $(VENV)/documented ## Build the documentation into output/site, which needs no network (two minutes)
	$(BIN)/python -m sphinx -W --keep-going -q -d output/doctrees -c examples/site examples/guide output/site
	$(BIN)/python examples/site/links.py output/site
	@echo "open output/site/index.html"

clean: ## Remove the environment and everything built
	rm -rf $(VENV) build dist output examples/guide/generated *.egg-info hamsym/kernel/kernel.*.so .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage .coverage.*
