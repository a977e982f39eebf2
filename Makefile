# make run: replay the bundled surveys through the real nodes. make test: the whole test suite.
SOURCES := $(shell find ladar_volume launch config -name '*.py' -o -name '*.yaml') package.xml setup.py setup.cfg
PY := .venv/bin/python

.PHONY: run test lint bench docs colcon clean

run: .venv/ready
	.venv/bin/ladar_volume up --play bags/stockpile --rate 4 -o out/stockpile
	.venv/bin/ladar_volume up --play bags/box --rate 4 -o out/box

test: .venv/ready
	$(PY) -m pytest -q -n auto

lint: .venv/ready
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

bench: .venv/ready
	$(PY) -m benchmarks

docs: .venv/ready
	$(PY) -m ladar_volume.io.config

colcon: .venv/ready
	$(PY) -m colcon build --merge-install

clean:
	rm -rf .venv build install log out

.venv/ready: requirements.txt requirements-dev.txt tools/setup.sh $(SOURCES)
	tools/setup.sh
