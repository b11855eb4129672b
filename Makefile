# All tasks from a bare checkout, with Python 3.11 or newer and make: `make demo`, `make test`.

PYTHON ?= python3
PYTHON312 ?= python3.12
VENV ?= .venv
PYTEST_FLAGS ?= --numprocesses auto --dist worksteal
LOCK_ENV := $(VENV)/.installed
EXTRAS_ENV := $(VENV)/.installed-extras
BIN := $(VENV)/bin
COMPILE := uv pip compile --no-config --universal --python-version 3.11 --generate-hashes --fork-strategy fewest \
	--no-emit-index-url --no-emit-find-links --no-header --no-annotate --upgrade -q
# All extras but `rerun`, which is large.
LOCKED_EXTRAS = $(shell sed -n '/^\[project.optional/,/^\[dep/s/^\([a-z0-9]*\) = \[.*/\1/p' pyproject.toml | grep -vx rerun)

# One thread for NumPy's linear algebra; more threads slow down the planner's kernels.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help install demo view test nightly lint format types site bench gpu-pack gpu-rehearsal scenes wheel ci lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 15

install: $(LOCK_ENV) ## install the package and its dependencies into .venv, without development tools

$(LOCK_ENV): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is required, but $(PYTHON) is older; use make PYTHON=python3.x")'
	@echo "Installing into $(VENV): about 1.3 GB, one to three minutes, with no output until it is done"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

$(EXTRAS_ENV): $(LOCK_ENV) requirements-extras.lock
	@echo "Installing the extras and the development tools into $(VENV): about 0.7 GB more"
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock -r requirements-extras.lock
	@touch $@

demo: $(LOCK_ENV) ## push the T block around an obstacle to its goal (the first run installs and compiles: two minutes)
	$(BIN)/oimppi demo --record runs/demo --force

view: $(LOCK_ENV) ## watch the task of `make demo` in a browser, and change the task while it runs
	$(BIN)/oimppi view task02 --start 1

test: $(EXTRAS_ENV) ## run the tests on all cores
	$(BIN)/python -m pytest -m "not slow" $(PYTEST_FLAGS)

nightly: $(EXTRAS_ENV) ## run the slow tests: whole episodes with many seeds, and compilation of the kernels for GPUs
	$(BIN)/python -m pytest -m slow $(PYTEST_FLAGS)

lint: $(EXTRAS_ENV) ## run ruff, and check the import rules between the packages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

format: $(EXTRAS_ENV) ## format and fix the code with ruff
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(EXTRAS_ENV) ## check types with pyright
	$(BIN)/pyright --pythonpath $(BIN)/python

site: $(EXTRAS_ENV) ## build the documentation site in build/site; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet --config-file tools/site/mkdocs.yml

bench: $(LOCK_ENV) ## measure the planning time of each stage
	$(BIN)/python tools/bench_plan.py

gpu-pack: $(LOCK_ENV) ## pack the files that tools/gpu_check.py needs on a GPU machine without a package registry (15 minutes)
	$(BIN)/python tools/gpu_pack.py

gpu-rehearsal: $(LOCK_ENV) ## rehearse tools/gpu_check.py with an emulated GPU and a fresh Python 3.12 (PYTHON312=...)
	$(BIN)/python tools/gpu_rehearsal.py --python $(PYTHON312)

scenes: $(LOCK_ENV) ## write the shipped scenes again
	$(BIN)/python tools/make_scenes.py

wheel: $(EXTRAS_ENV) ## build a wheel from the source distribution and test it in a separate environment
	$(BIN)/python tools/check_wheel.py

ci: ## run all steps of the continuous integration locally
	.ci/run

lock: ## update the dependency locks (needs uv)
	$(COMPILE) --group build pyproject.toml -o requirements.lock
	$(COMPILE) $(LOCKED_EXTRAS:%=--extra %) -c requirements.lock pyproject.toml -o requirements-extras.lock \
		$$(sed -n "/== 'win32'/!s/^\([a-z0-9-]*\)==.*/--no-emit-package \1/p" requirements.lock)

clean: ## remove build products and caches, except .venv
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find oimppi_warp kernels tests tools -name __pycache__ -type d -prune -exec rm -rf {} +
