# Two commands on a fresh machine: `make demo` and `make test`. Nothing before them but Python >= 3.11 and make.
# Each builds .venv by itself and installs again only after pyproject.toml has changed.

VENV := .venv
BIN := $(VENV)/bin
OUT := out

.DEFAULT_GOAL := help
.PHONY: help demo docs test lint format typecheck ci clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):[^#]*## /  make \1\t/' | expand -t 20

demo: $(VENV)/.run  ## the main job: paper-simulation, 1637 x 1637, Gray + phase; report in out/demo
	$(BIN)/optolever demo --out $(OUT)/demo --json $(OUT)/demo/demo.json

docs: $(VENV)/.docs  ## the pages, as HTML in out/docs
	$(BIN)/python docs/figures.py docs/_figures
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs $(OUT)/docs

# One thread of BLAS a worker: on busy cores a second one waits, a third of the CPU time of some files.
MARKS = "not slow"
test: $(VENV)/.dev  ## the tests of every day, on all cores; MARKS= all of them, MARKS=slow the others
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m $(or $(MARKS),"")

lint: $(VENV)/.dev  ## ruff: rules and format
	$(BIN)/ruff check
	$(BIN)/ruff format --check

format: $(VENV)/.dev  ## ruff: mend what it can, format
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

typecheck: $(VENV)/.dev  ## mypy --strict
	$(BIN)/mypy

ci:  ## what CI runs
	bash .ci/run

clean:  ## remove what was made here, the environment included
	rm -rf $(VENV) $(OUT) docs/_figures build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache

# The first Python on PATH that is new enough; `make PYTHON=/path/to/python ...` names another.
PYTHON ?= $(shell for name in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$name -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$name && break; done)

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "make: no Python >= 3.11 on PATH; install one or say make PYTHON=/path/to/python" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "make: $(PYTHON) -m venv failed; on Debian: apt-get install python3-venv" >&2; exit 1; }

# Without --no-compile pip makes bytecode of all modules for 10 s; Python does so for those that it imports.
$(VENV)/.run: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --no-compile --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[dev]'
	@touch $@ $(VENV)/.run

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[docs]'
	@touch $@ $(VENV)/.run
