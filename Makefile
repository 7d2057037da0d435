# Two commands do all their own set-up on a bare Debian 12: `make measure` and `make test`.
VENV    := .venv
PYTHON  ?= python3
BIN     := $(VENV)/bin
SUDO    := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PYTEST  ?= $(BIN)/python -m pytest

# What Python itself needs; what the tests drive (Aravis, the AVR tool chain, real network clients, a browser).
RUN_PACKAGES  := python3-venv
TEST_PACKAGES := $(RUN_PACKAGES) python3-dev gcc make pkg-config libcairo2-dev libgirepository1.0-dev \
                 gir1.2-aravis-0.8 aravis-tools aravis-tools-cli \
                 gcc-avr avr-libc simavr libsimavr-dev libsimavrparts1 libelf-dev \
                 chromium lxi-tools curl mosquitto

# Installs only what is missing, so that neither root nor a network is needed the second time.
define install_packages
	@missing=$$(for p in $(1); do dpkg -s $$p 2>/dev/null | grep -q '^Status: install ok' || echo $$p; done); \
	if [ -n "$$missing" ]; then \
	  echo "installing system packages:" $$missing; \
	  $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; \
	fi
endef

.PHONY: help measure test test-fast test-slow check docs man tutorial mutants renamed coverage shake bench interop soak firmware calibration clean

help:  ## List the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

measure: $(VENV)/.ready-run  ## Read the radiance of a screen patch on the simulated bench
	$(BIN)/radiometer measure --budget

# Two workers, each with its own core; tests that share fixtures, or that run in real time, stay in one of them. The
# fast ones run in three processes that were collected once (testing/side_by_side.py).
ONE_THREAD = PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
RUN_TESTS = $(ONE_THREAD) $(PYTEST) -n 2
RUN_FAST  = $(ONE_THREAD) $(PYTEST) --processes=3
NO_OTHERS = not bench and not soak and not hardware
FAST_TESTS = -m "not slow and not long and $(NO_OTHERS)" tests/unit

test: $(VENV)/.ready-test  ## Run the tests, all but the round trips, soaks and studies of `make test-slow`
	$(RUN_TESTS) -m "not long and $(NO_OTHERS)"

test-fast: $(VENV)/.ready-test  ## Run what needs no process, no browser and no real time (about a minute)
	$(RUN_FAST) $(FAST_TESTS)

test-slow: $(VENV)/.ready-test  ## Run the round trips, soaks, studies of coverage and documents followed word by word
	$(RUN_TESTS) -m "long and $(NO_OTHERS)"

check: $(VENV)/.ready-test  ## Format, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.ready-test  ## Build the documentation site into out/site; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

man: $(VENV)/.ready-run  ## Write the manual page docs/radiometer.1 anew, after a command changed
	$(BIN)/radiometer man > docs/.radiometer.1 && mv docs/.radiometer.1 docs/radiometer.1

