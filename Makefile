# Two commands matter: `make demo` (the whole pipeline, ends in an HTML report) and `make test`.
# Each builds .venv first; the stamp file makes that happen again when the dependencies change.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OUT ?= out/demo

# Blender's Cycles, an independent path tracer to compare with: 370 MB, GPL, in an environment of its own.
PYTHON_CYCLES ?= python3.11
CYCLES := .venv-cycles

.PHONY: docs train evaluate validation bench demo test test-all lint format setup cycles clean

demo: $(READY)
	$(BIN)/sfsnet-dr demo --out $(OUT)

test: $(READY)
	$(BIN)/python -m pytest -m "not slow"

test-all: $(READY)
	$(BIN)/python -m pytest

# All stages of training in under half an hour on 2 cores; without PHOTOGRAPHS=DIR rendered faces stand in for
# them. The same call goes on where it was stopped. STAGES=training/full.toml is the paper's size.
STAGES ?= training/small.toml
train: $(READY)
	$(BIN)/sfsnet-dr train-all $(STAGES) --out out/$(basename $(notdir $(STAGES))) \
	  $(if $(PHOTOGRAPHS),--photographs $(PHOTOGRAPHS),--rendered-photographs) \
	  $(if $(DATA),--data $(DATA)) $(if $(ENVIRONMENTS),--environments $(ENVIRONMENTS))

# All validation scenes, and the stored results that README quotes; about three quarters of an hour on 2 cores.
validation: $(READY)
	$(BIN)/sfsnet-dr validate --scene all --out out/validation
	cp out/validation/records.json eval/results/validate.json
	cp out/validation/errors.csv eval/results/validate.csv
	cp out/validation/head/pareto.png eval/results/pareto.png
	$(BIN)/sfsnet-dr stability --out out/stability
	cp out/stability/records.json eval/results/stability.json

# Speed of the factory (alone on the machine: minutes) and its truth (half an hour); ENVIRONMENTS=DIR adds maps.
bench: $(READY)
	$(BIN)/sfsnet-dr bench synth --out out/bench-synth
	cp out/bench-synth/records.json eval/results/synth.json
	$(BIN)/sfsnet-dr bench relight --out out/bench-relight $(if $(ENVIRONMENTS),--environments $(ENVIRONMENTS))
	cp out/bench-relight/records.json eval/results/relight.json

# Every method on all data below DATA, which is a folder of Extended Yale B, of photographs with landmarks, of CelebA
# or Photoface, or of such folders; FACES="DIR ..." adds rendered faces that lie elsewhere, LANDMARKS=FILE what a detector found on
# photographs that have no landmarks beside them (for 3dmm); QUICK=1 takes minutes.
evaluate: $(READY)
	@test -n "$(DATA)" || { echo "make evaluate: DATA=DIR is needed, a folder of faces" >&2; exit 2; }
	$(BIN)/sfsnet-dr evaluate all $(DATA) $(if $(WEIGHTS),--weights $(WEIGHTS)) $(if $(FACES),--faces $(FACES)) \
	  $(if $(LANDMARKS),--landmarks $(LANDMARKS)) $(if $(QUICK),--quick) --out out/evaluate

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The pages of docs/, into docs/_build/html; no network, warnings are errors.
docs: $(READY)
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "$(PYTHON) is `$(PYTHON) --version 2>/dev/null || echo missing`; Python 3.11 or later is needed:" \
	    "make PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

cycles: $(CYCLES)/.ready

$(CYCLES)/.ready: constraints-cycles.txt
	@$(PYTHON_CYCLES) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || { \
	  echo "$(PYTHON_CYCLES) is `$(PYTHON_CYCLES) --version 2>/dev/null || echo missing`; bpy needs exactly" \
	    "Python 3.11: make cycles PYTHON_CYCLES=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON_CYCLES) -m venv $(CYCLES)
	$(CYCLES)/bin/python -m pip install --disable-pip-version-check -c constraints-cycles.txt bpy
	@$(CYCLES)/bin/python -c 'import bpy' || { echo "bpy is installed but does not start; on Debian it needs:" \
	    "apt install libgl1 libsm6 libice6 libx11-6 libxext6 libxfixes3 libxi6 libxrender1 libxkbcommon0" >&2; \
	    exit 1; }
	@touch $@

clean:
	rm -rf $(VENV) $(CYCLES) out build dist *.egg-info
