# make help lists what there is; each target sets .venv up first.
SOURCES := $(shell find ladar_volume launch config -name '*.py' -o -name '*.yaml') package.xml setup.py setup.cfg
PY := .venv/bin/python
# one process more than cores: tests of nodes wait for most of their time; tests of a file stay
# together as far as may be, for what they share
TESTERS := $(shell expr $$(nproc) + 1)

.PHONY: help run test lint bench fuzz mutants wheels noble docs colcon clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):[^#]*## /\1\t/p' Makefile | expand -t 10

run: .venv/ready  ## play the bundled surveys through the real nodes, print volume ± sigma
	.venv/bin/ladar_volume up --play bags/stockpile --rate 4 -o out/stockpile
	.venv/bin/ladar_volume up --play bags/box --rate 4 -o out/box

test: .venv/ready  ## run the whole test suite
	$(PY) -m pytest -q -n $(TESTERS) --dist worksteal

lint: .venv/ready  ## ruff, its formatter and mypy
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

bench: .venv/ready  ## measure on this machine, write benchmarks/RESULTS.md
	$(PY) -m benchmarks

fuzz: .venv/ready  ## 10,000 mutated files into readers, as many files and options over the verbs
	$(PY) -m benchmarks.fuzz_readers --count 10000
	$(PY) -m benchmarks.fuzz_files --count 10000

mutants: .venv/ready  ## planted bugs, then mutants of the core: which do the tests see? hours
	$(PY) -m benchmarks.planted
	tools/mutants.sh

wheels: .venv/ready  ## does every pinned package have a wheel for arm64? needs the network
	tools/check_arm64.sh

noble: .venv/ready  ## the replay to the bits, and tests, with the NumPy and SciPy of Ubuntu 24.04
	tools/check_noble.sh

docs: .venv/ready  ## regenerate config/default.yaml and docs/parameters.md
	$(PY) -m ladar_volume.io.config

colcon: .venv/ready  ## build the package as a ROS workspace does
	$(PY) -m colcon build --merge-install

clean:  ## remove .venv and everything that was made
	rm -rf .venv build install log out

.venv/ready: requirements.txt requirements-dev.txt requirements-apt.txt tools/setup.sh tools/system_libraries.txt $(SOURCES)
	tools/setup.sh
