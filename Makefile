# lf_flame: every target is a thin call of `lf-flame` or of `python -m experiments` (see their --help).
#
#   PRESET            paper (default: the paper's method at its sizes), closed-form (our own recipe, a
#                     minute), smoke (CI)
#   MINUTES           of training for each table, 4 by default; the same command again goes on where
#                     it ended. 0: to the last epoch
#   BACKBONE_WEIGHTS  imagenet (default), random, or a weights file; see the README
#   BACKBONE_DEPTH    conv5 (all of ResNet-50), conv4, conv3 or none, instead of the preset's
#   SEED              of training, instead of the configuration's (split, weights, batches, dropout)
#   EPOCHS            instead of the preset's; a run at a constant rate goes on when asked for more
#   RUN               name of the folders for runs and results (default: PRESET, or PRESET-seedSEED).
#                     Use another name to keep results of other weights beside these, e.g.
#                     RUN=paper-conv4

PRESET ?= paper
MINUTES ?= 4
RUN ?= $(PRESET)$(if $(SEED),-seed$(SEED))
PYTHON ?= python3
VENV ?= .venv
WORKERS ?= 0
# Processes that run tests side by side.
TEST_JOBS ?= -n auto --dist loadfile --no-loadscope-reorder

BIN := $(VENV)/bin
LF := $(BIN)/lf-flame
EXPERIMENT := $(BIN)/python -m experiments
# The closed form learns from the images of the paper's method, where it has made none of its own.
DATA := data/$(if $(and $(filter closed-form,$(PRESET)),$(wildcard data/paper/flames.zarr/zarr.json), \
          $(wildcard data/paper/shapes.zarr/zarr.json),$(if $(wildcard data/closed-form),,yes)),paper,$(PRESET))
RUNS := runs/$(RUN)
# A user's results are his own: git ignores data/, runs/ and results/.
RESULTS := results/$(RUN)
# Reference results are committed, and set beside a user's; no target here writes them.
REFERENCE := $(wildcard $(addprefix experiments/results/,paper paper-seed* closed-form closed-form-seed* many))
# The paper's method forms light fields by tracing rays; the same images come straight from a scene.
ROUTE ?= $(if $(filter paper smoke,$(PRESET)),rays,direct)
BACKBONE := $(if $(BACKBONE_WEIGHTS),--backbone-weights $(BACKBONE_WEIGHTS)) \
            $(if $(BACKBONE_DEPTH),--backbone-depth $(BACKBONE_DEPTH))
TRAINING := --minutes $(MINUTES) $(BACKBONE) \
            $(if $(SEED),--seed $(SEED)) $(if $(EPOCHS),--epochs $(EPOCHS))
INSTALLED := $(VENV)/installed
TOOLS := $(VENV)/tools
# GPL-licensed programs of others stay in an environment of their own, and out of ours.
BASELINES := .venv-baselines

# Every target uses all cores, but for those of a moment, most of which is starting programs.
ifeq ($(PRESET),smoke)
MAKEFLAGS += --jobs=2 --output-sync=line
else
.NOTPARALLEL:
endif
.PHONY: help install installs weights dataset slopes train-shapes train-flame tables costs benchmarks baselines
.PHONY: train-aperturenet train-refocusnet train-refnet train-volumetric compare
.PHONY: latency variation scenes ablations pretraining encodings learning-costs test test-all test-jit-off
.PHONY: flames flames-by-networks error-bars viewer-benchmark mutants campaign lint types docs report clean
# The program writes aside and renames, so no file is ever half there, and make must not remove one
# (a data set, say) because a later command failed or Ctrl-C came.
.PRECIOUS: $(DATA)/%.zarr/zarr.json $(RUNS)/%/model.keras $(RESULTS)/%.csv

help:  ## show this list
	@echo 'make TARGET [PRESET=paper|closed-form|smoke] [MINUTES=4] [BACKBONE_WEIGHTS=...] [BACKBONE_DEPTH=...] [SEED=...] [EPOCHS=...] [RUN=...]'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-17s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(TOOLS)  ## create .venv and install lf_flame with all it can use, and tools for tests and documentation
