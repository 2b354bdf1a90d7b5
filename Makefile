# make demo    set up, then the whole chain on drawer-open, ending in runs/demo/report.html
# make test    set up, then all tests
# make test-browser    set up with Chromium, then the tests that look at the viewer in it
# make paper   set up, then the paper's experiments (hours); ends in the tables of rl/README.md
# Other verbs: setup, format, check, build, clean. Set-up is done once, and again when pyproject.toml changes.

SHELL := /bin/sh
BIN := .venv/bin
READY := .venv/ready-$(firstword $(shell cksum pyproject.toml))

DATA := data/demo
ENCODER := runs/demo/encoder
AGENT := runs/demo/agent
REPORT := runs/demo/report.html

.PHONY: help setup demo paper format check test test-browser build clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# //p' Makefile | head -5

setup: $(READY)

$(READY):
	@start=$$(date +%s) && sh tools/install_system_libraries.sh && sh tools/install_environment.sh && \
		rm -f .venv/ready-* && touch $@ && echo "setup: done in $$(($$(date +%s) - start)) s"

# A stage of the demo is done when its summary.json exists; one that was interrupted goes on where it stopped.
# $(call stage,name,arguments) runs a command of nerf-rl and prints how long it took.
define stage
@start=$$(date +%s) && echo "==> nerf-rl $(1) $(2)" && $(BIN)/nerf-rl $(1) $(2) && \
	echo "==> $(1) took $$(($$(date +%s) - start)) s"
endef

demo: $(REPORT)
	@echo "Open $(REPORT). To start over: rm -r $(DATA) runs/demo"

$(DATA)/summary.json: | $(READY)
	$(call stage,gen-dataset,--config datasets/demo.yaml --out $(DATA) --resume true)

$(ENCODER)/summary.json: | $(DATA)/summary.json
	$(call stage,pretrain,--config pretrain/demo.yaml --data $(DATA) --out $(ENCODER) --resume true)

$(AGENT)/summary.json: | $(ENCODER)/summary.json
	$(call stage,train-rl,--config rl/demo.yaml --encoder $(ENCODER) --out $(AGENT) --resume true)

$(REPORT): $(DATA)/summary.json $(ENCODER)/summary.json $(AGENT)/summary.json
	$(call stage,report,--data $(DATA) --encoder $(ENCODER) --agent $(AGENT) --out $(REPORT))

# What is finished is skipped: an interrupted `make paper` goes on where it stopped.
paper: $(READY)
	$(BIN)/python tools/run_paper.py
	$(BIN)/python tools/record_paper.py
	$(BIN)/python tools/compare_samplers.py

format: $(READY)
	$(BIN)/ruff check --fix-only --quiet .
	$(BIN)/ruff format .

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python tools/import_all_modules.py

# TESTS narrows the run: make test TESTS="tests/test_cameras.py -x"
test: $(READY)
	$(BIN)/python -m pytest $(TESTS)

# Screenshots are kept in .browser-tests/.
test-browser: $(READY)
	@sh tools/install_browser.sh
	$(BIN)/python -m pytest -m browser tests/browser

build: $(READY)
	rm -rf build dist
	$(BIN)/python -m build --wheel
	sh tools/smoke_test_wheel.sh

clean:
	rm -rf build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
	find nerf_rl tests tools -name __pycache__ -type d -prune -exec rm -rf {} +
