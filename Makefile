# make demo | test | test-all | lint; the environment in .venv sets itself up.
PYTHON ?= python3.11
BIN := .venv/bin
# The constraints ask for torch's CPU build. Where the configured index has none, PyTorch's own one does.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
INSTALL := $(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'

.PHONY: demo test test-all lint

demo: .venv/stamp
	$(BIN)/python -m validation.demo

test: .venv/stamp
	$(BIN)/python -m pytest

test-all: .venv/stamp
	$(BIN)/python -m pytest -m "slow or not slow"

lint: .venv/stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

.venv/stamp: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(INSTALL) || $(INSTALL) --extra-index-url $(TORCH_INDEX)
	touch $@
