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

ON_DEVICES = tests/estimator/test_devices.py tests/contract/test_devices_of_effects.py tests/estimator/field/test_fused.py \
	tests/estimator/diagnosis/test_elsewhere.py tests/estimator/inference/test_collapsed.py tests/estimator/model/test_equivalent_sources.py

.PHONY: demo demo-service test docs lint types imports checks unit slow paper two-arms coverage hidden open-world mixed truthful written-wrong first-calibrations unexplained-posteriors coils-and-probe leave-one-out one-map policy real diagnose-real mice-floor mice-filaments harmonic-coils iron-cores storms streams batch-kills recalibrate-years recalibrate-mice bench bench-kernel bench-growth bench-profile bench-live bench-batch bench-device test-device bench-diagnose bench-service fuzz-service service-storm service-soak browser figures

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

# Studies behind the numbers in README and docs/results.md, minutes to an hour each; `make test` leaves them out.

slow: $(INSTALLED)        # statistics with bounds that can fail
	$(RUN) pytest -n 2 -m slow --jaxtyping-packages=

paper: $(INSTALLED)       # every table of the paper, our numbers beside its own; twenty minutes, continues where it was interrupted
	$(RUN) scripts.paper.reproduce --out out/paper

two-arms: $(INSTALLED)    # coils calibrated one at a time, both on, judged by magpylib; a quarter of an hour
	$(RUN) scripts.studies.two_arms

coverage: $(INSTALLED)    # simulation-based calibration, continues where it was interrupted
	$(RUN) scripts.studies.coverage --repeats 200 --first-seed 2000 --out out/coverage.jsonl

hidden: $(INSTALLED)      # effects hidden by independent code: found, named, missed; hours, continues where it was interrupted
	$(RUN) scripts.studies.hidden --cases 300 --out out/hidden.jsonl

open-world: $(INSTALLED)  # causes of the library and others at natural sizes, on rigs described in several ways; hours, continues where it was interrupted
	$(RUN) scripts.studies.open_world --cases 46 --first-seed 80000 --out out/open_world.jsonl

mixed: $(INSTALLED)       # one or two listed causes beside one that no list holds: what is stated; hours, continues where it was interrupted
	$(RUN) scripts.studies.mixed --cases 100 --first-seed 555000 --out out/mixed.jsonl

truthful: $(INSTALLED)    # every printed statement that a machine can judge, against the truth of hidden sessions and held-out readings of maps; hours, continues where it was interrupted
	$(RUN) scripts.studies.truthful --cases 100 --out out/truthful.jsonl

written-wrong: $(INSTALLED)   # rows written down wrongly, and rows of other sessions: which are flagged; ten minutes
	$(RUN) scripts.studies.written_wrong

first-calibrations: $(INSTALLED)  # 300 laboratories in the Earth's field, by independent code, as `coilcal init` describes them; two hours, continues where it was interrupted
	$(RUN) scripts.studies.first_calibrations --sessions 300 --first-seed 54000 --out out/first_calibrations.jsonl

coils-and-probe: $(INSTALLED)  # two coils that pull each other, a screw beside the probe, other flaws and none: what is named; ten minutes
	$(RUN) scripts.studies.coils_and_probe

unexplained-posteriors: $(INSTALLED)  # whether posteriors hold the truth where the cause is in no library; hours, continues where it was interrupted
	$(RUN) scripts.studies.unexplained_posteriors --kinds unknown30 --cases 60 --first-seed 230000 --out out/unexplained_posteriors.jsonl

leave-one-out: $(INSTALLED)   # each cause taken out of the library, hidden and diagnosed; hours, continues where it was interrupted
	$(RUN) scripts.studies.leave_one_out --sigma 30 --out out/leave_one_out_30.jsonl

one-map: $(INSTALLED)     # ten diagnoses of one large map, each with other readings for its search; half an hour
	$(RUN) scripts.studies.one_map --out out/one_map.jsonl

policy: $(INSTALLED)      # every rule with a number halved and doubled, and what changes; hours, continues where it was interrupted
	$(RUN) scripts.studies.policy --cases 1 --out out/policy.jsonl
	$(RUN) scripts.studies.policy_sentences --rows out/policy.jsonl

real: $(INSTALLED)        # measured coils below COILCAL_DATA
	$(RUN) scripts.studies.real_data --out out/real

diagnose-real: $(INSTALLED)   # what the simulation gets wrong on them
	$(RUN) scripts.studies.diagnose_real --out out/diagnosis
	$(RUN) scripts.studies.diagnose_real mice-run07 mice-run05 --carry 'out/diagnosis/mice-run03/pierced_plate[room]' --out out/diagnosis_with_plate
	$(RUN) scripts.studies.compare_diagnoses out/diagnosis/mice-run03 out/diagnosis_with_plate/mice-run05 out/diagnosis_with_plate/mice-run07

