# Needs Python 3.11 or newer, make and a package index. Everything is installed into .venv, again when pyproject.toml changes.
#   make demo PYTHON=python3.12     another interpreter (before .venv exists)
#   make bench BENCH_ARGS=--quick   arguments for the benchmarks

PYTHON ?= python3
JOBS ?= 2
BENCH_ARGS ?=

BIN := .venv/bin
DEV := .venv/.installed-dev
DOCS := .venv/.installed-docs
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

export NO_MKDOCS_2_WARNING := 1

.DEFAULT_GOAL := help
.PHONY: help demo test paper proof robots check lint test-slow test-all docs bench clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(firstword $(MAKEFILE_LIST)) | expand -t 12

demo: $(DEV) ## simulate, fit and diagnose the examples that ship with the package; reports in demo-out/
	$(BIN)/gtr demo -o demo-out

paper: $(DEV) ## reproduce the paper into paper-out/, and write its page of the docs again
	$(BIN)/python -m benchmarks.paper -o paper-out
	mkdir -p docs/paper
	cp paper-out/paper.md docs/
	cp paper-out/paper/*.png docs/paper/

proof: $(DEV) ## the blind benchmark of the diagnosis, into proof-out/ (hours; resumes), and its page of the docs
	$(BIN)/python -m benchmarks.blind --family rig -o proof-out --jobs $(JOBS)
	$(BIN)/python -m benchmarks.blind --family left-out -o proof-out --jobs $(JOBS)
	$(BIN)/python -m benchmarks.blind --family combined -o proof-out --jobs $(JOBS)
	$(BIN)/python -m benchmarks.blind -o proof-out --jobs $(JOBS)
	mkdir -p docs/proof
	cp proof-out/proof.md docs/
	cp proof-out/proof/* docs/proof/

robots: $(DEV) ## fit the real robots of examples/robots, and write their pages of the docs (half an hour)
	$(BIN)/python -m examples.robots.tentacle
	$(BIN)/python -m examples.robots.wrists
	$(BIN)/python -m examples.robots.giraffe

test: $(DEV) ## the fast tests
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal --durations=20

check: lint test-all docs ## linters, types, every test, docs; CI runs a quarter of the slow tests

lint: $(DEV) ## ruff and pyright
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright --pythonpath $(BIN)/python

test-all: $(DEV)
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "slow or not slow"

test-slow: $(DEV) ## only the slow tests; PART=2/4 is the second of four parts of them
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal --durations=40 -m slow $(if $(PART),--part $(PART))

docs: $(DOCS) ## build the documentation into site/
	$(BIN)/mkdocs build --strict

bench: $(DEV) ## run the benchmarks
	$(BIN)/python -m benchmarks $(BENCH_ARGS)

clean: ## remove the environment and everything built
	rm -rf .venv build dist site demo-out paper-out proof-out *.egg-info .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +

$(DEV): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("gtr-jax needs Python 3.11 or newer: make PYTHON=/path/to/python3.11")'
	@echo 'setting up .venv (once; again when pyproject.toml changes)'
	@$(PYTHON) -m venv .venv
	$(PIP) -e '.[dev]'
	@touch $@

$(DOCS): $(DEV)
	$(PIP) -e '.[docs]'
	@touch $@
