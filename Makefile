# The commands of this project. `make` alone explains them.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

# One thread a library: the workers of the service are the parallelism, and timings stay comparable.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
# Processes that the tests start share what the first of them has compiled, wherever the caller says otherwise.
test test-unit test-all: export PYTHONDONTWRITEBYTECODE :=

BIN := .venv/bin
PYTHON := $(BIN)/python
STAMP := .venv/.set-up
COMPILE := from revisit.service.adapters.core_recogniser import load_recogniser as load; load()

.PHONY: help setup demo run test test-unit test-all lint types generated check bench proto docs site wheel sbom format clean

help: ## list these commands
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "make %-10s %s\n", $$1, $$2}'

$(STAMP): pyproject.toml constraints.txt scripts/setup.sh
	@scripts/setup.sh
	@touch $(STAMP)

setup: $(STAMP) ## install everything into .venv (the other commands do so themselves)

demo: $(STAMP) ## drive two simulated robots through a town; show and draw the loops that the service finds
	$(BIN)/revisit demo

run: $(STAMP) ## run the service on this machine: HTTP, gRPC and workers
	$(BIN)/revisit serve

# A clean checkout has no compiled kernels: they are compiled once, beside the first tests, which need none.
test: $(STAMP) ## run the tests, without the slow ones
	$(PYTHON) -c '$(COMPILE)' & \
	$(PYTHON) -m pytest tests -m "not slow" -n 3 --dist loadfile --no-loadscope-reorder

# Those of tests/unit that take a moment each; `pytest @file` reads the names of the others from tests/unit/long.txt.
test-unit: $(STAMP) ## run the short unit tests of core, service and SDK, while you work: a minute on two cores
	$(PYTHON) -m pytest $(addprefix tests/unit/,area core formats ros sdk service support) -m "not slow" -n 2 @tests/unit/long.txt

test-all: $(STAMP) ## run every test, in full size, and hold promises of time: for a machine that does nothing else
	REVISIT_TEST_TIMES=1 REVISIT_SCHEMATHESIS_EXAMPLES=60 REVISIT_GRPC_EXAMPLES=40 REVISIT_FUZZ_EXAMPLES=100 \
	REVISIT_MACHINE_EXAMPLES=8 REVISIT_LOOP_EXAMPLES=12 $(PYTHON) -m pytest tests --timeout 7200
	REVISIT_TEST_STATE=postgres $(PYTHON) -m pytest @tests/support/on_postgres.txt --timeout 7200

lint: $(STAMP) ## check style, docstrings, import contracts and the protocol files
	$(BIN)/ruff check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/buf lint proto

types: $(STAMP) ## check types: mypy --strict
	$(BIN)/mypy

generated: $(STAMP) ## check that the committed generated files are up to date
	$(PYTHON) scripts/generated_files.py check

check: lint types generated test ## run everything that a change must pass

bench: $(STAMP) ## measure the product and compare with the committed baseline
	$(BIN)/revisit bench --check

proto: $(STAMP) ## write the Python stubs of proto/
	$(PYTHON) scripts/generated_files.py write proto resources

docs: $(STAMP) ## write the reference pages, openapi.json and the index of the decisions
	$(PYTHON) scripts/generated_files.py write parameters openapi references async decisions

site: $(STAMP) ## build the documentation as a website in build/site; search works offline
	$(PYTHON) scripts/site.py

wheel: $(STAMP) ## build the wheel with compiled kernels, for this Python and any x86-64-v3 processor: build/wheel
	find core revisit/formats -name '*.nb[ci]' -delete
	$(PYTHON) -c '$(COMPILE)'
	$(PYTHON) -m pip wheel -q --no-deps --no-build-isolation -w build/wheel .

sbom: $(STAMP) ## write the bill of materials of the service with its pinned dependencies: out/sbom.cdx.json
	$(PYTHON) -m venv --clear build/service && build/service/bin/pip install -q -c constraints.txt '.[service]'
	$(PYTHON) scripts/sbom.py out/sbom.cdx.json build/service/bin/python

format: $(STAMP) ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean: ## remove .venv and everything else that can be made again
	rm -rf .venv build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
