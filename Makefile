# Every target builds .venv/ when it is missing or out of date, and uses nothing else. Needs Python 3.11+ and make.
PYTHON ?= python3
WORKERS ?= 2
ARGS ?=
# Versions to install: a file of pip constraints, or nothing for the newest. build/lowest.txt holds the lowest allowed.
CONSTRAINTS ?= constraints.txt

BIN := .venv/bin
STAMP := .venv/installed
PIP := $(BIN)/python -m pip --disable-pip-version-check
LAYERS := integrity envs agents configs

.DEFAULT_GOAL := help
.PHONY: help dev demo test test-slow check format coverage bench pages wheel kernels release clean

help: ## Say what each target does
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

build/lowest.txt: pyproject.toml
	@mkdir -p $(@D)
	sed -nE 's/^  "(numba|numpy)>=([0-9.]+)",$$/\1==\2/p' $< > $@

$(STAMP): pyproject.toml $(CONSTRAINTS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo 'lanebound needs Python 3.11 or newer: make PYTHON=/path/to/python3.11 ...' >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(PIP) install --quiet $(addprefix -c ,$(CONSTRAINTS)) torch
	$(PIP) install --quiet $(addprefix -c ,$(CONSTRAINTS)) -e '.[dev]'
	mkdir -p .links/lanebound
	for layer in $(LAYERS); do ln -sfn ../../$$layer .links/lanebound/$$layer; done
	touch $@

dev: $(STAMP) ## Install the package, editable, with its tools into .venv/

demo: $(STAMP) ## Compare six drivers and a random one where the sky is bad; tables here, a page in out/demo/report.html
	$(BIN)/lanebound benchmark quick --out out/demo --fresh

test: $(STAMP) ## Run the tests, less the slow ones
	$(BIN)/pytest -q -n $(WORKERS) --dist loadfile $(ARGS)

test-slow: $(STAMP) ## Run the slow tests
	$(BIN)/pytest -q -n $(WORKERS) --dist loadfile -m slow -o faulthandler_timeout=7200 $(ARGS) || [ $$? -eq 5 ] # 5: no test is marked slow

check: $(STAMP) ## Style, types and the order of the layers
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy .links/lanebound
	$(BIN)/lint-imports --no-cache --no-logo

format: $(STAMP) ## Format the code, and correct what ruff can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

coverage: $(STAMP) ## Run the tests and say which lines they reach; a page goes to build/coverage/
	$(BIN)/pytest -q -n $(WORKERS) --dist loadfile --cov --cov-report=term:skip-covered --cov-report=html $(ARGS)

bench: $(STAMP) ## Measure speed against the gates; figures go to build/bench.json
	$(BIN)/lanebound bench $(ARGS)

pages: $(STAMP) ## Mark the pages of results that were made with earlier defaults
	$(BIN)/python tests/helpers/result_pages.py

wheel: $(STAMP) ## Build the wheel into dist/ and test it alone in new environments
	.ci/wheel

kernels: $(STAMP) ## Build a wheel with compiled kernels, for Linux on x86-64, into dist/ and test it
	.ci/kernels

release: $(STAMP) ## Test everything, build the wheel and tag the version of pyproject.toml
	.ci/release

clean: ## Remove what was built and measured; .venv/ stays
	rm -rf build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache .coverage*
	find . -name .venv -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +
