# lf_flame: every target is a thin call of `lf-flame` or of `python -m experiments` (see their --help).
#
#   PRESET            paper (default: the paper's method at its sizes) or smoke (CI)
#   MINUTES           time limit of each call of training, preparation included, 4 by default; the
#                     same command resumes where it ended. 0: to the last epoch
#   BACKBONE_WEIGHTS  imagenet (default), random, or a weights file; see docs/training.md
#   BACKBONE_DEPTH    conv5 (all of ResNet-50), conv4, conv3 or none, instead of the preset's
#   SEED, EPOCHS      instead of the configuration's
#   RUN               folder in runs/ and results/ (default: that of a goal results/RUN/..., or PRESET)

PRESET ?= paper
MINUTES ?= 4
RUN ?= $(firstword $(foreach goal,$(filter results/%,$(MAKECMDGOALS)),$(word 2,$(subst /, ,$(goal)))) \
         $(PRESET)$(if $(SEED),-seed$(SEED)))
PYTHON ?= python3
VENV ?= .venv
WORKERS ?= 0
TEST_JOBS ?= -n auto --dist loadfile --no-loadscope-reorder

BIN := $(VENV)/bin
LF := $(BIN)/lf-flame
EXPERIMENT := $(BIN)/python -m experiments
DATA := data/$(PRESET)
# git ignores data/, runs/ and results/; no target writes the committed results.
RUNS := runs/$(RUN)
RESULTS := results/$(RUN)
REFERENCE := $(wildcard experiments/results/paper experiments/results/paper-*)
# The paper's method forms light fields by tracing rays; `direct` computes the same images sooner.
ROUTE ?= rays
# A value as one word for the shell, whatever is in it.
quoted = '$(subst ','\'',$(1))'
ifneq ($(words $(RUN) $(PRESET)),2)
$(error RUN and PRESET name folders and must be one word each, got "$(RUN)" and "$(PRESET)")
endif
BACKBONE := $(if $(BACKBONE_WEIGHTS),--backbone-weights $(call quoted,$(BACKBONE_WEIGHTS))) \
            $(if $(BACKBONE_DEPTH),--backbone-depth $(BACKBONE_DEPTH))
SEEDED := $(if $(SEED),--seed $(SEED))
TRAINING := --minutes $(MINUTES) $(BACKBONE) $(SEEDED) $(if $(EPOCHS),--epochs $(EPOCHS))

# Each command uses all cores, so one runs at a time.
.NOTPARALLEL:
.PHONY: help install dataset slopes train-shapes train-flame tables scored costs hard-cases effects \
        compare test test-all lint docs FORCE
# The program writes aside and renames: make must not remove what a failed command left.
.PRECIOUS: $(DATA)/%.zarr/zarr.json $(RUNS)/%/model.keras $(RESULTS)/%.csv $(RESULTS)/%.json

help:  ## show this list
	@echo 'make TARGET [PRESET=paper|smoke] [MINUTES=4] [BACKBONE_WEIGHTS=...] [BACKBONE_DEPTH=...] [SEED=...] [EPOCHS=...] [RUN=...]'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(VENV)/tools  ## create .venv with lf_flame, all its extras, and the tools for tests and documentation
# Python compiles what it loads, at its first start, in less time than pip takes for everything.
PIP_INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --no-compile --editable
# The tables need half of what tests and documentation need.
$(VENV)/installed: setup.cfg pyproject.toml
	@echo 'Installing into $(VENV): one to five minutes, more on a slow line, once'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) '.[learn]'
	@touch $@
$(VENV)/tools: $(VENV)/installed
	$(PIP_INSTALL) '.[dev]'
	@touch $@

dataset: $(DATA)/flames.zarr/zarr.json $(DATA)/shapes.zarr/zarr.json  ## simulate both data sets
# Whether the network's weights can be had is said before the minutes of a simulation.
TRAINS := $(filter train-shapes train-flame tables scored results/%,$(MAKECMDGOALS))
$(DATA)/%.zarr/zarr.json: data_gen/%.toml | $(VENV)/installed
	$(if $(TRAINS),$(LF) train experiments/$*.toml --preset $(PRESET) $(BACKBONE))
	$(LF) dataset $< --preset $(PRESET) --route $(ROUTE) --workers $(WORKERS) --out $(DATA)/$*.zarr
slopes: $(RESULTS)/slopes.csv  ## print the slopes of sharpest focus beside geometry and paper
	@cat $(RESULTS)/slopes.md
$(RESULTS)/slopes.csv: data_gen/shapes.toml data_gen/flames.toml | $(VENV)/installed
	$(EXPERIMENT) slopes data_gen/shapes.toml data_gen/flames.toml --out $(RESULTS) >/dev/null