# Python compiles what it loads at its first start, in less time than pip takes for all that there is;
# not where it may not write it down.
PIP_INSTALL = $(BIN)/python -m pip install --disable-pip-version-check \
              $(if $(PYTHONDONTWRITEBYTECODE),,--no-compile) --editable
# The tables need half of what tests and documentation do, in half the time.
$(INSTALLED): setup.cfg pyproject.toml
	@echo 'Installing lf_flame and TensorFlow into $(VENV): one to five minutes, more on a slow line, once'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) '.[learn]'
	@touch $@
$(TOOLS): $(INSTALLED)
	$(PIP_INSTALL) '.[dev]'
	@touch $@

# Before minutes of simulation it is said whether the network's weights can be had.
TRAINS := $(filter train-shapes train-flame tables results/%,$(MAKECMDGOALS))
weights: | $(INSTALLED)  ## look for the backbone's weights, and download them
	$(LF) weights experiments/flames.toml --preset $(PRESET) $(BACKBONE)

dataset: $(DATA)/flames.zarr/zarr.json $(DATA)/shapes.zarr/zarr.json  ## simulate both data sets
$(DATA)/%.zarr/zarr.json: data_gen/%.toml | $(INSTALLED) $(if $(TRAINS),weights)
	$(LF) dataset $< --preset $(PRESET) --route $(ROUTE) --workers $(WORKERS) --out $(DATA)/$*.zarr

slopes: $(RESULTS)/slopes.csv  ## print the slopes of sharpest focus beside geometry and paper
	@cat $(RESULTS)/slopes.md
$(RESULTS)/slopes.csv: data_gen/shapes.toml data_gen/flames.toml | $(INSTALLED)
	$(EXPERIMENT) slopes data_gen/shapes.toml data_gen/flames.toml --out $(RESULTS)

# A training that has not come to its last epoch goes on.
GOES_ON := $(if $(TRAINS),$(foreach run,shapes flames,$(if $(shell grep -s '"finished": true' \
             $(RUNS)/$(run)/run.json),,$(RUNS)/$(run)/model.keras)))
train-shapes: $(RUNS)/shapes/model.keras  ## train on the multi-shape data set
train-flame: $(RUNS)/flames/model.keras  ## train on the flame data set
$(GOES_ON) $(if $(EPOCHS),$(RUNS)/shapes/model.keras $(RUNS)/flames/model.keras): FORCE
$(RUNS)/%/model.keras: experiments/%.toml $(DATA)/%.zarr/zarr.json | $(INSTALLED)
	$(LF) train $< --preset $(PRESET) --data $(DATA)/$*.zarr --out $(RUNS)/$* $(TRAINING)
FORCE:

# The paper's method first, the flames' table before that of the shapes, which takes five times as many
# epochs of eight times as many samples; then the closed form, which takes a minute.
SOLVED := $(if $(filter paper,$(PRESET)),$(if $(filter paper%,$(RUN)),$(RUN:paper%=closed-form%),$(RUN)-closed-form))
tables: scored $(RESULTS)/slopes.csv  ## make Tables I and II and Figures 7 and 8, by the paper's method and in closed form
	$(if $(SOLVED),@$(MAKE) --no-print-directory scored PRESET=closed-form RUN=$(SOLVED) BACKBONE_DEPTH= EPOCHS=)
	@$(EXPERIMENT) tables $(RESULTS) $(addprefix results/,$(SOLVED)) $(REFERENCE) --out $(RESULTS)/tables.md
.PHONY: scored
scored: $(RESULTS)/table2.csv $(RESULTS)/table1.csv
$(RESULTS)/table1.csv: $(RUNS)/shapes/model.keras experiments/paper_values.toml | $(INSTALLED)
	$(EXPERIMENT) evaluate $(RUNS)/shapes --table table1 --figure figure7 --out $(RESULTS)