tutorial: $(VENV)/.ready-test  ## Follow the tutorial and all how-to pages word by word, in a fresh environment from a fresh wheel
	rm -rf out/tutorial out/wheel
	$(BIN)/python -m pip wheel -q --disable-pip-version-check --no-deps -w out/wheel .
	sed '$$aradiometer @ file://'"$$(echo $(CURDIR)/out/wheel/radiometer-*.whl)" constraints.txt > out/wheel/constraints.txt
	PIP_CONSTRAINT=$(CURDIR)/out/wheel/constraints.txt PIP_DISABLE_PIP_VERSION_CHECK=1 \
	  $(BIN)/python docs/_site/follow.py docs/tutorial.md out/tutorial/tutorial
	for page in $$(grep -l '^```console' docs/how-to/*.md); do \
	  PATH=$(CURDIR)/out/tutorial/tutorial/venv/bin:$$PATH out/tutorial/tutorial/venv/bin/python docs/_site/follow.py \
	    $$page out/tutorial/$$(basename $$page .md) --skip-installing || exit 1; \
	done

mutants: $(VENV)/.ready-test out/mutants.coverage  ## Draw mistakes at random and count which the fast tests notice (BLIND=seed, AREA=planning)
	$(BIN)/python -m tests.mutants $(AREA) --blind $(or $(BLIND),$(error give the seed, for example BLIND=41)) --report out/blind-$(BLIND).md

renamed: $(VENV)/.ready-test  ## Rename 50 private functions at random; no fast test may notice (SEED=n, TESTS="tests/unit/data")
	$(ONE_THREAD) $(BIN)/python -m tests.mutants $(TESTS) --renamed $(or $(SEED),$(error give the seed, for example SEED=41))

out/mutants.coverage: $(VENV)/.ready-test  # which fast test runs which line; delete it after changes
	$(BIN)/python -m tests.mutants --record

coverage: $(VENV)/.ready-test  ## Run the whole suite and show which branches it never takes, least covered modules first
	$(RUN_TESTS) --cov --cov-report=
	$(BIN)/python -m coverage report --sort=cover --skip-covered

# Two loops that do nothing but take the processor, as a busy machine does; another order each time.
RUNS  ?= 10
TESTS ?=
shake: $(VENV)/.ready-test  ## Run the fast tests in ten orders under two busy loops (RUNS=n, TESTS="tests/protocol")
	@for k in 1 2; do (while :; do :; done) & busy="$$busy $$!"; done; trap "kill $$busy" EXIT; failed=0; \
	for run in $$(seq 1 $(RUNS)); do echo "run $$run of $(RUNS)"; \
	  $(if $(TESTS),$(RUN_TESTS),$(RUN_FAST)) -q --randomly-seed=$$run $(or $(TESTS),$(FAST_TESTS)) \
	    || failed=$$((failed + 1)); \
	done; echo "$$failed of $(RUNS) runs failed"; [ $$failed = 0 ]

bench: $(VENV)/.ready-test  ## Run the long benchmarks and rewrite the tables in docs/benchmarks
	$(BIN)/python -m benchmarks

soak: $(VENV)/.ready-test  ## Run the daemon for an hour and watch its memory
	$(BIN)/python -m benchmarks --soak

calibration: $(VENV)/.ready-run  ## Calibrate the simulated bench and box anew: response from a chart, scale from a known source, levels
	rm -rf out/chart out/reference
	$(BIN)/radiometer bracket out/chart --bench configs/bench-simulated-chart.yaml --stops 1 --from 500us --to 256ms
	$(BIN)/radiometer response out/chart -o out/response.yaml --plot out/response.png --force
	$(BIN)/radiometer bracket out/reference --bench configs/bench-simulated-reference.yaml --patch 708,520,200,200 --repeat 4
	$(BIN)/radiometer calibrate out/reference --response out/response.yaml --patch 708,520,200,200 --radiance 1.0 \
	  --u-rel 0.005 --spectrum white_led --validity-days 3650 \
	  --stated glare_u=0 --stated exposure_u_s=0 --stated drift_u_rel_per_year=0 --stated polarisation_u_rel=0 \
	  -o configs/calibrations/simulated.yaml --force
	$(BIN)/radiometer light calibrate --box sim --seed 1 --spectral-u-rel 0.01 -o configs/calibrations/simulated-box.yaml --force

# PsychoPy without what its windows, sounds and Builder need: that is some 3 GB, and none of it calibrates a screen.
PSYCHOPY := psychopy==2026.2.5 six json_tricks psutil pyzmq requests packaging i18next astunparse esprima python-bidi \
            arabic-reshaper websockets distro

interop:  ## Run PsychoPy, pymmcore-plus and obsarray with our adapters, each in an environment of its own, and keep what they say
	$(PYTHON) -m venv .venv-interop/psychopy && $(PYTHON) -m venv .venv-interop/micro_manager && $(PYTHON) -m venv .venv-interop/obsarray
	.venv-interop/psychopy/bin/python -m pip install -q -c constraints.txt -e . $(filter-out psychopy%,$(PSYCHOPY))
	.venv-interop/psychopy/bin/python -m pip install -q --no-deps $(filter psychopy%,$(PSYCHOPY))
	.venv-interop/micro_manager/bin/python -m pip install -q -e . pymmcore-plus==0.18.1
	.venv-interop/obsarray/bin/python -m pip install -q -c constraints.txt -e '.[xarray]' obsarray==1.0.3
	for name in psychopy micro_manager obsarray; do .venv-interop/$$name/bin/python -m benchmarks._interop $$name || exit 1; done

firmware:  ## Build the light box's firmware and print its size
	$(call install_packages,gcc-avr avr-libc make)
	$(MAKE) -C drivers/firmware/light_box

clean:  ## Remove the virtual environment and all caches
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis out

$(VENV)/.ready-run: pyproject.toml constraints.txt
	$(call install_packages,$(RUN_PACKAGES))
	[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/.ready-test: pyproject.toml constraints.txt
	$(call install_packages,$(TEST_PACKAGES))
	[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[genicam,photo,v4l2,gphoto2,fleet,cluster,docs,dev]'
	@touch $@ $(VENV)/.ready-run
