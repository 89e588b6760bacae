PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
DEMO ?= demo
INPUT ?=

.DEFAULT_GOAL := help
.PHONY: help demo test check fmt test-heavy test-faults fuzz fuzz-coverage benchmark lock

help:                ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*##\(.*\)/\1\t\2/p' $(MAKEFILE_LIST) | expand -t 14

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,sql]'
	touch $@

demo: $(STAMP)       ## simulate a small collection (or take INPUT=DIR), run the whole chain, say how good it is
	$(BIN)/python -m pipelines.demo $(DEMO) $(if $(INPUT),--input $(INPUT))

test: check          ## checks and the test suite
	$(BIN)/pytest -n 2

check: $(STAMP)      ## format, lint, types, import contract
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

fmt: $(STAMP)        ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

test-faults: $(STAMP) ## every fault of tests/run/README.md in its long form: two hours (moto is installed here)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt 'moto[server]==5.2.5'
	$(BIN)/pytest -s -v -m 'heavy or not heavy' tests/run tests/collection

test-heavy: $(STAMP) ## the tests that take minutes
	$(BIN)/pytest -m heavy

fuzz: $(STAMP)       ## feed a million broken files to every reader
	$(BIN)/python tests/formats/fuzz_formats.py --mutations 1000000

fuzz-coverage: $(STAMP) ## the same, steered by coverage (needs atheris, installed here)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt atheris==3.0.0
	$(BIN)/python tests/formats/fuzz_coverage.py -runs=1000000 -max_len=65536 -artifact_prefix=.venv/fuzz-

benchmark: $(STAMP)  ## accuracy and CPU seconds against bounds, part by part (minutes)
	for part in formats calibration demultiplex storage disparity reconstruct collection; do $(BIN)/python benchmarks/$$part.py || exit 1; done

lock: $(STAMP)       ## write constraints.txt from what is installed
	$(BIN)/python -m pip freeze --exclude-editable > constraints.txt