$(RESULTS)/table2.csv: $(RUNS)/flames/model.keras experiments/paper_values.toml | $(INSTALLED)
	$(EXPERIMENT) evaluate $(RUNS)/flames --table table2 --figure figure8 --out $(RESULTS)

# The run of the paper's own recipe, where there is one, stands beside others.
PAPERS_NETWORK = $(patsubst %/model.keras,%,$(wildcard runs/paper/flames/model.keras))

# Refocusing systems learn from the same training samples, with objects at new depths in every light field.
train-aperturenet: $(patsubst %,$(RUNS)/%/model.keras,aperturenet aperturenet-low-light aperturenet-round)  ## train ours: nine aligned views, in full and in low light, for a square and a round aperture
train-refocusnet: $(RUNS)/refocusnet/model.keras  ## train RefocusNet: four aligned views
train-refnet: $(patsubst %,$(RUNS)/%/model.keras,refnet refnet-fourier)  ## train RefNet, in our reading, on shift-and-sum and on the Fourier slice
train-volumetric: $(RUNS)/volumetric/model.keras  ## train the U-Net behind a cross of 17 views
SYSTEMS := $(patsubst %,$(RUNS)/%/model.keras,aperturenet aperturenet-low-light aperturenet-round refocusnet refnet refnet-fourier volumetric)
$(SYSTEMS): $(RUNS)/%/model.keras: experiments/systems.toml data_gen/shapes.toml data_gen/flames.toml | $(INSTALLED)
	$(LF) train-system $* --config experiments/systems.toml --preset $(if $(filter smoke,$(PRESET)),smoke,equal-seconds) --out $(RUNS)/$* $(if $(SEED),--seed $(SEED))
COMPARE := results/compare$(if $(filter closed-form,$(RUN)),,-$(RUN))
# PHOTOGRAPHS='--photograph FOLDER -1,0,1', REFOCUSNET_WEIGHTS=FILE (the authors') where at hand;
# what `make encodings` has trained is there to be compared, but for what is as the paper's.
VARIANTS = $(patsubst %/model.keras,--variant %,$(filter-out %/raw/model.keras,$(wildcard runs/studies/encodings_flames/*/model.keras runs/paper/*/model.keras)))
compare: $(SYSTEMS) $(RUNS)/shapes/model.keras $(RUNS)/flames/model.keras | $(TOOLS)  ## set all refocusing systems side by side (idle machine)
	$(EXPERIMENT) compare $(RUNS) --out $(COMPARE) $(PHOTOGRAPHS) $(VARIANTS) \
	  $(if $(REFOCUSNET_WEIGHTS),--refocusnet-weights $(REFOCUSNET_WEIGHTS))

# Records of one command without options, into the results folder of that name.
RECORDS := bounds dataset-making effects hard-cases screenshots slope-maps system-scenes
.PHONY: $(RECORDS)
bounds:  ## hold the bounds of the effect plan against random scenes (half an hour)
dataset-making:  ## measure how fast data sets are made (idle machine)
effects:  ## set every effect beside a reference tracer
hard-cases:  ## compute hard cases exactly, by the obvious formula, and by lf_flame
screenshots:  ## take the pictures of the viewer for the documentation (needs Chromium, JupyterLab)
slope-maps:  ## set slope maps beside the truth and simpler ones
system-scenes:  ## measure refocusing systems against the number of light fields to learn from
$(RECORDS): | $(TOOLS)
	$(EXPERIMENT) $@

flames: | $(TOOLS)  ## measure how well emission by depth is found, beside simple rivals
	$(EXPERIMENT) emission --out results/tomography
	$(EXPERIMENT) rivals --out results/tomography
	$(EXPERIMENT) soot --out results/tomography

error-bars: | $(TOOLS)  ## count how often error bars of emission by depth hold the truth
	$(EXPERIMENT) emission --bars 10 --out results/tomography

