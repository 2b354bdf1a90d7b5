# make demo    set up, then the whole chain on drawer-open, ending in runs/demo/report.html
# make demo-quick    the same at a tenth of its size, in two minutes or so; its agent has not learnt anything
# make test    set up, then all tests
# make test-browser    set up with Chromium, then the tests that look at the viewer in it
# make paper   set up, then the paper's experiments (hours); ends in the tables of docs/results/paper.md
# make docs    set up, then the documentation as a site; ends in site/index.html
# Other verbs: setup, format, check, build, clean. Set-up is done once, and again when pyproject.toml changes.

SHELL := /bin/sh
BIN := .venv/bin
READY := .venv/ready-$(firstword $(shell cksum pyproject.toml))

# What `make demo` writes, and keys of its stages that differ from its recipes
DEMO := demo
DATA := data/$(DEMO)
ENCODER := runs/$(DEMO)/encoder
AGENT := runs/$(DEMO)/agent
REPORT := runs/$(DEMO)/report.html
DATA_KEYS :=
# Two thirds of the recipe's training, so that the demo is over in twelve minutes; ENCODER_BUDGET= trains to the end
ENCODER_BUDGET := --steps 2000 --max_minutes 4.75
ENCODER_KEYS :=
# The recipe's training; it is evaluated less often than the recipe asks for
AGENT_EVALUATION := --evaluation_every 10000 --evaluation_episodes 10 --final_evaluation_episodes 20
AGENT_KEYS :=
REPORT_KEYS :=

.PHONY: help setup demo demo-quick paper format check docs test test-browser build clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# //p' Makefile | head -7

setup: $(READY)

$(READY):
	@start=$$(date +%s) && sh tools/install/system_libraries.sh && sh tools/install/environment.sh && \
		rm -f .venv/ready-* && touch $@ && echo "setup: done in $$(($$(date +%s) - start)) s"

# A stage of the demo is done when its summary.json exists; one that was interrupted goes on where it stopped. A report
# that is older than a stage is written anew.
# $(call stage,name,arguments) runs a command of nerf-rl and prints how long it took.
define stage
@start=$$(date +%s) && echo "==> nerf-rl $(1) $(2)" && $(BIN)/nerf-rl $(1) $(2) && \
	echo "==> $(1) took $$(($$(date +%s) - start)) s"
endef

demo: $(REPORT)
	@echo "Open $(REPORT). To start over: rm -r $(DATA) runs/$(DEMO)"

# The demo's own recipes; only frames, steps and what is measured at the end are fewer.
demo-quick: $(READY)
	rm -rf data/demo-quick runs/demo-quick
	$(MAKE) demo DEMO=demo-quick DATA_KEYS="--episodes 420 --episodes_per_shard 35" \
		ENCODER_KEYS="--steps 320 --steps_per_epoch 100 --validation_frames 2 $(ENCODER_KEYS)" \
		AGENT_KEYS="--env_steps 3000 --warmup_steps 700 --final_evaluation_episodes 2" \
		REPORT_KEYS="--episodes 1"

$(DATA)/summary.json: | $(READY)
	$(call stage,gen-dataset,--config datasets/demo.yaml --out $(DATA) --resume true $(DATA_KEYS))

$(ENCODER)/summary.json: | $(DATA)/summary.json
	$(call stage,pretrain,--config pretrain/demo.yaml --data $(DATA) --out $(ENCODER) --resume true $(ENCODER_BUDGET) $(ENCODER_KEYS))

$(AGENT)/summary.json: | $(ENCODER)/summary.json
	$(call stage,train-rl,--config rl/drawer-open.yaml --encoder $(ENCODER) --out $(AGENT) --resume true $(AGENT_EVALUATION) $(AGENT_KEYS))

$(REPORT): $(DATA)/summary.json $(ENCODER)/summary.json $(AGENT)/summary.json
	$(call stage,report,--data $(DATA) --encoder $(ENCODER) --agent $(AGENT) --out $(REPORT) --overwrite true $(REPORT_KEYS))

# What is finished is skipped: an interrupted `make paper` goes on where it stopped.
paper: $(READY)
	$(BIN)/python -m tools.record.run_paper
	$(BIN)/python -m tools.record.paper
	$(BIN)/python -m tools.compare.samplers

format: $(READY)
	$(BIN)/ruff check --fix-only --quiet .
	$(BIN)/ruff format .

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python tools/install/import_all_modules.py

# A warning, such as a link to nowhere, is an error. The variable silences an advertisement, not a warning.
docs: $(READY)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "Open site/index.html. Searching it needs a server: $(BIN)/python -m http.server --directory site"

# TESTS narrows the run: make test TESTS="tests/pretrain -x". Each core takes test files one after another.
test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadfile $(TESTS)

# Screenshots are kept in .browser-tests/.
test-browser: $(READY)
	@sh tools/install/browser.sh
	$(BIN)/python -m pytest -m browser tests/browser

build: $(READY)
	rm -rf build dist
	$(BIN)/python -m build --wheel
	sh tools/install/smoke_test_wheel.sh

clean:
	rm -rf build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache
	find nerf_rl tests tools -name __pycache__ -type d -prune -exec rm -rf {} +
