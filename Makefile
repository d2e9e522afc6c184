# Every target sets up .venv by itself: `make train` and `make test` work on a fresh clone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
BARN ?= $(wildcard ../shared/barn)
NATIVE := $(shell find appl_dist -name '*.c' -o -name '*.cpp' -o -name '*.h') appl_dist/native/CMakeLists.txt
ARGS ?=
# Where torch is looked for first: PyTorch's index of CPU builds, as the default index's torch brings several GB of CUDA.
# With an NVIDIA GPU, or `make TORCH_INDEX=`, the default index alone.
TORCH_INDEX ?= $(if $(shell nvidia-smi -L 2>/dev/null),,https://download.pytorch.org/whl/cpu)

.PHONY: train test lint bench compilers asan-tree asan fuzz clean venv

venv: $(VENV)/.installed

$(VENV)/.requirements: requirements.lock
	$(PYTHON) -m venv $(VENV)
	[ -z "$(TORCH_INDEX)" ] || $(BIN)/pip install --quiet --disable-pip-version-check --no-deps --retries 1 \
		--timeout 15 --index-url "$(TORCH_INDEX)" "$$(grep ^torch== requirements.lock)" || \
		echo "torch: not to be had from TORCH_INDEX=$(TORCH_INDEX); taking the default index's"
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

$(VENV)/.installed: $(VENV)/.requirements pyproject.toml $(NATIVE)
	$(BIN)/pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	touch $@

train: venv
	$(BIN)/appl-dist train $(ARGS)

test: venv
	$(BIN)/python -m pytest $(ARGS)

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The comparisons of benchmarks/README.md that take minutes; the long ones are listed there with their commands.
bench: venv
	$(BIN)/pip install --quiet --disable-pip-version-check -r benchmarks/requirements.lock
	$(BIN)/python benchmarks/actor_throughput.py --worlds "$(BARN)"
	$(BIN)/python benchmarks/planner_cycle.py
	$(BIN)/python benchmarks/td3_update.py
	$(BIN)/python benchmarks/replay_sampling.py
	$(BIN)/python benchmarks/wire_throughput.py

# The C core with every compiler that is installed (GCC 9 to 14, clang 14 on, aarch64 cross), warnings as errors.
compilers: venv
	$(BIN)/python tools/compilers.py

# The C core under AddressSanitizer and UndefinedBehaviorSanitizer, in a build folder and an import path of its own.
ASAN_TESTS ?= tests/unit/planner tests/unit/sim tests/unit/policy/test_network.py tests/property tests/conformance
ASAN_PYTEST = cd build-asan/tree && ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 \
	LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" \
	PYTHONPATH=$(abspath build-asan/tree) $(abspath $(BIN)/python) -P -m pytest -p no:cacheprovider
asan-tree: venv
	cmake -S appl_dist/native -B build-asan -G Ninja -DAPPL_SANITIZE=ON -DCMAKE_BUILD_TYPE=RelWithDebInfo \
		-DPython_EXECUTABLE=$(abspath $(BIN)/python)
	cmake --build build-asan
	rm -rf build-asan/tree && mkdir -p build-asan/tree
	cp -r appl_dist conf tests pyproject.toml build-asan/tree
	cp build-asan/_native*.so build-asan/tree/appl_dist
	ln -sfn $(abspath ../shared) build-asan/shared

asan: asan-tree
	$(ASAN_PYTEST) $(ASAN_TESTS)

# The same build on absurd inputs, drawn anew every round.
FUZZ_MINUTES ?= 10
fuzz: asan-tree
	end=$$(($$(date +%s) + 60 * $(FUZZ_MINUTES))); round=0; while [ $$(date +%s) -lt $$end ]; do \
		($(ASAN_PYTEST) -q --hypothesis-seed=$$(date +%s%N) tests/property -k "planner or sim") || exit 1; \
		round=$$((round + 1)); done; echo "$$round rounds"

clean:
	rm -rf $(VENV) build build-asan .pytest_cache .mypy_cache .ruff_cache .hypothesis
