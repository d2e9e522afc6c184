# Every target sets up .venv by itself: `make train` and `make test` work on a fresh clone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
NATIVE := $(shell find appl_dist -name '*.c' -o -name '*.cpp' -o -name '*.h') appl_dist/native/CMakeLists.txt
ARGS ?=

.PHONY: train test lint bench asan clean venv

venv: $(VENV)/.installed

$(VENV)/.requirements: requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

$(VENV)/.installed: $(VENV)/.requirements pyproject.toml $(NATIVE)
	$(BIN)/pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	touch $@

train: venv
	$(BIN)/appl-dist train $(ARGS)

test: venv
	$(BIN)/python -m pytest $(ARGS)

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) build build-asan .pytest_cache .mypy_cache .ruff_cache .hypothesis
