# `make run` and `make test` need Python 3.11 or later and make; they set up the rest in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN := run
SENSORS := 1 2 3 4 5 6

.PHONY: run test chaos check bench year study sample clean

# The stamp is newer than pyproject.toml when the environment is up to date.
$(VENV)/.installed: pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

$(VENV)/.bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,bench]'
# Its metadata forbid the numpy that all others need; it works with it. A failure is reported later.
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps cedar-solve
	@touch $@

# Six simulated sensors: telemetry -> store -> fit -> validation -> upload file and report.
run: $(VENV)/.installed
	@BIN=$(BIN) RUN=$(RUN) SENSORS='$(SENSORS)' sh tools/run_sample.sh

test: $(VENV)/.installed
	$(BIN)/python -m pytest -n auto --dist worksteal

check: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --dist worksteal

# Kills, full disks and damage at every touch of the disk; `make test` has a short form of it.
chaos: $(VENV)/.installed
	STCAL_CHAOS=1 STCAL_KILLS=200 $(BIN)/python -m pytest -n auto --dist worksteal tests/chaos tests/hostile \
	  tests/telemetry/test_ingest_kill.py

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/bench.py --out bench

# A simulated sensor-year through the commands, at 1, 10 and 100 %: an hour, 10 GB of disk.
year: $(VENV)/.installed
	@mkdir -p study
	$(BIN)/python benchmarks/sensor_year.py --folder study/year --json study/year.json

study: $(VENV)/.installed
	$(BIN)/python benchmarks/study.py --runs 50 --json study/study.json
	$(BIN)/python benchmarks/consistency.py --json study/consistency.json
	$(BIN)/stcal study enright --out study/enright
	$(BIN)/stcal study tracking --out study/tracking
	$(BIN)/stcal study wu --out study/wu
	$(BIN)/stcal study zhang --out study/zhang
	$(BIN)/stcal study estimators --out study/estimators --page docs/which-estimator.md

# Remake the simulated telemetry that is shipped.
sample: $(VENV)/.installed
	@for n in $(SENSORS); do \
	  $(BIN)/stcal simulate configs/scenarios/st16-$$n.toml --out sample_telemetry --seed 1 \
	    --no-truth-columns || exit $$?; done
	$(BIN)/python tools/sample_downlink.py

clean:
	rm -rf $(RUN) bench study build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +
