# `make demo` and `make test` are all a fresh machine needs: Python >= 3.11, git and make.
PYTHON ?= python3
BIN := .venv/bin
RUN := $(BIN)/python -m
# What commands need, what the service needs besides, and what tests need, each installed when it is first asked for.
COMMANDS_INSTALLED := .venv/.commands_installed
SERVICE_INSTALLED := .venv/.service_installed
INSTALLED := .venv/.installed
DOCS_INSTALLED := .venv/.docs_installed

# Some images of Python keep no bytecode: every process that a test starts would compile the whole project first.
unexport PYTHONDONTWRITEBYTECODE

STUDIES := paper two-arms coverage hidden open-world mixed imitations truthful written-wrong reported-flaws first-calibrations hand-placed remounted coils-and-probe \
	unexplained-posteriors leave-one-out one-map autopilot policy real diagnose-real mice-floor mice-filaments \
	harmonic-coils iron-cores storms streams batch-kills recalibrate-years recalibrate-mice fuzz-service \
	service-storm service-soak figures bench bench-kernel bench-growth bench-profile bench-live \
	bench-diagnose bench-commands bench-batch bench-device bench-service test-device browser

.PHONY: demo demo-service test checks lint types imports unit slow docs results words size study $(STUDIES)

demo: $(COMMANDS_INSTALLED)
	$(BIN)/coilcal simulate --rig configs/paper_simulation.yaml --plan configs/plans/paper_grid.yaml --truth configs/truth/paper_simulation.json --seed 2 --out demo/session.zarr --overwrite
	$(BIN)/coilcal calibrate demo/session.zarr --out demo/calibration --seed 1 --overwrite
	$(BIN)/coilcal simulate --rig configs/paper_simulation.yaml --plan configs/plans/paper_grid.yaml --truth configs/truth/paper_simulation.json --seed 2 --hide axis_gain.x=0.01 --out demo/flawed.zarr --overwrite
	$(BIN)/coilcal diagnose demo/flawed.zarr --out demo/diagnosis --seed 1 --overwrite

demo-service: $(SERVICE_INSTALLED)     # after `make demo`: its sessions in the service, and the page at http://127.0.0.1:8765
	$(RUN) scripts.demo_service

test:   # mypy beside the first tests, of which many only wait
	$(MAKE) -j 2 checks unit

checks: lint types imports

docs: $(DOCS_INSTALLED)   # the site, site/index.html: tutorials are run, pages of causes are written; no internet; a warning is an error, and a site from before stays until a new one is whole
	$(RUN) scripts.documentation.causes --out docs/reference/causes
	$(RUN) scripts.documentation.rig_keys --out docs/reference/rig-keys.txt
	$(RUN) scripts.documentation.site docs site

lint: $(INSTALLED)
	$(RUN) ruff check
	$(RUN) ruff format --check

types: $(INSTALLED)
	$(RUN) mypy

imports: $(INSTALLED)
	$(BIN)/lint-imports

unit: $(INSTALLED)
	$(RUN) pytest -n 3 --dist worksteal -m "not slow and not browser and not whole"
	$(RUN) pytest -n 3 --dist worksteal -m "not slow and not browser and whole" --jaxtyping-packages=  # fits and diagnoses: twice as fast without checks of every call

slow: $(INSTALLED)        # statistics with bounds that can fail
	$(RUN) pytest -n 2 -m slow --jaxtyping-packages=

results: $(INSTALLED)     # docs/results.md and docs/performance.md, from their rows in docs/studies
	$(RUN) scripts.documentation.tables

words: $(INSTALLED)       # sentence lengths of README and docs by page, and banned phrases
	$(RUN) scripts.documentation.words

size: $(INSTALLED)        # lines of code of the packages and of the tests
	$(RUN) scripts.documentation.size coilcal estimator drivers tests

study: $(INSTALLED)       # `make study NAME=hidden`: one of scripts/studies/studies.yaml; without NAME they are listed
	$(RUN) scripts.studies $(NAME)

$(STUDIES):               # each also by its name alone
	$(MAKE) study NAME=$@

# Installs once, and again when the dependencies change. A python with a CUDA build of torch shares its packages with the
# environment; where the environment then sees a torch, that build is kept and no other is asked for.
INSTALL = if $(BIN)/python -c 'import sys, torch; sys.exit(torch.version.cuda is None)' 2>/dev/null; \
	then $(RUN) pip install -e $(1); \
	else $(RUN) pip install -c constraints.txt -e $(1); fi

# Why pip and no lock file: docs/decisions/0002-libraries.md
$(COMMANDS_INSTALLED): pyproject.toml constraints.txt
	if $(PYTHON) -c 'import sys, torch; sys.exit(torch.version.cuda is None)' 2>/dev/null; \
	then $(PYTHON) -m venv --system-site-packages .venv; \
	else $(PYTHON) -m venv .venv; fi
	$(call INSTALL,.)
	touch $@

$(SERVICE_INSTALLED): $(COMMANDS_INSTALLED)
	$(call INSTALL,'.[service]')
	touch $@

$(INSTALLED): $(COMMANDS_INSTALLED)
	$(call INSTALL,'.[dev]')
	touch $@

$(DOCS_INSTALLED): $(INSTALLED)
	$(RUN) pip install -c constraints.txt -e '.[docs]'
	touch $@
