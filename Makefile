# Two commands do all, on a machine with python3 (≥ 3.11), make, gcc and git: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: setup demo test readme test-lowest fuzz lint clean-demo

setup: $(READY)

$(READY): requirements.lock pyproject.toml setup.py
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "grabnet needs Python 3.11 or newer; name one with make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

# Trains both networks on the open data, then samples grasps for objects that they never saw. Stopped half-way, it goes
# on from there; `make clean-demo` starts it over.
DEMO := runs/demo
UNSEEN := mug wineglass camera binoculars fryingpan toothpaste
comma := ,
empty :=

demo: $(DEMO)/coarsenet/model.safetensors $(DEMO)/refinenet/model.safetensors
	$(BIN)/python scripts/sample.py n=20 output=$(DEMO)/grasps model=$(DEMO) \
	  mesh=[$(subst $(empty) $(empty),$(comma),$(UNSEEN:%=data/open/tools/object_meshes/contact_meshes/%.ply))]

$(DEMO)/refinenet/model.safetensors: | $(DEMO)/coarsenet/model.safetensors
$(DEMO)/%/model.safetensors: | $(READY)
	$(BIN)/python train.py experiment=demo_$* run_dir=$(@D)

test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile

# Runs every command of README.md as printed, for a minute at most each: half an hour.
readme: setup
	$(BIN)/python tests/readme.py

# With the oldest versions that pyproject.toml allows, in an environment of its own: kernels and geometry, sampling,
# files written, training steps, measures of grasps, command lines.
LOWEST := .venv-lowest
TESTS_LOWEST := tests/geometry tests/models tests/losses tests/visual tests/physics tests/evaluation/protocols \
  tests/generation/test_export.py tests/generation/test_run.py tests/training/test_run.py tests/cli

test-lowest: $(LOWEST)/.ready
	OMP_NUM_THREADS=1 $(LOWEST)/bin/python -m pytest $(TESTS_LOWEST)

$(LOWEST)/.ready: requirements-lowest.txt pyproject.toml setup.py
	$(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check -r requirements-lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	$(LOWEST)/bin/python -m pip check
	touch $@

# Mutates a small file of every format that is read, 500 times each by default, and prints what ends in neither a value
# nor a sentence; minutes. The seed chooses the mutations.
MUTATIONS := 500
SEED := 0

fuzz: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz $(MUTATIONS) $(SEED)

lint: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean-demo:
	rm -rf runs/demo