train-shapes: $(RUNS)/shapes/model.keras  ## train on the multi-shape data set
train-flame: $(RUNS)/flames/model.keras  ## train on the flame data set
# A training that has not reached its last epoch resumes.
UNFINISHED := $(if $(TRAINS),$(foreach run,shapes flames,$(if $(shell grep -s '"finished": true' \
                $(RUNS)/$(run)/run.json),,$(RUNS)/$(run)/model.keras)))
# So that values other than those of a finished run are refused.
$(UNFINISHED) $(if $(strip $(if $(TRAINS),$(BACKBONE)$(SEED)$(EPOCHS))),$(RUNS)/shapes/model.keras $(RUNS)/flames/model.keras): FORCE
$(RUNS)/%/model.keras: experiments/%.toml $(DATA)/%.zarr/zarr.json | $(VENV)/installed
	$(LF) train $< --preset $(PRESET) --data $(DATA)/$*.zarr --out $(RUNS)/$* $(TRAINING)

# The flames' table first: the shapes take five times as many epochs, of eight times as many samples.
tables: scored $(RESULTS)/table2_baselines.json $(RESULTS)/table1_baselines.json $(RESULTS)/slopes.csv  ## make Tables I and II and Figures 5 to 8, beside the printed values
	@$(EXPERIMENT) tables $(RESULTS) $(REFERENCE) --out $(RESULTS)/tables.md
scored: $(RESULTS)/table2.csv $(RESULTS)/table1.csv
$(RESULTS)/table1.csv: $(RUNS)/shapes/model.keras experiments/paper_values.toml | $(VENV)/installed
	$(EXPERIMENT) evaluate $(RUNS)/shapes --out $(RESULTS)
$(RESULTS)/table2.csv: $(RUNS)/flames/model.keras experiments/paper_values.toml | $(VENV)/installed
	$(EXPERIMENT) evaluate $(RUNS)/flames --out $(RESULTS)
$(RESULTS)/table1_baselines.json: $(DATA)/shapes.zarr/zarr.json experiments/shapes.toml | $(VENV)/installed
	@$(EXPERIMENT) baselines $(DATA)/shapes.zarr experiments/shapes.toml --out $(RESULTS) $(SEEDED) >/dev/null
$(RESULTS)/table2_baselines.json: $(DATA)/flames.zarr/zarr.json experiments/flames.toml | $(VENV)/installed
	@$(EXPERIMENT) baselines $(DATA)/flames.zarr experiments/flames.toml --out $(RESULTS) $(SEEDED) >/dev/null

# What measures time wants an idle machine; more experiments: `python -m experiments --help`.
costs: $(RUNS)/shapes/model.keras $(RUNS)/flames/model.keras | $(VENV)/tools  ## measure what accuracy costs in time: simulation, refocusing
	$(EXPERIMENT) costs --run $(RUNS)
hard-cases: | $(VENV)/tools  ## compute hard cases exactly, by the obvious formula, and by lf_flame
	$(EXPERIMENT) hard-cases
effects: | $(VENV)/tools  ## set every effect beside a reference tracer, and its bound beside random scenes
	$(EXPERIMENT) effects

SYSTEMS := $(patsubst %,$(RUNS)/%/model.keras,aperturenet refocusnet refnet volumetric unet-nine-views)
$(SYSTEMS): $(RUNS)/%/model.keras: experiments/systems.toml data_gen/shapes.toml data_gen/flames.toml | $(VENV)/installed
	$(LF) train-system $* --config $< --preset $(if $(filter smoke,$(PRESET)),smoke,equal-seconds) --out $(RUNS)/$* $(SEEDED)
compare: $(SYSTEMS) $(RUNS)/shapes/model.keras $(RUNS)/flames/model.keras | $(VENV)/tools  ## train all refocusing systems for equal seconds, and compare them
	$(EXPERIMENT) compare $(RUNS)

test: | $(VENV)/tools  ## run the quick tests
	$(BIN)/python -m pytest -m 'not slow' $(TEST_JOBS)
test-all: | $(VENV)/tools  ## run all tests, as CI does
	$(BIN)/python -m pytest $(TEST_JOBS)
lint: | $(VENV)/tools  ## check style and types
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy
docs: | $(VENV)/tools  ## build the documentation site, build/site/index.html; a warning ends it
	MPLBACKEND=agg $(BIN)/python -m sphinx -W --keep-going -q -c docs -d build/doctrees . build/site
	@echo 'The site is $(CURDIR)/build/site/index.html'
