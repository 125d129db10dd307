# The commands of this project. `make` alone explains them.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

# One thread a library: the workers of the service are the parallelism, and timings stay comparable.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

BIN := .venv/bin
PYTHON := $(BIN)/python
STAMP := .venv/.set-up

.PHONY: help setup demo run test test-all lint types generated check bench proto docs format clean

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "make %-10s %s\n", $$1, $$2}'

$(STAMP): pyproject.toml constraints.txt scripts/setup.sh
	@scripts/setup.sh
	@touch $(STAMP)

setup: $(STAMP) ## a virtual environment with everything; the other commands do this themselves

demo: $(STAMP) ## a simulated robot drives through a city; its loops are found and drawn
	$(BIN)/revisit demo

run: $(STAMP) ## the service on this machine: HTTP, gRPC and workers
	$(BIN)/revisit serve

test: $(STAMP) ## the tests, without the slow ones
	$(PYTHON) -m pytest tests -m "not slow" -n 2 --dist loadfile

test-all: $(STAMP) ## every test
	$(PYTHON) -m pytest tests --timeout 7200

lint: $(STAMP) ## style, docstrings, import contracts, proto style
	$(BIN)/ruff check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/buf lint proto

types: $(STAMP) ## mypy --strict
	$(BIN)/mypy

generated: $(STAMP) ## are the committed generated files up to date?
	$(PYTHON) scripts/generated_files.py check

check: lint types generated test ## everything a change must pass

bench: $(STAMP) ## the declared metrics against the committed baseline
	$(BIN)/revisit bench

proto: $(STAMP) ## Python stubs out of proto/
	$(PYTHON) scripts/generated_files.py write proto

docs: $(STAMP) ## the reference pages, openapi.json and the index of the decisions
	$(PYTHON) scripts/generated_files.py write parameters openapi references decisions

format: $(STAMP) ## lay out the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean: ## remove the environment and everything that is made again
	rm -rf .venv build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