flames-by-networks: $(RUNS)/flames/model.keras | $(TOOLS)  ## take the planes of the paper's network for sections of flames
	$(EXPERIMENT) emission --out results/tomography \
	  $(foreach run,$(RUNS)/flames $(PAPERS_NETWORK),--network $(run))

costs: learning-costs latency | $(TOOLS)  ## measure what accuracy costs in time: simulation, refocusing, learning (idle machine)
	$(EXPERIMENT) costs --run $(RUNS) --out results/costs

latency: $(RUNS)/shapes/model.keras $(RUNS)/flames/model.keras | $(TOOLS)  ## time the trained networks on one picture
	$(EXPERIMENT) latency $(RUNS)/shapes $(RUNS)/flames $(PAPERS_NETWORK) --out results/costs

# Each study goes on where it was cut off; what is done is not done again.
STUDY = $(EXPERIMENT) study experiments/studies/$*.toml --work runs/studies \
        $(if $(filter-out imagenet random,$(BACKBONE_WEIGHTS)),--imagenet $(BACKBONE_WEIGHTS))
variation: variation_shapes.study variation_flames.study  ## measure PSNR and SSIM against how much the scenes vary
scenes: scenes_shapes.study scenes_flames.study  ## measure PSNR and SSIM against the number of scenes to learn from (two hours and 20 GB: LF_FLAME_MEMORY_GB=18)
ablations: ablations_shapes.study ablations_flames.study  ## measure what each part of the recipes does
pretraining: pretraining_flames.study dropout_flames.study  ## measure what ImageNet's weights do, and the dropout (BACKBONE_WEIGHTS=FILE where offline)
encodings: encodings_flames.study  ## measure what the network learns from other inputs, and ask it for other depths
	$(EXPERIMENT) depth-test $(PAPERS_NETWORK) \
	  $$(dirname runs/studies/encodings_flames/*/model.keras) --out results/depth_test
learning-costs: STUDY_OUT = results/costs
learning-costs: learning_costs.study  ## measure what accuracy costs in time, for learning
STUDY_OUT = results/studies
%.study: | $(TOOLS)
	$(STUDY) --out $(STUDY_OUT)

benchmarks: | $(TOOLS)  ## measure speed against baselines, on an idle machine (see baselines)
	$(BIN)/python -m experiments.benchmarks.speed --out results/benchmarks
	$(BIN)/python -m experiments.benchmarks.starting --out results/benchmarks
	$(BIN)/python -m experiments.benchmarks.busy --out results/benchmarks
	$(BIN)/python -m experiments.benchmarks.busy --out results/benchmarks --passive
	$(BIN)/python -m experiments.benchmarks.refocusing --out results/benchmarks \
	  $(if $(wildcard $(BASELINES)/installed),--baselines $(BASELINES)/bin/python)
	$(BIN)/python -m experiments.benchmarks.decoding --out results/benchmarks \
	  $(if $(wildcard $(BASELINES)/installed),--baselines $(BASELINES)/bin/python)
	$(BIN)/python -m experiments.benchmarks.reconstructing --out results/benchmarks
	$(BIN)/python -m experiments.benchmarks.training --out results/benchmarks

viewer-benchmark: | $(TOOLS)  ## time the page of the viewer in a browser (needs Chromium, idle machine)
	$(BIN)/python -m experiments.benchmarks.viewer --out results/benchmarks

installs: | $(TOOLS)  ## install in new environments, with the oldest versions too, and test there (OTHER_PYTHONS=...)
	$(BIN)/python -m experiments.benchmarks.installing --out results/benchmarks $(addprefix --python ,$(OTHER_PYTHONS))

baselines: $(BASELINES)/installed  ## install other refocusing programs apart, for benchmarks (Python 3.11)
$(BASELINES)/installed: experiments/benchmarks/baselines.txt
	$(PYTHON) -m venv $(BASELINES)
	$(BASELINES)/bin/python -m pip install --disable-pip-version-check --no-deps -r $<
	@touch $@

report: | $(INSTALLED)  ## write a report of results as one HTML file (FOLDER=...; default: those of RUN)
	$(LF) report $(or $(FOLDER),$(RESULTS)) --out $(or $(FOLDER),$(RESULTS))/report.html

docs: | $(TOOLS)  ## build the documentation site, build/site/index.html; a warning ends it
	MPLBACKEND=agg $(BIN)/python -m sphinx -W --keep-going -q -c docs -d build/doctrees . build/site
	@echo 'The site is $(CURDIR)/build/site/index.html'

test: | $(TOOLS)  ## run the tests that a change should pass before it is committed (some minutes)
	$(BIN)/python -m pytest -m 'not slow' $(TEST_JOBS)

test-all: | $(TOOLS)  ## run all tests, as CI does
	$(BIN)/python -m pytest $(TEST_JOBS)

test-jit-off: | $(TOOLS)  ## run the kernels' tests as plain Python
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest tests/_common/test_threads.py tests/simulation/test_kernels.py tests/simulation/test_polygons.py tests/projection tests/refocus/test_shift.py -m 'not jit'

# MUTANTS names a package of lf_flame, or a file of it; its tests are those of the folder, or of the file, of
# that name, or TESTS. EVERY=20 plants one error of twenty. A copy of the checkout is changed, never the
# checkout itself; where it was stopped it goes on.
MUTANTS ?= optics
EVERY ?= 1
TESTS ?= $(or $(wildcard tests/$(dir $(MUTANTS))test_$(notdir $(MUTANTS))),tests/$(firstword $(subst /, ,$(MUTANTS))))
MUTATED := results/mutants/$(subst /,-,$(MUTANTS))-$(EVERY)
SESSION := $(MUTATED)/session.sqlite
IN_MUTATED := cd $(MUTATED) && export PATH=$(abspath $(BIN)):$$PATH PYTHONPATH=$$PWD &&
COPY := git ls-files -z | grep -zv ^experiments/results | xargs -0 cp --parents -t $(MUTATED)
mutants: $(SESSION)  ## plant small errors in a package, one at a time, and list those that its tests do not notice
	$(COPY)
	$(IN_MUTATED) cosmic-ray exec mutants.toml session.sqlite
	$(IN_MUTATED) cr-report session.sqlite --surviving-only --show-diff && cr-rate session.sqlite
MUTABLE := $(wildcard lf_flame/$(MUTANTS) lf_flame/$(MUTANTS)/*.py lf_flame/$(MUTANTS)/*/*.py)
$(SESSION): tests/mutants.toml $(filter %.py,$(MUTABLE)) | $(TOOLS)
	$(PIP_INSTALL) '.[mutants]' --quiet
	rm -rf $(MUTATED) && mkdir -p $(MUTATED)
	$(COPY)
	sed 's:MUTANTS:$(MUTANTS):; s:TESTS:$(TESTS):' tests/mutants.toml > $(MUTATED)/mutants.toml
	$(IN_MUTATED) cosmic-ray baseline mutants.toml && cosmic-ray init mutants.toml new.sqlite && \
	  python -c 'import sqlite3; sqlite3.connect("new.sqlite", isolation_level=None).execute( \
	    "DELETE FROM work_items WHERE rowid % $(EVERY)")' && \
	  cr-filter-operators new.sqlite mutants.toml && mv new.sqlite session.sqlite

# CAMPAIGN=--quick for some minutes, CAMPAIGN="-k simulate" or "-k kills" for some cases, "--seed 2" for
# other draws.
campaign: | $(TOOLS)  ## try to lose files, to hang and to break every command, and count (an hour)
	$(BIN)/python -m pytest $(addprefix tests/campaigning/,outputs.py inputs.py videos.py) -n auto -o timeout=7200 \
	  --report results/campaign/campaign.md $(CAMPAIGN)

lint: | $(TOOLS)  ## check style with ruff
	$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: | $(TOOLS)  ## check types with mypy
	$(BIN)/mypy

clean:  ## remove caches; data sets, runs and results stay
	rm -rf build docs/generated *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