RUN01_SEEDS = 1 2 3 4 5 6 7 8 9 10
mice-floor: $(INSTALLED)  # what a diagnosis left of these maps beside their repeats and smooth functions in hindsight, run01 at ten seeds, for it has few; half an hour, after diagnose-real
	$(RUN) scripts.studies.mice_floor mice-run07 mice-run05 mice-run03 --out out/diagnosis
	for seed in $(RUN01_SEEDS); do $(RUN) scripts.studies.diagnose_real mice-run01 --seed $$seed --out out/diagnosis/seed$$seed; done
	$(RUN) scripts.studies.mice_floor mice-run01 --seeds $(RUN01_SEEDS) --out out/diagnosis

mice-filaments: $(INSTALLED)  # what the filaments of a superconducting magnet do to its maps, everything fitted at once
	$(RUN) scripts.studies.mice_filaments

harmonic-coils: $(INSTALLED)  # eight coils with iron cores by harmonics, on places held out; minutes
	$(RUN) scripts.studies.harmonic_coils

iron-cores: $(INSTALLED)  # two coils with iron cores that nobody mentioned, by independent code; a measured hysteresis loop; minutes
	$(RUN) scripts.studies.iron_cores

storms: $(INSTALLED)     # a measurement killed at 50 random instants, a recalibration at 20
	$(RUN) pytest -m slow tests/estimator/cli/test_acquire_storm.py tests/estimator/cli/test_recalibrate_storm.py

batch-kills: $(INSTALLED) # 200 sessions with workers and client killed, byte by byte those of the batch that was let alone; half an hour
	$(RUN) scripts.studies.batch_kills --out out/batch_kills

recalibrate-years: $(INSTALLED)   # 40 years of weekly sessions, a cause from week 20 on; over an hour, continues where it was interrupted
	$(RUN) scripts.studies.recalibrate_years --first-seed 5000 --weeks 22 --out out/years
	$(RUN) scripts.studies.recalibrate_years --first-seed 6000 --weeks 22 --out out/years

recalibrate-mice: $(INSTALLED)    # run06 and run07 of the measured solenoid, below COILCAL_DATA
	$(RUN) scripts.studies.recalibrate_mice --out out/recalibrate_mice

streams: $(INSTALLED)    # ten minutes of 15 kHz Senis packets, then a minute of 500 Hz RTDE beside six busy processes, none lost
	COILCAL_SENIS_S=600 $(RUN) pytest -m slow tests/drivers/hall/test_senis_stream.py
	COILCAL_RTDE_S=60 $(RUN) pytest tests/drivers/robots/test_rtde_reader.py -k computer_is_busy

bench-kernel: $(INSTALLED)  # sums over loops beside C by hand, which gcc compiles, and the start of a second process
	$(RUN) scripts.benchmarks.kernel

bench-growth: $(INSTALLED)  # time and peak memory against readings, loops, coils, sensors, walkers and hypotheses; a figure
	$(RUN) scripts.benchmarks.growth --figure docs/figures/growth.png

bench-profile: $(INSTALLED) # where the time of a calibration, a prediction and diagnoses goes
	$(RUN) scripts.benchmarks.where

bench-live: $(INSTALLED) # from a stop on the disk to the estimate that holds it
	$(RUN) scripts.benchmarks.live

bench-diagnose: $(INSTALLED)  # time to name a cause in 512 readings
	$(RUN) scripts.benchmarks.diagnose

bench-device: $(INSTALLED) # fields and fits on each device, in double and single precision; share of peak
	$(RUN) scripts.benchmarks.device

test-device: $(INSTALLED)  # what other tests run on a made-up device, on a graphics processor
	COILCAL_FAR_DEVICE=cuda $(RUN) pytest $(ON_DEVICES) --jaxtyping-packages=

bench-batch: $(INSTALLED) # fits per second: stacked, one by one, and over workers
	$(RUN) scripts.benchmarks.batch

fuzz-service: $(INSTALLED)   # five minutes of requests made from the schema, all checks of schemathesis, the same ones each time
	$(RUN) scripts.studies.fuzz_service --seconds 300 --seed 7

service-storm: $(INSTALLED)  # a service killed at 30 random instants while 100 clients stream, its workers at 20 while jobs run; twenty minutes
	$(RUN) scripts.studies.service_storm --kills 30 --clients 100 --seed 1
	$(RUN) scripts.studies.service_job_storm --kills 20 --seed 1

service-soak: $(INSTALLED)   # a month of small things in 25 minutes against one service: memory, files and bytes against their number
	nice -n 5 $(RUN) scripts.studies.service_soak --minutes 24 --pause 0.15

bench-service: $(INSTALLED)  # appended batches and predictions over HTTP, by clients and beside the same in process
	$(RUN) scripts.benchmarks.service

browser: $(INSTALLED)    # the page in a browser, with pictures in out/browser; needs Debian's chromium
	$(RUN) pip install -e '.[browser]'
	mkdir -p out/browser
	COILCAL_SCREENSHOTS=out/browser $(RUN) pytest -m browser tests/estimator/service --jaxtyping-packages=

bench: $(INSTALLED)       # speed beside magpylib, SciPy, plain emcee and NumPyro, which it installs
	$(RUN) pip install -e '.[bench]'
	$(RUN) scripts.benchmarks.run --repeats 3 --numpyro

figures: $(INSTALLED)     # pictures in docs/figures, from demo/, out/real, out/diagnosis and out/paper
	$(RUN) scripts.studies.figures

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
