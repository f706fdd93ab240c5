# make demo | test | test-all | lint | docs | wheel | bench NAME=...; the environment in .venv sets itself up.
# The first of these that is there; without any, uv brings one.
PYTHON ?= $(shell for v in 3.11 3.12 3.13; do python$$v -c "" 2>/dev/null && echo python$$v && break; done)
WORKERS ?= 2
NAME ?= --help
BIN := .venv/bin
VENV = $(if $(PYTHON),$(PYTHON) -m venv,$(if $(shell command -v uv),uv venv --quiet --seed --python 3.12,\
	$(info expected Python 3.11, 3.12 or 3.13 on the path, or uv, found none; name one by PYTHON=...)false))
# The constraints ask for torch's CPU build. Where the configured index has none, PyTorch's own one does.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
INSTALL := $(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev,docs]'
# What stays on one worker: tests/conftest.py.
PARALLEL := -n $(WORKERS)
# Material for MkDocs announces its successor on every build.
export NO_MKDOCS_2_WARNING := 1

.PHONY: demo test test-all lint docs wheel bench

demo: .venv/stamp
	$(BIN)/python -m validation.demo

test: .venv/stamp
	$(BIN)/python -m pytest $(PARALLEL)

test-all: .venv/stamp
	$(BIN)/python -m pytest $(PARALLEL) -m ""

lint: .venv/stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: .venv/stamp
	$(BIN)/mkdocs build --strict --quiet
	@echo "site/index.html"

# Built, checked, and installed in an environment of its own, from which the shipped files are read elsewhere.
wheel: build/venv/bin/twine
	rm -rf dist build/installed
	build/venv/bin/python -m build --outdir dist .
	build/venv/bin/twine check --strict dist/*
	$(VENV) build/installed
	build/installed/bin/pip install --quiet --constraint constraints.txt dist/*.whl || \
		build/installed/bin/pip install --quiet --constraint constraints.txt dist/*.whl --extra-index-url $(TORCH_INDEX)
	cd build && installed/bin/python -P ../tests/installed.py

build/venv/bin/twine: pyproject.toml
	$(VENV) build/venv
	build/venv/bin/pip install --quiet build twine
	touch $@

bench: .venv/stamp
	$(BIN)/python -m validation.bench $(NAME) $(if $(filter --help,$(NAME)),,--out docs)

.venv/stamp: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(VENV) .venv
	$(INSTALL) || $(INSTALL) --extra-index-url $(TORCH_INDEX)
	touch $@
